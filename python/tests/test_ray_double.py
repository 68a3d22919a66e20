"""Work on a cluster ends with its caller, by a double of Ray. `extras/test_ray.py` asks Ray itself."""

import importlib
import sys
import types

import numpy as np
import pytest


class Call:
    """The result of a remote function: the work, which is done when somebody asks for it."""

    def __init__(self, work):
        self.work = work


class Remote:
    def __init__(self, function):
        self.function = function

    def options(self, **options):
        return self

    def remote(self, *arguments):
        return Call(lambda: self.function(*arguments))


def double():
    ray = types.ModuleType("ray")
    ray.cancelled = []
    ray.remote = lambda **options: Remote
    ray.put = lambda value: value
    ray.get = lambda call: call.work()
    ray.wait = lambda calls, num_returns: (calls[:num_returns], calls[num_returns:])

    def cancel(call, *, force):
        assert force, "an episode does not look whether it is wanted"
        ray.cancelled.append(call)

    ray.cancel = cancel
    return ray


@pytest.fixture
def cluster(monkeypatch):
    """The module, on a double of Ray."""
    ray = double()
    monkeypatch.setitem(sys.modules, "ray", ray)
    monkeypatch.delitem(sys.modules, "fiatlux.ray", raising=False)
    module = importlib.import_module("fiatlux.ray")
    yield module, ray
    sys.modules.pop("fiatlux.ray", None)


def zero(observation):
    return np.zeros(53)


def wrong(observation):
    return np.zeros(52)


@pytest.mark.parametrize("ended_by", [KeyboardInterrupt, RuntimeError])
def test_an_evaluation_takes_its_episodes_along(cluster, ended_by):
    module, ray = cluster

    def progress(summary):
        raise ended_by

    with pytest.raises(ended_by):
        module.evaluate(zero, ["S05", "S07"], [1000, 1001], max_steps=2, progress=progress)
    assert len(set(ray.cancelled)) == 4


def test_a_policy_that_fails_takes_its_episodes_along(cluster):
    module, ray = cluster
    with pytest.raises(ValueError, match=r"action: shape \(52,\)"):
        module.evaluate(wrong, ["S05"], [1000, 1001], max_steps=2)
    assert len(set(ray.cancelled)) == 2


def test_rollouts_that_nobody_reads_on_end(cluster):
    module, ray = cluster
    rollouts = module.rollouts(zero, "S05", [1000, 1001, 1002], max_steps=2)
    assert next(rollouts)["actions"].shape == (2, 53) and ray.cancelled == []
    rollouts.close()
    assert len(set(ray.cancelled)) == 3


def test_what_ended_by_itself_is_not_cancelled(cluster):
    module, ray = cluster
    assert len(module.evaluate(zero, ["S05"], [1000, 1001], max_steps=2).episodes) == 2
    assert len(list(module.rollouts(zero, "S05", [1000], max_steps=2))) == 1
    assert ray.cancelled == []
