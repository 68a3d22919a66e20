"""Tests what the digest of a policy follows."""

import functools
import re
from unittest import mock

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


class Answers:
    """Answers every name, as proxies and test doubles do."""

    def __init__(self, weight, others=None):
        self._weight, self._others = weight, others

    def __getattr__(self, name):
        return Answers(0.0)

    def __iter__(self):
        return iter(())

    def __call__(self, *arguments):
        return self._weight


class Slotted:
    """The same without a dictionary of its own, and with an attribute whose name Python mangles."""

    __slots__ = ("__weight", "others")

    def __init__(self, weight, others=None):
        self.__weight, self.others = weight, others

    def __getattr__(self, name):
        return name

    def __call__(self, observation):
        return self.__weight


class Claims(Answers):
    """Says that it is of another class."""

    __class__ = dict  # type: ignore[assignment]

    def items(self):
        return Answers(0.0)


class Holds:
    """A policy with something else in an attribute."""

    def __init__(self, held):
        self.held = held

    def __call__(self, observation):
        return self.held(observation)


@pytest.mark.parametrize("kind", [Answers, Slotted, Claims], ids=lambda kind: kind.__name__)
@pytest.mark.parametrize("form", [lambda policy: policy, Holds, lambda policy: [policy], functools.partial])
def test_objects_that_answer_every_name_count_by_what_they_keep(kind, form):
    own = digest_of(form(kind(1.0)))
    assert re.fullmatch("[0-9a-f]{16}", own)
    assert digest_of(form(kind(1.0))) == own
    assert digest_of(form(kind(2.0))) != own
    assert digest_of(form(kind(1.0, np.ones(2)))) != own != digest_of(form(kind(1.0, Module(2.0))))


def test_doubles_of_the_standard_library_have_a_digest():
    for double in (mock.Mock(), mock.MagicMock(), mock.MagicMock(spec=dict), mock.MagicMock(spec=np.ndarray)):
        assert re.fullmatch("[0-9a-f]{16}", digest_of(Holds(double)))
