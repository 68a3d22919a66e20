"""Foundations of the training of controllers."""

import contextlib
import csv
import functools
import json
import os
import pathlib
import pty
import re
import signal
import subprocess
import sys
import time

import fiatlux
import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("rsl_rl")

from fiatlux.train import hand, ppo, report  # noqa: E402
from fiatlux.train.run import Run, load_checkpoint, settings_of  # noqa: E402
from fiatlux.train.settings import Baseline, Hand, Walk  # noqa: E402
from fiatlux.train.start import read  # noqa: E402
from fiatlux.train.walk import models  # noqa: E402
from fiatlux.train.worlds import WalkingWorlds  # noqa: E402
from safetensors import safe_open  # noqa: E402


def test_reflected_observations_give_reflected_actions_and_equal_values():
    torch.manual_seed(0)
    worlds = WalkingWorlds(2, "cpu")
    actor, critic = models(worlds, Walk(hidden=(64, 32), critic=(64, 32)))
    for model, group in ((actor, "policy"), (critic, "critic")):
        network = model.mlp
        numbers = torch.randn(16, worlds.observation[group].shape[1])
        seen, mirrored = network(numbers), network(network.inputs(numbers))
        torch.testing.assert_close(network.outputs(seen), mirrored, atol=1e-5, rtol=0)
        assert (seen - mirrored).abs().max() > 1e-3 or group == "critic"
    worlds.env.close()


def test_pairs_of_units_need_even_layers():
    worlds = WalkingWorlds(1, "cpu")
    with pytest.raises(ValueError, match="even"):
        models(worlds, Walk(hidden=(63, 32)))
    worlds.env.close()


SMALL = [
    "--worlds",
    "64",
    "--segment",
    "2",
    "--steps",
    "8",
    "--hidden",
    "32",
    "32",
    "--critic",
    "32",
    "32",
    "--evaluate",
    "50",
]


def run(*arguments):
    done = subprocess.run([sys.executable, "-m", "fiatlux.train", *map(str, arguments)], capture_output=True, text=True)
    return done.returncode, done.stdout, done.stderr


def on_a_terminal(*arguments):
    """Its stderr where that is a terminal."""
    ours, theirs = pty.openpty()
    command = [sys.executable, "-m", "fiatlux.train", *map(str, arguments)]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=theirs):
        os.close(theirs)
        shown = b""
        # Reading fails once the other end is closed.
        with contextlib.suppress(OSError):
            while block := os.read(ours, 4096):
                shown += block
    os.close(ours)
    return shown.decode()


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_training_says_why_it_has_no_gpu(tmp_path):
    code, _, error = run("walk", "--out", tmp_path / "run", *SMALL, "--samples", 512)
    assert code == 0 and f"PyTorch {torch.__version__}" in error and "train on the processor" in error
    code, _, error = run("walk", "--out", tmp_path / "other", *SMALL, "--device", "cuda")
    assert code == 2 and "PyTorch has no 'cuda' here; PyTorch " in error


def test_a_run_goes_on_is_tested_and_exported(tmp_path):
    out = tmp_path / "run"
    assert run("walk", "--out", out, *SMALL, "--samples", 1024)[0] == 0
    assert run("walk", "--out", out, "--resume", "--samples", 3000)[0] == 0
    with (out / "curve.csv").open() as file:
        assert [int(row["samples"]) for row in csv.DictReader(file)] == [1024, 2048, 3072]
    code, said, _ = run("evaluate", out / "last.pt", "--episodes", 2, "--tests", "upright")
    assert code == 0 and re.search(r"^upright +0\.0000 +-", said, re.MULTILINE)
    shown = on_a_terminal("evaluate", out / "last.pt", "--episodes", 2, "--tests", "upright", "arms")
    assert re.search(r"test 2 of 2, arms: \d+ of 20 s, less than 1 min left", shown), shown
    file = tmp_path / "mine.safetensors"
    assert run("export", out / "last.pt", file)[0] == 0
    assert file.stat().st_mode & 0o777 == 0o666 & ~os.umask(os.umask(0o022))
    assert len(fiatlux.WholeBody(file).joint_names) == 29
    assert run("export", out / "last.pt", file)[0] == 2
    assert run("export", out / "last.pt", file, "--force")[0] == 0
    code, _, error = run("walk", "--out", out, "--resume", "--hidden", 64, 64)
    # Where there is no GPU, a line before it says so.
    assert code == 2 and error.splitlines()[-1].startswith("error: hidden is (64, 64)")


