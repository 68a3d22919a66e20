"""Tests Python policies over Zenoh, and evaluations with bags."""

import _thread
import json
import threading
import time

import fiatlux
import numpy as np
import pytest


class Waver:
    """A deterministic policy with state within an episode."""

    def reset(self, info):
        assert info["instruction"] and info["episode"] == 0
        self.rng = np.random.default_rng(info["seed"])

    def __call__(self, observation):
        assert observation["joint_position"].shape == (53,) and observation["joint_position"].dtype == np.float32
        return self.rng.uniform(-0.1, 0.1, 53)


def rows_alone(episodes):
    """The results that follow from the rows, all that an episode without a bag has."""
    recorded = ("rows_digest", "bag", "failure", "notes", "signed_by")
    return [{name: value for name, value in episode.items() if name not in recorded} for episode in episodes]


def test_a_recorded_evaluation_is_the_plain_one(tmp_path):
    tasks, seeds = ["S05", "S07"], [0, 1]
    plain = fiatlux.evaluate(Waver, tasks, seeds)
    told = []
    recorded = fiatlux.evaluate(Waver, tasks, seeds, out=tmp_path, parallel=2, progress=told.append)
    assert rows_alone(recorded.episodes) == plain.episodes
    # In a run, subtasks that were not registered score 0.
    for name in recorded.scores.keys() - {"score", "score_strict"}:
        assert recorded.scores[name] == plain.scores[name], name
    weights = [(seed["weight_covered"], seed["weight_total"]) for seed in plain.scores["score"]["per_seed"]]
    for (covered, total), ours, theirs in zip(
        weights, plain.scores["score"]["per_seed"], recorded.scores["score"]["per_seed"]
    ):
        assert theirs["score"] == pytest.approx(ours["score"] * covered / total)
    assert recorded.lost == () and told[-1]["done"] == told[-1]["episodes"] == 4
    for episode in recorded.episodes:
        bag = fiatlux.Bag(tmp_path / episode["bag"])
        assert bag.is_whole and bag.result["end"]["digest"] == episode["state_digest"]
        assert bag.header["policy"] == "Waver"
    results = json.loads((tmp_path / "results.json").read_text())
    assert len(results["episodes"]) == 4 and (tmp_path / "report.html").is_file()

    # The run is over: the same call plays nothing, and another policy does not get its result.
    with pytest.warns(UserWarning, match="had all episodes already"):
        again = fiatlux.evaluate(Waver, tasks, seeds, out=tmp_path)
    assert again.episodes == recorded.episodes

    class Other(Waver):
        def __call__(self, observation):
            return np.zeros(53)

    with pytest.raises(ValueError, match="differs in the policy's code or weights .*run_file"):
        fiatlux.evaluate(Other, tasks, seeds, out=tmp_path, name="Waver")
    with pytest.raises(ValueError, match="differs in the seeds.*run_file"):
        fiatlux.evaluate(Waver, tasks, [5], out=tmp_path)


def test_what_a_policy_sees_on_a_server_is_what_the_environment_shows(tmp_path):
    sensors = ["proprioception", "hand_contact", "lidar", "camera", "privileged", "verdict"]
    settings = {"sensors": sensors, "image_size": (64, 64), "robot": "g1_bare", "reward": "training"}
    seen = []

    def policy(observation):
        seen.append({name: part.copy() for name, part in observation.items()})
        return np.full(29, 0.01)

    fiatlux.evaluate(policy, ["S01"], [2], out=tmp_path, **settings)
    env = fiatlux.Env("S01", **settings)
    observation, _ = env.reset(seed=2)
    for step in range(len(seen)):
        assert observation.keys() == seen[step].keys()
        for name, part in observation.items():
            np.testing.assert_array_equal(part, seen[step][name], err_msg=f"{name} in step {step}")
        observation, *_ = env.step(np.full(29, 0.01))


