"""Bags as a data set that LeRobot loads and trains on."""

import os
import subprocess
import sys

import fiatlux
import numpy as np
import pytest
from lerobot.datasets.lerobot_dataset import LeRobotDataset

pytestmark = pytest.mark.filterwarnings("default")


class Waver:
    def reset(self, info):
        self.rng = np.random.default_rng(info["seed"])

    def __call__(self, observation):
        return self.rng.uniform(-0.1, 0.1, 53)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("run")
    settings = {"image_size": (64, 64), "reward": "training"}
    fiatlux.evaluate(Waver, ["S05"], [0, 1], out=folder, record=["camera@25"], **settings)
    return folder


@pytest.fixture(scope="module")
def data(run, tmp_path_factory):
    return fiatlux.export_lerobot(run, tmp_path_factory.mktemp("data") / "set", vcodec="h264")


def load(folder, **settings):
    return LeRobotDataset("fiatlux/bags", root=folder, video_backend="pyav", **settings)


def test_the_data_set_has_what_the_bags_have(run, data):
    bags = [fiatlux.Bag(path) for path in sorted(run.rglob("*.mcap"))]
    loaded = load(data)
    lengths = [len(bag["/state"]["step"]) - 1 for bag in bags]
    assert loaded.num_episodes == 2 and loaded.num_frames == sum(lengths) and loaded.fps == 50
    start = 0
    for bag, length in zip(bags, lengths):
        first, last = loaded[start], loaded[start + length - 1]
        seen = bag["/observation"]["proprioception.joint_position"]
        np.testing.assert_array_equal(first["observation.state"][10:63].numpy(), seen[0])
        np.testing.assert_array_equal(last["observation.state"][10:63].numpy(), seen[length - 1])
        np.testing.assert_array_equal(first["action"].numpy(), bag["/state"]["action"][1].astype(np.float32))
        assert first["task"] == bag.header["instruction"]
        assert int(first["episode.seed"]) == bag.header["seed"] and first["episode.policy"] == "Waver"
        drawn = dict(zip(loaded.features["episode.conditions"]["names"], first["episode.conditions"].tolist()))
        friction = bag.header["domain_sample"]["hand_friction"]
        assert any(name.startswith("hand_friction") for name in drawn) and friction
        assert first["next.reward_terms"].sum() == pytest.approx(float(first["next.reward"]), abs=1e-5)
        assert not bool(first["next.done"]) and bool(last["next.done"])
        assert bool(last["next.success"]) == bag.result["strict"]["success"]
        paid = sum(float(loaded.hf_dataset[start + row]["next.reward"]) for row in range(length))
        assert paid == pytest.approx(bag.result["total_reward"], rel=1e-4)
        image = first["observation.images.camera"]
        assert image.shape == (3, 64, 64) and float(image.std()) > 0.02
        start += length


def test_fewer_frames_keep_the_sum_of_the_rewards(run, tmp_path):
    bags = [fiatlux.Bag(path) for path in sorted(run.rglob("*.mcap"))]
    loaded = load(fiatlux.export_lerobot(run, tmp_path / "slow", fps=10, vcodec="h264"))
    assert loaded.fps == 10 and loaded.num_frames == sum(-(-(len(bag["/state"]["step"]) - 1) // 5) for bag in bags)
    total = sum(float(row["next.reward"]) for row in loaded.hf_dataset)
    assert total == pytest.approx(sum(bag.result["total_reward"] for bag in bags), rel=1e-4)


def test_act_trains_on_it_for_200_steps(data, tmp_path):
    small = {
        "type": "act",
        "device": "cpu",
        "push_to_hub": "false",
        "chunk_size": 10,
        "n_action_steps": 10,
        "dim_model": 64,
        "n_heads": 2,
        "dim_feedforward": 64,
        "n_encoder_layers": 1,
        "n_vae_encoder_layers": 1,
        "latent_dim": 8,
        "pretrained_backbone_weights": "null",
    }
    command = [sys.executable, "-m", "lerobot.scripts.lerobot_train"]
    command += ["--dataset.repo_id=fiatlux/bags", f"--dataset.root={data}", "--dataset.video_backend=pyav"]
    command += [f"--policy.{name}={value}" for name, value in small.items()]
    command += [f"--output_dir={tmp_path / 'out'}", "--steps=200", "--batch_size=4", "--num_workers=0", "--log_freq=50"]
    command += ["--eval_freq=0", "--save_freq=200", "--wandb.enable=false", "--seed=1"]
    # Nothing is asked of a hub; one thread, since several fight where the machine is busy.
    environment = {**os.environ, "HF_HUB_OFFLINE": "1", "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=1800)
    said = done.stdout + done.stderr
    assert done.returncode == 0, said[-3000:]
    assert (tmp_path / "out/checkpoints/000200/pretrained_model/model.safetensors").is_file()
    losses = [float(part.split("loss:")[1].split()[0]) for part in said.splitlines() if "loss:" in part]
    assert len(losses) == 4 and losses[-1] < losses[0]


def test_bad_use_is_refused_by_name(run, tmp_path):
    with pytest.raises(ValueError, match="fps is 30"):
        fiatlux.export_lerobot(run, tmp_path / "a", fps=30)
    with pytest.raises(ValueError, match="no file"):
        fiatlux.export_lerobot(tmp_path, tmp_path / "b")
    with pytest.raises(FileNotFoundError, match="no bag at"):
        fiatlux.export_lerobot([tmp_path / "missing.mcap"], tmp_path / "c")