def test_a_run_goes_on_from_an_exported_controller(tmp_path):
    out, other, file, again = (tmp_path / name for name in ("run", "other", "one.safetensors", "two.safetensors"))
    assert run("walk", "--out", out, *SMALL, "--samples", 1024)[0] == 0
    assert run("export", out / "last.pt", file)[0] == 0
    # In the first segment the critic learns alone: what is exported is what was read. Then the policy learns too.
    assert run("walk", "--out", other, *SMALL, "--start", file, "--samples", 2048)[0] == 0
    assert run("export", other / "last.pt", again)[0] == 0
    one, two = read(file), read(again)
    for given, kept in zip(one[0], two[0]):
        torch.testing.assert_close(kept, given, atol=1e-4, rtol=1e-4)
    assert two[1]["training"]["samples"] == 2048
    assert run("walk", "--out", other, "--resume", "--samples", 3072)[0] == 0
    assert run("export", other / "last.pt", again, "--force")[0] == 0
    assert (read(again)[0][0] - one[0][0]).abs().max() > 1e-3
    code, _, error = run("walk", "--out", tmp_path / "third", *SMALL, "--hidden", 64, 64, "--start", file)
    assert code == 2 and "with hidden layers 32 32; give --hidden 32 32" in error
    code, _, error = run("walk", "--out", tmp_path / "third", *SMALL, "--start", out / "last.pt")
    assert code == 2 and "is not an exported controller" in error


def test_a_run_that_is_out_of_time_says_how_to_go_on(tmp_path):
    out = tmp_path / "run"
    code, said, _ = run("walk", "--out", out, *SMALL, "--minutes", 0.001)
    assert code == 0 and "less than 1 min left" in said
    last = said.splitlines()[-1]
    assert re.fullmatch(
        r"stopped: the next segment would end after \d+\.\d min; .*last\.pt has 0\.00 M samples; go on with --resume",
        last,
    )
    code, _, error = run("evaluate", out / "best.pt")
    assert code == 2 and error.strip().endswith(
        "first test comes after 50 segments; name last.pt, or go on with --resume"
    )


