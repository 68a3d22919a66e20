"""Policies, and how the native part plays them."""

from collections.abc import Callable, Mapping
from threading import Event
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from . import _native
from .expert import SessionExpert
from .spaces import Layout, ObservationForm, as_actions


class Policy(Protocol):
    """Answers each observation with an action.

    A method ``reset(info)``, if the policy has one, is called at the start of each episode with its ``task``, ``instruction``,
    ``seed``, ``episode`` and ``expert``, which can be asked what it would do (:class:`fiatlux.SessionExpert`). A method
    ``look(observation)``, if it has one, is called before each action in which a sensor of the form ``"camera@look"`` could be seen
    anew, and returns the names of those to look at; an episode begins with a look. Attributes ``action_form``, ``sensors`` and
    ``robot``, if it has them, are settings that it needs, as in :class:`fiatlux.Settings`.
    """

    def __call__(self, observation: Any) -> Any: ...


PolicyLike = Policy | Callable[[Any], Any] | type
"""A policy. A class is instantiated without arguments for each episode; an object plays all of them."""


def check_policy(policy: Any) -> None:
    """Refuses what cannot be called with an observation."""
    if isinstance(policy, type) and not any("__call__" in vars(kind) for kind in policy.__mro__):
        raise TypeError(f"policy: {policy.__name__} has no method __call__(self, observation)")
    if callable(policy):
        return
    if callable(getattr(policy, "predict", None)):
        remedy = "give lambda observation: model.predict(observation, deterministic=True)[0]"
        raise TypeError(
            f"policy: a {type(policy).__name__} answers by predict; {remedy}, with observation='flat' for a flat model"
        )
    if isinstance(policy, str):
        remedy = "fiatlux evaluate --policy NAME plays those that come with it"
        raise TypeError(f"policy is {policy!r}; give a function from an observation to an action: {remedy}")
    raise TypeError(
        f"policy: a {type(policy).__name__} cannot be called; give a function from an observation to an action"
    )


def settings_for(policy: PolicyLike, given: Mapping[str, Any]) -> dict[str, Any]:
    """The settings that are given, with those that the policy has of its own."""
    settings = dict(given)
    if "task" in settings:
        raise TypeError("unexpected argument 'task' (did you mean 'tasks'?)")
    for name in ("action_form", "sensors", "robot"):
        own = getattr(policy, name, None)
        # A policy may call an object of its own by these names.
        is_named = isinstance(own, str) or (
            isinstance(own, (list, tuple)) and all(isinstance(part, str) for part in own)
        )
        if is_named and settings.setdefault(name, own) != own:
            raise ValueError(f"{name} is {settings[name]!r}, but the policy's own is {own!r}; leave it out")
    return settings


def is_stateful(policy: PolicyLike) -> bool:
    """True if the policy is one object whose ``reset`` several episodes would share."""
    return not isinstance(policy, type) and callable(getattr(policy, "reset", None))


def name_of(policy: PolicyLike) -> str:
    """The name of a policy for the record."""
    given = getattr(policy, "__name__", None)
    return given if isinstance(given, str) else type(policy).__name__


class Player:
    """A policy in one episode: numbers in, numbers out. ``begun`` is set when the episode begins."""

    def __init__(self, policy: PolicyLike, observation: ObservationForm, begun: Event | None = None) -> None:
        self._policy: Any = policy() if isinstance(policy, type) else policy
        self._observation = observation
        self._begun = begun
        self._layout: Layout | None = None

    def begin(self, info: Mapping[str, Any], spec: Mapping[str, Any]) -> None:
        """Begins an episode whose observations have these fields."""
        self._layout = Layout(spec, self._observation)
        if self._begun is not None:
            self._begun.set()
        reset = getattr(self._policy, "reset", None)
        if callable(reset):
            expert = info.get("expert")
            if isinstance(expert, _native.SessionExpert):
                info = {**info, "expert": SessionExpert(expert, self._layout.action_names)}
            reset(dict(info))

    def look(self, numbers: NDArray[np.float32]) -> list[str]:
        """Names of the sensors to look at before the action; none for a policy without ``look``."""
        look = getattr(self._policy, "look", None)
        if not callable(look):
            return []
        assert self._layout is not None
        names = look(self._layout.show(numbers, copy=False))
        if isinstance(names, str):
            raise ValueError(f"look returned {names!r}; return a list of names, [{names!r}]")
        return [str(name) for name in names or ()]

    def act(self, numbers: NDArray[np.float32]) -> NDArray[np.float64]:
        """The action that answers an observation."""
        assert self._layout is not None
        shape = self._layout.action_space.shape or ()
        action = as_actions(self._policy(self._layout.show(numbers, copy=False)), shape)
        if not np.isfinite(action).all():
            joint = self._layout.action_names[int(np.argmin(np.isfinite(action)))]
            raise ValueError(f"action of joint '{joint}' is not finite")
        return action
