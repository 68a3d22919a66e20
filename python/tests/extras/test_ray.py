"""Tests evaluation and rollouts on a cluster of two nodes, one of which is killed."""

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