def test_ctrl_c_ends_a_segment_early_with_a_checkpoint(tmp_path):
    arguments = ["walk", "--out", tmp_path / "run", *SMALL, "--segment", "100000"]
    child = subprocess.Popen(
        [sys.executable, "-m", "fiatlux.train", *map(str, arguments)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    assert "settings: --worlds 64" in child.stdout.readline()
    assert "after each segment of 51,200,000 steps" in child.stdout.readline()
    time.sleep(2.0)
    child.send_signal(signal.SIGINT)
    said, _ = child.communicate(timeout=60)
    assert child.returncode == 3 and "--resume goes on" in said
    progress = load_checkpoint(tmp_path / "run/last.pt")["progress"]
    assert progress["segment"] == 1 and progress["samples"] % 512 == 0


@pytest.mark.parametrize(
    "arguments, says",
    [
        (["--samples", "0"], "samples is 0; give 1 or more"),
        (["--start-difficulty", "3"], "start_difficulty is 3.0; give 0 to 1"),
        (["--reward", "speed=1"], "there is no term 'speed'"),
        (["--reward", "alive"], "give NAME=WEIGHT"),
        (["--without", "hist"], "without: hist is not known"),
        (["--device", "abacus"], "PyTorch has no 'abacus'"),
        (["--resume"], "nothing to go on with"),
    ],
)
def test_wrong_settings_are_refused_before_anything_is_written(tmp_path, arguments, says):
    code, _, error = run("walk", "--out", tmp_path / "run", *arguments)
    assert code == 2 and says in error and "Traceback" not in error
    assert not (tmp_path / "run").exists()


def test_other_files_are_not_checkpoints(tmp_path):
    junk = tmp_path / "junk.pt"
    junk.write_bytes(b"(lp0\nno checkpoint")
    for arguments in (
        ["evaluate", junk],
        ["export", junk, tmp_path / "x.safetensors"],
        ["evaluate", tmp_path / "none.pt"],
    ):
        code, _, error = run(*arguments)
        assert code == 2 and error.startswith("error: ") and "Traceback" not in error


BASELINE = [
    "--worlds",
    "6",
    "--rooms",
    "2",
    "--episodes",
    "1",
    "--steps",
    "8",
    "--segment",
    "2",
    "--hidden",
    "32",
    "--critic",
    "32",
]


def test_a_baseline_that_is_resumed_goes_on_as_if_it_had_not_stopped(tmp_path):
    """Worlds, networks, optimiser and random streams: the curve and the networks are the same to the last bit."""
    whole, parts = tmp_path / "whole", tmp_path / "parts"
    arguments = ["--task", "climb", *BASELINE, "--threads", "2", "--device", "cpu", "--evaluate", "2"]
    assert run("ppo", "--out", whole, *arguments, "--samples", 288)[0] == 0
    assert run("ppo", "--out", parts, *arguments, "--samples", 96)[0] == 0
    assert run("ppo", "--out", parts, "--resume", "--device", "cpu", "--samples", 288)[0] == 0
    curves = []
    for out in (whole, parts):
        with (out / "curve.csv").open() as file:
            curves.append(list(csv.DictReader(file)))
    assert [int(row["samples"]) for row in curves[0]] == [96, 192, 288]
    timed = ("minutes", "steps_per_s", "rollout_share")
    for one, other in zip(*curves, strict=True):
        assert {name: one[name] for name in one if name not in timed} == {
            name: other[name] for name in other if name not in timed
        }
    assert "reward/robot_fall" in curves[0][0] and curves[0][1]["test/gate_progress"]
    one, other = (load_checkpoint(out / "last.pt", "ppo")["ppo"]["actor_state_dict"] for out in (whole, parts))
    for name in one:
        torch.testing.assert_close(one[name], other[name], rtol=0, atol=0)

    code, said, _ = run("evaluate", whole / "last.pt", "--episodes", 2, "--json")
    found = json.loads(said)
    assert code == 0 and found["task"] == "climb" and found["episodes"] == 2 and 0 < found["seconds"] <= 120
    file = tmp_path / "climb.safetensors"
    code, said, _ = run("export", whole / "last.pt", file)
    assert code == 0 and 'fiatlux.Baseline("' in said
    policy = fiatlux.Baseline(file)
    env = fiatlux.Env("climb", sensors=policy.sensors, observation="flat")
    numbers = env.reset(seed=5000)[0]
    state = load_checkpoint(whole / "last.pt", "ppo")
    worlds = ppo.worlds_of(settings_of(state, {}), "cpu", 1, 5000, 1, 1)
    actor, _ = ppo.models(worlds, settings_of(state, {}))
    actor.load_state_dict(state["ppo"]["actor_state_dict"])
    actor.eval()
    expected = actor.mlp(actor.obs_normalizer(torch.from_numpy(numbers)[None]))[0].detach().numpy()
    np.testing.assert_allclose(policy(numbers), expected, atol=1e-5)
    played = fiatlux.evaluate(policy, ["climb"], [0], max_steps=5)
    assert len(played.episodes) == 1
    code, _, error = run("ppo", "--out", whole, "--resume", "--task", "S02")
    assert code == 2 and "task is S02, but the checkpoint's is climb" in error
    code, _, error = run("ppo", "--out", tmp_path / "new", "--task", "S99")
    assert code == 2 and "task is 'S99'; give one of" in error


@pytest.mark.skipif("FIATLUX_NIGHTLY" not in os.environ, reason="FIATLUX_NIGHTLY is not set")
@pytest.mark.parametrize("task", ["S02", "S08"])
def test_the_baseline_trains_for_some_minutes(tmp_path, task):
    """With the networks and the PPO of the page, in few worlds. The curve goes to the log; whether anything is learned is not judged."""
    settings = ["--worlds", 64, "--rooms", 4, "--device", "cpu", "--minutes", 3]
    assert run("ppo", "--out", tmp_path, "--task", task, *settings)[0] == 0
    print((tmp_path / "curve.csv").read_text())
    with (tmp_path / "curve.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert int(rows[-1]["samples"]) >= 64 * 24


class Falls:
    """Leaves the joints where they are, and falls: a bag of a second."""

    def __call__(self, observation):
        return np.zeros(53)


def test_a_policy_of_the_hand_is_trained_resumed_tested_and_exported(tmp_path, monkeypatch, capsys):
    out, file, bags = tmp_path / "hand", tmp_path / "s08.safetensors", tmp_path / "bags"
    fiatlux.evaluate(Falls, ["S08"], [1000, 1001], out=bags)
    small = ["--worlds", 6, "--rooms", 2, "--steps", 4, "--segment", 1, "--batches", 2, "--hidden", 32, "--critic", 32]
    arguments = ["--demonstrations", bags, *small, "--threads", 2, "--device", "cpu", "--evaluate", 50]
    code, said, failed = run("hand", "--out", out, *arguments, "--samples", 24)
    assert code == 0 and "lifted" in said, failed
    assert run("hand", "--out", out, "--resume", "--device", "cpu", "--samples", 48)[0] == 0
    with (out / "curve.csv").open(newline="") as curve:
        assert [row["samples"] for row in csv.DictReader(curve)] == ["24", "48"]
    code, said, failed = run("export", out / "last.pt", file)
    assert code == 0 and 'fiatlux.hand.HandPolicy("' in said, failed
    played = fiatlux.evaluate(fiatlux.hand.HandPolicy(file), ["S08"], [0], max_steps=8)
    assert played.episodes[0]["steps"] == 8
    # Whole episodes take too long here.
    monkeypatch.setattr(hand, "measure", functools.partial(hand.measure, steps=8))
    assert report.main(out / "last.pt", 1, None, 1, "cpu", as_json=True) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["success"] == 0.0 and found["seconds"] == pytest.approx(0.16)
    with pytest.raises(ValueError, match="demonstrations: give a folder of bags"):
        Hand()
    with pytest.raises(ValueError, match="has no bag of the rooms 1000 to 1001"):
        hand.demonstrated(str(tmp_path / "none"), range(1000, 1002), 8.0)


@pytest.mark.parametrize("kind, more", [(Baseline, {}), (Hand, {"demonstrations": "x"})])
def test_a_trainer_stays_below_the_rooms_of_its_tests(kind, more):
    assert kind(worlds=4001, rooms=4000, **more).rooms == 4000
    with pytest.raises(ValueError, match="rooms is 4001, but rooms from 5000 on are for tests; give at most 4000"):
        kind(worlds=4001, rooms=4001, **more)


class Learner:
    """The part of an algorithm whose learning rate a run adjusts."""

    learning_rate = 1e-3

    def __init__(self):
        self.optimizer = torch.optim.Adam([torch.zeros(1, requires_grad=True)], lr=self.learning_rate)


def test_the_learning_rate_follows_whole_updates():
    """RSL-RL's own rule sees no update as a whole: it rises and falls within each."""
    learning = Run.__new__(Run)
    learning.ppo, learning.settings = Learner(), Walk(desired_kl=0.01)
    for kl, rate in [(0.015, 1e-3), (0.03, 1e-3 / 1.5), (0.001, 1e-3), (1e9, 1e-3 / 1.5)]:
        learning.adapt_once(kl)
        assert learning.ppo.learning_rate == pytest.approx(rate)
        assert learning.ppo.optimizer.param_groups[0]["lr"] == learning.ppo.learning_rate
    for _ in range(50):
        learning.adapt_once(1.0)
    assert learning.ppo.learning_rate == 1e-5


def test_the_page_s_example_of_rsl_rl_runs(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    page = (pathlib.Path(__file__).resolve().parents[3] / "docs/python/vector.md").read_text()
    (block,) = re.findall(r"^<!-- needs: train -->\n```python\n(.*?)^```", page, re.MULTILINE | re.DOTALL)
    for usual, small in (("WalkingVectorEnv(1024,", "WalkingVectorEnv(16,"), ("learn(1000)", "learn(2)")):
        assert usual in block
        block = block.replace(usual, small)
    exec(compile(block, "vector.md", "exec"), {"fiatlux": fiatlux})


def test_a_policy_that_follows_the_plan_is_trained_resumed_tested_and_exported(tmp_path):
    out, file = tmp_path / "climb", tmp_path / "climb.safetensors"
    small = [*SMALL, "--worlds", "16", "--segment", "1", "--batches", "2"]
    code, said, _ = run("climb", "--out", out, *small, "--samples", 128)
    assert code == 0 and "action_rate" in said, said
    code, _, _ = run("climb", "--out", out, "--resume", "--samples", 256)
    assert code == 0
    with (out / "curve.csv").open(newline="") as curve:
        assert [row["samples"] for row in csv.DictReader(curve)] == ["128", "256"]
    code, said, _ = run("evaluate", out / "last.pt", "--episodes", 2, "--json")
    found = json.loads(said)
    assert code == 0 and found["samples"] == 256 and found["up"] == found["down"] == 0.0, found
    code, said, failed = run("export", out / "last.pt", file, "--hardware", "a test")
    assert code == 0 and "climb:" in said, failed
    with safe_open(str(file), "pt") as tensors:
        contract = json.loads(tensors.metadata()["contract"])
        assert contract["layers"][1:] == [32, 32, 15] and contract["samples"] == 256
        # The file's layers are the policy, the scales of its inputs included.
        numbers = tensors.get_tensor("check.observation")
        for number in range(3):
            numbers = tensors.get_tensor(f"layer{number}.weight") @ numbers + tensors.get_tensor(f"layer{number}.bias")
            numbers = torch.nn.functional.elu(numbers) if number < 2 else numbers
        torch.testing.assert_close(numbers, tensors.get_tensor("check.action"), atol=1e-5, rtol=1e-4)
    code, _, failed = run("climb", "--out", tmp_path / "other", "--reward", "height=1")
    assert code == 2 and "height" in failed
