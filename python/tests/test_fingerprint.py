"""Tests what the digest of a policy follows."""

import functools

import numpy as np
import pytest
from fiatlux.fingerprint import digest_of

WEIGHTS = np.ones(3)
calls = 0


def linear(observation):
    global calls
    calls += 1
    return WEIGHTS * helper(observation)


def helper(observation):
    return observation


class Module:
    """With weights as PyTorch has them."""

    def __init__(self, weight):
        self.weight = weight

    def state_dict(self):
        return {"weight": np.full(2, self.weight)}


class Recurrent:
    gain = 1.0

    def __init__(self, weight=1.0):
        self.weights = {"w": np.full(3, weight)}
        self.hidden = np.zeros(3)
        self.steps = 0
        self.begun = []

    def reset(self, info):
        self.hidden = np.zeros(3)
        self.begun.append(info)

    def __call__(self, observation):
        self.hidden = self.hidden + observation
        self.steps += 1
        return self.weights["w"] * self.hidden


def test_it_follows_code_and_weights(monkeypatch):
    module = Module(1.0)

    def of_closure(observation):
        return module

    policies = [
        linear,
        Recurrent,
        Recurrent(),
        of_closure,
        functools.partial(linear, 1),
        lambda o: np.zeros(3),
        lambda o: np.ones(3),
    ]
    digests = [digest_of(policy) for policy in policies]
    assert len(set(digests)) == len(digests) and digests == [digest_of(policy) for policy in policies]
    assert digest_of(Recurrent(2.0)) != digest_of(Recurrent())
    module.weight = 2.0
    assert digest_of(of_closure) != digests[3]
    monkeypatch.setitem(globals(), "WEIGHTS", np.zeros(3))
    assert digest_of(linear) != digests[0]
    monkeypatch.undo()
    assert digest_of(linear) == digests[0]
    monkeypatch.setitem(globals(), "helper", lambda observation: 2 * observation)
    assert digest_of(linear) != digests[0]
    monkeypatch.setattr(Recurrent, "gain", 2.0)
    assert digest_of(Recurrent) != digests[1]


def test_state_does_not_count():
    policy = Recurrent()
    before = digest_of(policy), digest_of(linear)
    policy.reset({"seed": 3})
    policy(np.ones(3))
    linear(np.ones(3))
    assert (digest_of(policy), digest_of(linear)) == before


def test_a_policy_may_name_its_own():
    policy = Recurrent()
    policy.digest = "mine"
    assert digest_of(policy) == "mine"


def test_a_network_of_a_library_counts():
    torch = pytest.importorskip("torch")
    networks = [torch.nn.Linear(2, 1) for _ in range(2)]
    policies = [lambda observation, network=network: network(observation) for network in networks]
    assert digest_of(policies[0]) != digest_of(policies[1])
    networks[1].load_state_dict(networks[0].state_dict())
    assert digest_of(policies[0]) == digest_of(policies[1])
