"""Tests evaluation and rollouts on a cluster of two nodes, one of which is killed."""

import inspect
import json
import os
import sys
import time

import fiatlux
import fiatlux.ray
import numpy as np
import pytest
import ray
from ray.cluster_utils import Cluster

pytestmark = pytest.mark.filterwarnings("default")
# The nodes cannot import this file.
ray.cloudpickle.register_pickle_by_value(sys.modules[__name__])


class Waver:
    """A deterministic policy with state within an episode."""

    def reset(self, info):
        self.rng = np.random.default_rng(info["seed"])

    def __call__(self, observation):
        return self.rng.uniform(-0.1, 0.1, 53)


def test_signatures_name_the_settings():
    for call in (fiatlux.ray.evaluate, fiatlux.ray.rollouts, fiatlux.ray.rollout):
        parts = inspect.signature(call).parameters
        assert {"sensors", "protocol", "ranges"} <= set(parts)
        assert not any(part.kind is part.VAR_KEYWORD for part in parts.values()), call


class SlowWaver(Waver):
    """A policy slow enough that a node can be killed during an episode."""

    def __call__(self, observation):
        time.sleep(0.02)
        return super().__call__(observation)


@pytest.fixture(scope="module")
def cluster():
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "object_store_memory": 80_000_000})
    second = cluster.add_node(num_cpus=1, object_store_memory=80_000_000)
    cluster.wait_for_nodes()
    ray.init(address=cluster.address, log_to_driver=False)
    yield cluster, second
    ray.shutdown()
    cluster.shutdown()


def test_results_are_the_local_ones_though_a_node_is_lost(cluster):
    cluster, second = cluster
    assert len([node for node in ray.nodes() if node["Alive"]]) == 2
    tasks, seeds = ["S05", "S07"], [0, 1, 2]
    local = fiatlux.evaluate(Waver, tasks, seeds, max_steps=60)
    seen = []

    def progress(summary):
        if not seen:
            cluster.remove_node(second, allow_graceful=False)
        seen.append(summary)

    spread = fiatlux.ray.evaluate(SlowWaver, tasks, seeds, max_steps=60, progress=progress)
    assert len(seen) == 6 and spread.episodes == local.episodes and spread.scores == local.scores
    # Ray notices through its health checks, which may take longer than the rest of the evaluation.
    until = time.monotonic() + 120
    while len([node for node in ray.nodes() if node["Alive"]]) != 1:
        assert time.monotonic() < until, "the node that was taken away passes for alive"
        time.sleep(0.5)


def test_rollouts_are_the_local_ones(cluster):
    seeds = [3, 4]
    spread = list(fiatlux.ray.rollouts(Waver, "S05", seeds, max_steps=20, reward="training"))
    for seed, episode in zip(seeds, spread):
        local = fiatlux.ray.rollout(Waver, "S05", seed, 20, reward="training")
        for name in ("observations", "actions", "rewards"):
            np.testing.assert_array_equal(episode[name], local[name])
        assert episode["summary"] == local["summary"]
        assert episode["observations"].shape[0] == 21 and episode["actions"].shape == (20, 53)


def test_a_policy_that_fails_is_told(cluster):
    def wrong(observation):
        return np.zeros(52)

    with pytest.raises(ValueError, match=r"action: shape \(52,\)"):
        fiatlux.ray.evaluate(wrong, ["S05"], [0])


def plain(folder):
    """The results of a folder, without the names of servers and files. A busy machine may need a second attempt at an episode."""
    results = json.loads((folder / "results.json").read_text())
    for name in ("servers", "name", "folder", "repeated"):
        results["run"].pop(name, None)
    for episode in results["episodes"]:
        episode.pop("bag")
    return results