def test_an_evaluation_that_was_stopped_goes_on(tmp_path):
    begun = []

    class Interrupted(Waver):
        def reset(self, info):
            super().reset(info)
            begun.append((info["task"], info["seed"]))

        def __call__(self, observation):
            if len(begun) == 2:
                raise RuntimeError("out of memory")
            return super().__call__(observation)

    with pytest.raises(RuntimeError, match="out of memory"):
        fiatlux.evaluate(Interrupted, ["S05"], [0, 1], out=tmp_path, parallel=1, name="waver")
    begun.append("the second call")
    whole = fiatlux.evaluate(Interrupted, ["S05"], [0, 1], out=tmp_path, parallel=1, name="waver")
    assert begun == [("S05", 0), ("S05", 1), "the second call", ("S05", 1)]
    assert rows_alone(whole.episodes) == fiatlux.evaluate(Waver, ["S05"], [0, 1]).episodes


def test_ctrl_c_ends_an_evaluation(tmp_path):
    class Slow(Waver):
        def __call__(self, observation):
            time.sleep(0.05)
            return super().__call__(observation)

    threading.Timer(2.0, _thread.interrupt_main).start()
    start = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        fiatlux.evaluate(Slow, ["S05"], [0, 1], out=tmp_path, parallel=1)
    assert time.monotonic() - start < 20


def test_an_absent_server_is_named():
    with pytest.raises(ConnectionError, match="endpoint: .*127.0.0.1:9.*Pass another endpoint"):
        fiatlux.Client("tcp/127.0.0.1:9")
    with pytest.raises(ValueError, match="endpoint: .*is not an endpoint"):
        fiatlux.Client("127.0.0.1:9")


def test_ctrl_c_ends_the_wait_for_a_server():
    threading.Timer(0.5, _thread.interrupt_main).start()
    start = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        fiatlux.Client(["tcp/127.0.0.1:9", "tcp/127.0.0.1:19"]).run(Waver, "S05")
    assert time.monotonic() - start < 20


def test_bad_use_is_refused_by_name(tmp_path):
    wrong = [
        (lambda observation: np.zeros(52), r"action: shape \(52,\) instead of \(53,\)"),
        (lambda observation: "up", "action: cannot be read as numbers"),
    ]
    for index, (policy, match) in enumerate(wrong):
        with pytest.raises(ValueError, match=match):
            fiatlux.evaluate(policy, ["S05"], [0], out=tmp_path / f"wrong{index}", name="wrong")
    with pytest.raises(ValueError, match="action of joint 'left_hip_pitch_joint' is not finite"):
        fiatlux.evaluate(lambda observation: np.full(53, np.nan), ["S05"], [0], out=tmp_path / "nan", name="nan")
    for settings, match in [
        ({"out": tmp_path / "a", "max_steps": 3}, "max_steps"),
        ({"parallel": 2}, "parallel: only a recorded"),
        ({"record": ["camera"]}, "record: only a recorded"),
        ({"out": tmp_path / "a", "parallel": 0}, "parallel is 0"),
        ({"out": tmp_path / "a", "sensors": ["camera@often"]}, "camera@often"),
        ({"out": tmp_path / "a", "robot": "c3po"}, "c3po"),
    ]:
        with pytest.raises(ValueError, match=match):
            fiatlux.evaluate(Waver, ["S05"], [0], **settings)
    with pytest.raises(ValueError, match="parallel is 2, but one policy object"):
        fiatlux.evaluate(Waver(), ["S05"], [0], out=tmp_path / "b", parallel=2)
    with pytest.raises(fiatlux.FiatluxError, match="S05 seed 0: .*the robot does not have"):
        fiatlux.evaluate(lambda observation: np.zeros(29), ["S05"], [0], out=tmp_path / "c", robot="g1_bare")
    with pytest.raises(TypeError, match="unexpected argument 'colour'"):
        fiatlux.evaluate(Waver, ["S05"], [0], colour="red")
