"""Tests that LeRobot loads an exported data set and trains on it."""

import base64
import io
import json
import os
import signal
import socket
import subprocess
import sys
import time
import urllib.parse

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
    fiatlux.evaluate(
        Waver, ["S05"], [0, 1], out=folder, record=["camera@25", "depth@10", "chest_segmentation@10"], **settings
    )
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
        for name, seen in bag.channels().items():
            np.testing.assert_array_equal(loaded[start + 5][f"observation.{name}"].numpy(), seen[5].ravel())
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


def test_an_interrupted_export_leaves_nothing_and_goes_on(run, data, tmp_path, monkeypatch):
    out, saved = tmp_path / "set", []
    save = LeRobotDataset.save_episode

    def interrupted(self, *args, **kwargs):
        if len(saved) == 1:
            raise KeyboardInterrupt
        saved.append(1)
        return save(self, *args, **kwargs)

    monkeypatch.setattr(LeRobotDataset, "save_episode", interrupted)
    with pytest.raises(KeyboardInterrupt):
        fiatlux.export_lerobot(run, out, vcodec="h264")
    assert not out.exists() and (tmp_path / "set.part").is_dir()
    with pytest.raises(ValueError, match="unfinished export of other bags or arguments"):
        fiatlux.export_lerobot(run, out, fps=10)
    told = []
    monkeypatch.setattr(LeRobotDataset, "save_episode", save)
    fiatlux.export_lerobot(run, out, vcodec="h264", progress=told.append)
    # The first bag was kept.
    assert told == [{"bags": 2, "done": 2, "seconds_left": 0.0}] and not (tmp_path / "set.part").exists()
    again, whole = load(out), load(data)
    assert len(again) == len(whole) and again.meta.total_episodes == 2
    for row in (0, len(whole) // 2, len(whole) - 1):
        for name, value in whole[row].items():
            assert value == again[row][name] if isinstance(value, str) else (value == again[row][name]).all(), (
                row,
                name,
            )
    with pytest.raises(FileExistsError, match="exists already; name another folder"):
        fiatlux.export_lerobot(run, out, vcodec="h264")


def test_a_killed_export_leaves_nothing_and_goes_on(run, tmp_path):
    """By SIGKILL, which nothing can handle, after the first of two bags."""
    out = tmp_path / "set"
    text = "import fiatlux, os, sys; fiatlux.export_lerobot(*sys.argv[1:3], vcodec='h264', progress=lambda told: os.kill(os.getpid(), 9))"
    done = subprocess.run([sys.executable, "-c", text, run, out], capture_output=True)
    assert done.returncode == -9 and not out.exists(), done.stderr
    assert load(fiatlux.export_lerobot(run, out, vcodec="h264")).num_episodes == 2


def test_one_export_at_a_time(run, tmp_path):
    def second(told):
        with pytest.raises(FileExistsError, match="another export is at work"):
            fiatlux.export_lerobot(run, tmp_path / "set", vcodec="h264")

    fiatlux.export_lerobot(run, tmp_path / "set", vcodec="h264", progress=second)
    (tmp_path / "other.part").mkdir()
    (tmp_path / "other.part/mine").touch()
    with pytest.raises(FileExistsError, match="is in the way"):
        fiatlux.export_lerobot(run, tmp_path / "other", vcodec="h264")


def test_fewer_frames_keep_the_sum_of_the_rewards(run, tmp_path):
    bags = [fiatlux.Bag(path) for path in sorted(run.rglob("*.mcap"))]
    loaded = load(fiatlux.export_lerobot(run, tmp_path / "slow", fps=10, vcodec="h264"))
    assert loaded.fps == 10 and loaded.num_frames == sum(-(-(len(bag["/state"]["step"]) - 1) // 5) for bag in bags)
    total = sum(float(row["next.reward"]) for row in loaded.hf_dataset)
    assert total == pytest.approx(sum(bag.result["total_reward"] for bag in bags), rel=1e-4)


@pytest.fixture(scope="module")
def commands(tmp_path_factory):
    """A data set of the commands of `walk`, with single pictures."""
    program = os.environ.get("FIATLUX_TEST_PROGRAM")
    if program is None:
        pytest.skip("FIATLUX_TEST_PROGRAM names no program fiatlux")
    folder = tmp_path_factory.mktemp("walk")
    command = [program, "evaluate", "--policy", "walk", "--tasks", "S05", "--seeds", "1001", "--out", folder]
    subprocess.run([*command, "--record", "camera@10", "--image", "64x48"], check=True, capture_output=True)
    out = tmp_path_factory.mktemp("commands") / "set"
    kept = {"state": ["projected_gravity", "base_height"], "action": "command"}
    return folder, fiatlux.export_lerobot(folder, out, fps=10, vcodec=None, **kept)


def test_a_delayed_action_stands_where_it_acted(tmp_path):
    program = os.environ.get("FIATLUX_TEST_PROGRAM")
    if program is None:
        pytest.skip("FIATLUX_TEST_PROGRAM names no program fiatlux")
    command = [program, "evaluate", "--policy", "random", "--tasks", "S05", "--seeds", "1000", "--action-delay", "40"]
    subprocess.run([*command, "--out", tmp_path / "bags"], check=True, capture_output=True)
    bag = fiatlux.Bag(next((tmp_path / "bags").rglob("*.mcap")))
    loaded = load(fiatlux.export_lerobot(tmp_path / "bags", tmp_path / "set", vcodec=None))
    for row in (5, 6, 7):
        sent = bag["/action"]["action.action"][row - 2].astype(np.float32)
        np.testing.assert_array_equal(loaded[row]["action"].numpy(), sent)
        np.testing.assert_array_equal(sent, bag["/state"]["action"][row + 1].astype(np.float32))
        assert float(loaded[row]["next.action_delay_s"]) == pytest.approx(0.04)


def test_commands_are_a_data_set(commands):
    folder, out = commands
    bag, loaded = fiatlux.Bag(next(folder.rglob("*.mcap"))), load(out)
    said = bag["/action"]["action.chunk.values"]
    first, later = loaded[0], loaded[20]
    assert first["action"].shape == (7,) and first["observation.state"].shape == (4,)
    np.testing.assert_array_equal(later["action"].numpy(), said[100])
    assert said[100][0] > 0.1 and float(first["action"][3]) == pytest.approx(0.75)
    image = later["observation.images.camera"]
    assert image.shape == (3, 48, 64) and loaded.features["observation.images.camera"]["dtype"] == "image"


class Page:
    """The connection of the page of `fiatlux teleop`."""

    def __init__(self, address):
        url = urllib.parse.urlsplit(address)
        self.socket = socket.create_connection((url.hostname, url.port), timeout=60)
        key = base64.b64encode(os.urandom(16)).decode()
        lines = [f"GET /drive?{url.query} HTTP/1.1", f"Host: {url.netloc}", "Upgrade: websocket", "Connection: Upgrade"]
        lines += [f"Sec-WebSocket-Key: {key}", "Sec-WebSocket-Version: 13", "", ""]
        self.socket.sendall("\r\n".join(lines).encode())
        self.file = self.socket.makefile("rb")
        assert b"101" in self.file.readline()
        while self.file.readline() != b"\r\n":
            pass

    def send(self, message):
        text = json.dumps(message).encode()
        # Masked with zeros.
        self.socket.sendall(bytes([0x81, 0xFE]) + len(text).to_bytes(2, "big") + bytes(4) + text)

    def until(self, phase):
        while True:
            kind, length = self.file.read(2)
            if length >= 126:
                length = int.from_bytes(self.file.read(2 if length == 126 else 8), "big")
            body = self.file.read(length)
            status = json.loads(body).get("status", {}) if kind == 0x81 else {}
            if status.get("phase") == phase:
                return status

    def close(self):
        self.file.close()
        self.socket.close()

    def hold(self, key, seconds):
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            data = {"keys": [key], "focused": True, "running": True}
            self.send({"input": "keyboard", "at": 1, "data": data})
            time.sleep(0.02)


def test_takes_are_a_data_set(tmp_path):
    """Read back with pyarrow alone: what a person drove is in the files, take by take."""
    import pyarrow.parquet

    program = os.environ.get("FIATLUX_TEST_PROGRAM")
    if program is None:
        pytest.skip("FIATLUX_TEST_PROGRAM names no program fiatlux")
    takes = tmp_path / "takes"
    command = [program, "teleop", "--task", "S07", "--seed", "4", "--no-open", "--out", takes]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        page = Page(process.stdout.readline().strip())
        for key, order in (("KeyS", "save"), ("KeyQ", "discard"), ("KeyQ", "save")):
            page.until("ready")
            page.send({"order": "start"})
            page.until("running")
            page.hold(key, 1.0)
            page.send({"order": "stop"})
            assert page.until("ended")["end"] == "stopped"
            page.send({"order": order})
        page.until("ready")
        page.close()
        process.send_signal(signal.SIGINT)
        kept = process.communicate(timeout=60)[0].split()
    bags = [fiatlux.Bag(path) for path in sorted(takes.glob("*.mcap"))]
    assert process.returncode == 0 and len(bags) == len(kept) == 2
    assert [bag.header["episode"] for bag in bags] == [0, 2] and all(bag.header["request"]["take"] for bag in bags)

    data = fiatlux.export_lerobot(takes, tmp_path / "set", vcodec=None)
    info = json.loads((data / "meta/info.json").read_text())
    lengths = [len(bag["/state"]["step"]) - 1 for bag in bags]
    assert (info["codebase_version"], info["fps"], info["total_episodes"]) == ("v3.0", 50, 2)
    assert info["total_frames"] == sum(lengths) and min(lengths) > 20
    files = sorted((data / "data").rglob("*.parquet"))
    table = pyarrow.concat_tables([pyarrow.parquet.read_table(path) for path in files]).to_pydict()
    episodes = np.array(table["episode_index"])
    for index, (bag, length) in enumerate(zip(bags, lengths)):
        rows = np.flatnonzero(episodes == index)
        assert len(rows) == length
        column = {name: np.array([table[name][row] for row in rows]) for name in table}
        np.testing.assert_array_equal(column["action"], bag["/state"]["action"][1:].astype(np.float32))
        seen = bag["/observation"]["proprioception.joint_position"]
        np.testing.assert_array_equal(column["observation.state"][:, 10:63], seen[:-1])
        np.testing.assert_array_equal(column["frame_index"], np.arange(length))
        assert not column["next.done"][:-1].any() and column["next.done"][-1]
        assert not column["next.success"].any() and set(column["episode.policy"].ravel()) == {"teleop"}
        turned = [bag["/action"][f"action.whole_body.{name}"] for name in ("vx", "wz")]
        np.testing.assert_array_equal(column["command"][:, [0, 2]], np.stack(turned, axis=1).astype(np.float32))
    walked, turned = (np.array([table["command"][row] for row in np.flatnonzero(episodes == take)]) for take in (0, 1))
    assert walked[:, 0].min() < -0.1 and turned[:, 2].max() > 0.1
    (episode_file,) = (data / "meta/episodes").rglob("*.parquet")
    said = pyarrow.parquet.read_table(episode_file).to_pydict()
    assert said["length"] == lengths and said["tasks"] == [[bag.header["instruction"]] for bag in bags]


def train(root, out, chunk, *more):
    small = {
        "type": "act",
        "device": "cpu",
        "push_to_hub": "false",
        "chunk_size": chunk,
        "n_action_steps": chunk,
        "dim_model": 64,
        "n_heads": 2,
        "dim_feedforward": 64,
        "n_encoder_layers": 1,
        "n_vae_encoder_layers": 1,
        "latent_dim": 8,
        "pretrained_backbone_weights": "null",
    }
    command = [sys.executable, "-m", "lerobot.scripts.lerobot_train"]
    command += ["--dataset.repo_id=fiatlux/bags", f"--dataset.root={root}", "--dataset.video_backend=pyav"]
    command += [f"--policy.{name}={value}" for name, value in small.items()]
    command += [f"--output_dir={out}", "--batch_size=4", "--num_workers=0", "--eval_freq=0"]
    command += ["--wandb.enable=false", "--seed=1", *more]
    # Nothing is asked of a hub; one thread, since several fight where the machine is busy.
    environment = {**os.environ, "HF_HUB_OFFLINE": "1", "OMP_NUM_THREADS": "1"}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, timeout=1800)
    said = done.stdout + done.stderr
    assert done.returncode == 0, said[-3000:]
    return said


def test_act_trains_on_it_for_200_steps(data, tmp_path):
    said = train(data, tmp_path / "out", 10, "--steps=200", "--log_freq=50", "--save_freq=200")
    assert (tmp_path / "out/checkpoints/000200/pretrained_model/model.safetensors").is_file()
    losses = [float(part.split("loss:")[1].split()[0]) for part in said.splitlines() if "loss:" in part]
    assert len(losses) == 4 and losses[-1] < losses[0]


class Asked:
    """Sends a request of GR00T's protocol to our server."""

    def __init__(self, process):
        import zmq

        line = process.stdout.readline().split()
        assert line[:1] == ["listening"], line
        self.socket = zmq.Context.instance().socket(zmq.REQ)
        self.socket.setsockopt(zmq.RCVTIMEO, 60_000)
        self.socket.connect(line[1])

    def __call__(self, endpoint, **data):
        return self.raw(msgpack_of({"endpoint": endpoint, **({"data": data} if data else {})}))

    def raw(self, request):
        import msgpack

        self.socket.send(request)

        def array(value):
            is_array = "__ndarray_class__" in value
            return np.load(io.BytesIO(value["as_npy"]), allow_pickle=False) if is_array else value

        return msgpack.unpackb(self.socket.recv(), object_hook=array)


def msgpack_of(value):
    import msgpack

    def packed(array):
        file = io.BytesIO()
        np.save(file, array, allow_pickle=False)
        return {"__ndarray_class__": True, "as_npy": file.getvalue()}

    return msgpack.packb(value, default=packed)


def numpy_map(array):
    """An array in the form of the package msgpack-numpy."""
    return {b"nd": True, b"type": array.dtype.str, b"kind": b"", b"shape": array.shape, b"data": array.tobytes()}


def test_a_checkpoint_is_served(commands, tmp_path):
    """The answer equals that of LeRobot's own code for a frame of the data set; a wrong input is named."""
    import torch
    from lerobot.configs.policies import PreTrainedConfig
    from lerobot.policies.act.modeling_act import ACTPolicy
    from lerobot.policies.factory import make_pre_post_processors

    train(commands[1], tmp_path / "out", 20, "--steps=2", "--save_freq=2")
    folder = tmp_path / "out/checkpoints/000002/pretrained_model"
    frame = load(commands[1])[20]
    config = PreTrainedConfig.from_pretrained(folder)
    config.device = "cpu"
    policy = ACTPolicy.from_pretrained(folder, config=config).eval()
    before, after = make_pre_post_processors(config, str(folder))
    names = ("observation.state", "observation.images.camera", "task")
    chunk = policy.predict_action_chunk(before({name: frame[name] for name in names}))
    expected = torch.stack([after(row[None])[0] for row in chunk[0]]).numpy()

    command = [sys.executable, "-m", "fiatlux.serve_lerobot", folder, "--port", "0"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    try:
        ask = Asked(process)
        contract = {group: config["as_dict"] for group, config in ask("get_modality_config").items()}
        keys = {group: config["modality_keys"] for group, config in contract.items()}
        assert keys == {"video": ["camera"], "state": ["state"], "action": ["action"], "language": ["task"]}
        assert len(contract["action"]["delta_indices"]) == 20 and ask("reset", options=None) == {}
        image = (frame["observation.images.camera"].permute(1, 2, 0) * 255).round().to(torch.uint8).numpy()
        state = frame["observation.state"].numpy()
        observation = {
            "video": {"camera": image[None, None]},
            "state": {"state": state[None, None]},
            "language": {"task": [["carry the bulb"]]},
        }
        actions, _ = ask("get_action", observation=observation, options=None)
        # Since N1.7 GR00T's clients send arrays as msgpack-numpy does.
        numpy_form = {**observation, "state": {"state": numpy_map(state[None, None])}}
        same, _ = ask("get_action", observation=numpy_form, options=None)
        np.testing.assert_array_equal(same["action"], actions["action"])
        assert actions["action"].shape == (1, 20, 7) and actions["action"].dtype == np.float32
        np.testing.assert_allclose(actions["action"][0], expected, atol=1e-5)
        for group, key, value, says in [
            ("video", "camera", image[None, None, :40], "video 'camera' is uint8 [1, 1, 40, 64, 3]; the model takes"),
            ("state", "state", state[None], "state 'state' is float32 [1, 4]; the model takes float32 [1, 1, 4]"),
            ("state", "state", state[None, None] * np.nan, "not finite"),
            ("state", "other", state[None, None], "state has no 'state'"),
            ("language", "task", "words", "[[WORDS]]"),
        ]:
            answer = ask("get_action", observation={**observation, group: {key: value}}, options=None)
            assert says in answer["error"], answer
        assert "Unknown endpoint" in ask("kill")["error"]
        assert "cannot be read" in ask.raw(b"\xc1")["error"]
        assert (
            "state has no" in ask("get_action", observation=3)["error"] or "video has no" in ask("get_action")["error"]
        )
        ask.socket.close(linger=0)
    finally:
        process.kill()
        process.communicate()


def test_act_is_trained_on_bags(commands, tmp_path):
    """The checkpoint plays commands, both arms and the right hand. A folder without bags is refused."""
    from fiatlux.serve_lerobot import Model
    from fiatlux.train_lerobot import episode, main

    main([str(commands[0]), "--out", str(tmp_path / "act"), "--minutes", "0.01", "--batch", "2", "--workers", "1"])
    model = Model(tmp_path / "act")
    images, state, at, actions = episode(next(commands[0].rglob("*.mcap")))
    observation = {
        "video": {"camera": images[None, :1]},
        "state": {"state": state[None, :1]},
        "language": {"task": [["carry the bulb"]]},
    }
    assert model.images == {"camera": (3, 48, 64)} and model.act(observation).shape == (20, 33) == (
        20,
        actions.shape[1],
    )
    assert at[1] == 5 and state.shape[1] == 63
    # The norms of the picture's encoder have learned, and are LeRobot's own in the checkpoint.
    norm = model._policy.model.backbone.bn1
    assert type(norm).__name__ == "FrozenBatchNorm2d" and norm.running_mean.abs().max() > 0
    with pytest.raises(SystemExit):
        main([str(tmp_path), "--out", str(tmp_path / "none")])


def test_act_is_trained_on_all_senses(tmp_path):
    """Both cameras now and a second ago, forces, LiDAR and both hands, in bags and in what the server asks for."""
    from fiatlux.serve_lerobot import Model
    from fiatlux.train_lerobot import Inputs, main, read

    program = os.environ.get("FIATLUX_TEST_PROGRAM")
    if program is None:
        pytest.skip("FIATLUX_TEST_PROGRAM names no program fiatlux")
    command = [program, "evaluate", "--policy", "walk", "--tasks", "S05", "--seeds", "1001", "--out", tmp_path / "walk"]
    record = ["--record", "camera@10,chest_camera@10,lidar@10", "--image", "64x48"]
    subprocess.run([*command, *record], check=True, capture_output=True)
    options = "--cameras camera chest_camera --contacts --lidar 12 --history 1.0 --hands both".split()
    small = ["--minutes", "0.01", "--batch", "2", "--workers", "1"]
    main([str(tmp_path / "walk"), "--out", str(tmp_path / "act"), *small, *options])
    inputs = Inputs(("camera", "chest_camera"), True, 12, (10,), "both")
    assert (tmp_path / "act/mapping.toml").read_text() == inputs.mapping((64, 48), 20)
    model = Model(tmp_path / "act")
    assert model.images == {"camera": (3, 48, 64), "chest_camera": (3, 48, 64)} and model.width == 63 + 102 + 12
    contract = {group: config["as_dict"] for group, config in model.contract().items()}
    assert contract["video"] == {"delta_indices": [-10, 0], "modality_keys": ["camera", "chest_camera"]}
    data = read(list((tmp_path / "walk").rglob("*.mcap")), 1, inputs)
    seen = data["images"][[data["past"][30, 0], 30]]
    observation = {
        "video": {"camera": seen[None, ..., :3], "chest_camera": seen[None, ..., 3:]},
        "state": {"state": data["state"][None, 30:31]},
        "language": {"task": [["carry the bulb"]]},
    }
    chunk = model.act(observation)
    assert chunk.shape == (20, 45)
    # Each view has a place of its own, so that the order of the pictures counts.
    for turned in (
        {"camera": seen[None, ::-1, ..., :3]},
        {"camera": seen[None, ..., 3:], "chest_camera": seen[None, ..., :3]},
    ):
        other = {**observation, "video": {**observation["video"], **turned}}
        assert not np.allclose(model.act(other), chunk, atol=1e-6)
    with pytest.raises(SystemExit):
        main([str(tmp_path / "walk"), "--out", str(tmp_path / "more"), "--start", str(tmp_path / "act"), *small])


def test_bad_use_is_refused_by_name(run, tmp_path):
    with pytest.raises(ValueError, match="fps is 30"):
        fiatlux.export_lerobot(run, tmp_path / "a", fps=30)
    with pytest.raises(ValueError, match="no file"):
        fiatlux.export_lerobot(tmp_path, tmp_path / "b")
    with pytest.raises(FileNotFoundError, match="no bag at"):
        fiatlux.export_lerobot([tmp_path / "missing.mcap"], tmp_path / "c")
    with pytest.raises(ValueError, match="state: .'limbs'. is not known"):
        fiatlux.export_lerobot(run, tmp_path / "d", state=["limbs"])
    with pytest.raises(ValueError, match="no command with every action"):
        fiatlux.export_lerobot(run, tmp_path / "e", action="command")