@pytest.mark.parametrize("bags", ["full", "thin"])
def test_a_recorded_evaluation_is_that_of_one_process(cluster, tmp_path, bags):
    tasks, seeds = ["S05", "S09"], [0, 1, 2]
    fiatlux.evaluate(Waver, tasks, seeds, out=tmp_path / "one")
    seen = []
    out = tmp_path / "ray"
    first = fiatlux.ray.evaluate(Waver, tasks, seeds, out=out, shard_size=4, bags=bags, progress=seen.append)
    assert first.lost == () and seen == [{"shards": 2, "done": done} for done in (1, 2)]
    assert plain(out) == plain(tmp_path / "one")
    assert {fiatlux.Bag(path).is_thin for path in out.rglob("*.mcap")} == {bags == "thin"}
    # What is lost comes again, and no more.
    (bag,) = [path for path in out.rglob("*.mcap") if "S09-s2" in path.name]
    kept = {path: path.stat().st_mtime_ns for path in out.rglob("*.mcap")}
    again = fiatlux.ray.evaluate(Waver, tasks, seeds, out=out, shard_size=4, bags=bags)
    assert again.episodes == first.episodes and {path: path.stat().st_mtime_ns for path in kept} == kept
    assert bag in kept


class Uneven(Waver):
    """A policy that cannot play one room."""

    def reset(self, info):
        super().reset(info)
        if info["seed"] == 1:
            raise RuntimeError("room 1 is too dark")


def test_an_episode_that_fails_is_a_line_and_the_rest_stays(cluster, tmp_path):
    evaluation = fiatlux.ray.evaluate(Uneven, ["S05"], [0, 1, 2], out=tmp_path, shard_size=3)
    assert [bool(episode["bag"]) for episode in evaluation.episodes] == [True, False, True]
    (line,) = evaluation.lost
    assert line.startswith("S05 seed 1: ") and "room 1 is too dark" in line


def test_wrong_arguments_fail_before_anything_is_sent(cluster, tmp_path, monkeypatch):
    fiatlux.ray.evaluate(Waver, ["S05"], [0, 1, 2], out=tmp_path / "begun", shard_size=2)
    monkeypatch.setattr(ray, "put", lambda _: pytest.fail("it was sent"))
    for wrong, reason in [
        ({"tasks": ["S99"]}, "there is no task 'S99'"),
        ({"tasks": []}, "at least one each"),
        ({"shard_size": 0}, "at least 1 episode"),
        ({"gains": "nope"}, "gain set 'nope'"),
        ({"sensors": ["nose"]}, "sensor 'nose' does not exist"),
        ({"bags": "fat"}, "use 'full' or 'thin'"),
        ({"max_steps": 3}, "whole episode"),
        ({"out": tmp_path / "begun", "shard_size": 1}, "is not of 3 shards"),
    ]:
        call = {"tasks": ["S05"], "seeds": [0, 1, 2], "out": tmp_path / "new", **wrong}
        with pytest.raises(ValueError, match=reason):
            fiatlux.ray.evaluate(Waver, **call)


class Beating(SlowWaver):
    """A policy whose every action can be seen from outside."""

    def __init__(self, file):
        self.file = file

    def __call__(self, observation):
        with open(self.file, "ab") as file:
            file.write(b".")
        return super().__call__(observation)


@pytest.mark.parametrize("ended_by", [KeyboardInterrupt, RuntimeError, GeneratorExit])
def test_work_ends_with_its_caller(cluster, tmp_path, ended_by):
    file = tmp_path / "beats"

    def progress(summary):
        raise ended_by

    policy = Beating(str(file))
    if ended_by is GeneratorExit:
        rollouts = fiatlux.ray.rollouts(policy, "S05", range(1000, 1006), max_steps=20)
        next(rollouts)
        rollouts.close()
    else:
        with pytest.raises(ended_by):
            fiatlux.ray.evaluate(policy, ["S05"], range(1000, 1006), max_steps=20, progress=progress)
    # Cancelled work may act once more. Six episodes would have 120 actions.
    until, size = time.monotonic() + 60, -1
    while (now := file.stat().st_size) != size:
        assert time.monotonic() < until, "it goes on"
        size = now
        time.sleep(2.0)
    assert 20 <= size < 100
