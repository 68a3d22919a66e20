"""Asks the benchmark's scripted expert what it would do, in any state of an environment, for learning from it."""

from os import PathLike
from typing import Any, NamedTuple, NoReturn

import gymnasium
import numpy as np
from numpy.typing import NDArray

from . import _native
from ._numbers import whole
from .bag import Bag
from .env import Env
from .spaces import joint_groups
from .vector import VectorEnv

_COMMAND = len(_native.BODY_COMMAND)


class Label(NamedTuple):
    """The answer of the expert in the present state of an :class:`Env`. Numbers that it does not give are NaN."""

    joint_target: NDArray[np.float64]
    """Targets of all joints, rad, in the order of :attr:`Env.action_names`."""
    action: NDArray[np.float64]
    """The action that :meth:`Env.step` takes for it, in the form that ``action_form`` names."""
    body_command: NDArray[np.float64]
    """vx, vy, wz, height, roll, pitch and yaw for :class:`WholeBody`; NaN where the expert commands the joints of legs and waist, as on
    the ladder."""
    arms: NDArray[np.float64]
    """The part of ``joint_target`` for both arms."""
    hands: NDArray[np.float64]
    """The part of ``joint_target`` for the fingers of both hands."""
    phase: str
    """Name of what the expert does now."""
    part_done: float
    """Part of a plan that is done, from 0 to 1; NaN where none is played."""
    is_over: bool
    """The expert has nothing left to do."""
    can_label: bool
    """The expert can play on from here. Do not learn from a row where this is false."""
    reason: str | None
    """Why it cannot."""


class Labels(NamedTuple):
    """As :class:`Label`, for all worlds of a :class:`VectorEnv`; the first axis is that of the worlds."""

    joint_target: NDArray[np.float64]
    action: NDArray[np.float64]
    body_command: NDArray[np.float64]
    arms: NDArray[np.float64]
    hands: NDArray[np.float64]
    phase: NDArray[np.str_]
    part_done: NDArray[np.float64]
    is_over: NDArray[np.bool_]
    can_label: NDArray[np.bool_]
    reason: list[str | None]


class _Asking:
    """The names of a robot's joints, and how their answers are read."""

    def __init__(self, names: list[str], is_target: bool) -> None:
        groups, none = joint_groups(names), np.empty(0, np.int64)
        self.joints, self.is_target = len(names), is_target
        self.arms, self.hands = (
            np.concatenate([groups.get(f"{side}_{part}", none) for side in ("left", "right")])
            for part in ("arm", "hand")
        )

    def answers(self, worlds: int) -> NDArray[np.float64]:
        """Room for joint targets, actions, a command and two flags of each world."""
        return np.empty((worlds, 2 * self.joints + _COMMAND + 2))

    def labels(self, answers: NDArray[np.float64], told: list[tuple[str, float, str | None]]) -> Labels:
        """The answers by name; ``told`` is what is not in the array."""
        ends = [self.joints, 2 * self.joints, 2 * self.joints + _COMMAND]
        target, action, command, flags = np.split(answers, ends, axis=1)
        phases, parts, reasons = zip(*told)
        return Labels(
            joint_target=target.copy(),
            action=(target if self.is_target else action).copy(),
            body_command=command.copy(),
            arms=target[:, self.arms],
            hands=target[:, self.hands],
            phase=np.array(phases),
            part_done=np.array(parts),
            is_over=flags[:, 0] == 1,
            can_label=flags[:, 1] == 1,
            reason=list(reasons),
        )

    def label(self, answers: NDArray[np.float64], told: list[tuple[str, float, str | None]]) -> Label:
        """The only answer."""
        one = self.labels(answers, told)
        first: Any = (part[0] if isinstance(part, list) or part.ndim > 1 else part[0].item() for part in one)
        return Label(*first)


class Expert:
    """The expert of an :class:`Env`, which answers what it would do in the state that the environment is in.

    It is the policy ``expert``, which plays each task by exact poses. It reads them from the environment, so the environment's own
    ``sensors`` may be those of a student. It sees the same noise as the student. Whoever plays the environment, call :meth:`label` before
    each step: the expert follows what happens. Played from the start, its answers are to the bit those of the policy ``expert``.

    An episode that begins makes the expert begin anew, and so does :meth:`Env.restore`.

    Args:
        env: The environment, or a Gymnasium wrapper around it.
        parameters: TOML with values that differ from those of the task's file in ``crates/policies/src/hands``, for S03, S06, S08
            and S11: an expert that is easier to imitate, say. The first :meth:`label` refuses what it cannot read.
    """

    def __init__(self, env: gymnasium.Env[Any, Any], parameters: str | None = None) -> None:
        plain = env.unwrapped
        if not isinstance(plain, Env):
            raise TypeError(f"env is a {type(plain).__name__}; give a fiatlux.Env, or use Experts for a VectorEnv")
        self._env = plain
        self._native = _native.Expert(parameters)
        self._episode: _native.Episode | None = None
        self._asking = _Asking(plain.action_names, plain._settings["action_form"] == "joint_target")

    def __repr__(self) -> str:
        return f"<fiatlux.Expert of {self._env!r}>"

    def __reduce__(self) -> NoReturn:
        raise TypeError(
            "Expert cannot be copied or pickled: copy its Env, and make Expert of the copy, which begins at the present state"
        )

    def reset(self) -> None:
        """Makes the expert begin anew at the present state, as if it had seen nothing before."""
        self._native.restart()

    def label(self) -> Label:
        """Answers the present state; a second call in the same state gives the same answer.

        Raises:
            FiatluxError: The environment cannot be sensed.
            ValueError: ``parameters`` cannot be read, or the task has none.
        """
        self._env._check_begun()
        if self._env._episode is not self._episode:
            self._episode = self._env._episode
            self._native.restart()
        answers = self._asking.answers(1)
        return self._asking.label(answers, self._native.label(self._episode, answers))


def _check_shown(lacks: list[str]) -> None:
    """Refuses a policy that is not shown what the expert reads."""
    if lacks:
        raise ValueError(f"the expert reads {', '.join(lacks)}, too: add to sensors, in each observation")


class ShownExpert(Expert):
    """As :class:`Expert`, for a policy of the environment: it answers where the policy is shown what the expert reads, as on a server."""

    def label(self) -> Label:
        """As :meth:`Expert.label`.

        Raises:
            ValueError: The environment lacks a sensor.
        """
        shown = self._env._settings["sensors"]
        shown = _native.body_sensors(self._env.task.short_id) if shown is None else shown
        _check_shown([name for name in _native.EXPERT_SENSORS if name not in shown])
        return super().label()


class SessionExpert:
    """The expert of an episode on a server, for a policy anywhere: ``info["expert"]``, where ``info`` is what its ``reset`` gets.

    It answers the observation that the policy answers now, as :class:`Expert` does. The session's sensors must have all that it reads:
    ``proprioception``, ``hand_contact``, ``last_action`` and ``privileged``, in each observation. So such a policy ranks with those that
    are shown exact poses.
    """

    def __init__(self, native: _native.SessionExpert, action_names: list[str]) -> None:
        self._native = native
        self._asking = _Asking(action_names, native.is_target)

    def __reduce__(self) -> NoReturn:
        raise TypeError("SessionExpert cannot be copied or pickled: it belongs to its session")

    def reset(self) -> None:
        """Makes the expert begin anew at the present observation, as if it had seen nothing before."""
        self._native.restart()

    def label(self) -> Label:
        """Answers the present observation; a second call gives the same answer.

        Raises:
            ValueError: The session lacks a sensor.
        """
        _check_shown(self._native.lacks)
        answers = self._asking.answers(1)
        return self._asking.label(answers, self._native.label(answers))


class Experts:
    """:class:`Expert` for all worlds of a :class:`VectorEnv` of a task of the benchmark.

    Where a world's episode ends and the next one begins, its expert begins anew, and so it does in a world that
    :meth:`VectorEnv.copy_world` or :meth:`VectorEnv.restore` changed.

    Args:
        env: The worlds, or a Gymnasium wrapper around them.
        num_threads: Number of threads; by default as many as the worlds have. Answers do not depend on it.
        parameters: As of :class:`Expert`.
    """

    def __init__(
        self,
        env: gymnasium.vector.VectorEnv[Any, Any, Any],
        num_threads: int | None = None,
        parameters: str | None = None,
    ) -> None:
        plain = env.unwrapped
        if not isinstance(plain, VectorEnv):
            raise TypeError(f"env is a {type(plain).__name__}; give a fiatlux.VectorEnv, or use Expert for an Env")
        self._env = plain
        self.num_envs = plain.num_envs
        threads = plain.num_threads if num_threads is None else num_threads
        self.num_threads = whole("num_threads", threads, 1, _native.MAX_THREADS)
        self._native = _native.Experts(self.num_envs, self.num_threads, parameters)
        self._batch: _native.Batch | None = None
        self._jumps = plain._jumps.copy()
        self._asking = _Asking(plain.action_names, plain.action_form == "joint_target")

    def __repr__(self) -> str:
        return f"<fiatlux.Experts of {self._env!r}>"

    def __reduce__(self) -> NoReturn:
        raise TypeError(
            "Experts cannot be copied or pickled: copy its VectorEnv, and make Experts of the copy, which begins at the present state"
        )

    def reset(self, mask: Any = None) -> None:
        """Makes the experts of the marked worlds begin anew at their present states; by default all."""
        marks = np.ones(self.num_envs, np.bool_) if mask is None else np.ascontiguousarray(mask, np.bool_)
        if marks.shape != (self.num_envs,):
            raise ValueError(f"mask: shape {marks.shape} instead of ({self.num_envs},)")
        self._native.restart(marks)

    def label(self) -> Labels:
        """Answers the present states of all worlds, on several threads. Call it once before each step.

        Raises:
            FiatluxError: A world cannot be sensed.
            ValueError: ``parameters`` cannot be read, or the task has none.
        """
        self._env._check_begun()
        if self._env._batch is not self._batch:
            self._batch = self._env._batch
            self.reset()
        jumped = self._env._jumps != self._jumps
        if jumped.any():
            self._jumps = self._env._jumps.copy()
            self._native.restart(jumped)
        answers = self._asking.answers(self.num_envs)
        return self._asking.labels(answers, self._native.label(self._batch, answers))


def label(bag: Bag | str | PathLike[str]) -> Labels:
    """The answers that the expert would have given in each row of a recorded episode but the last; the first axis is that of the steps.

    The episode is played again by its actions while the expert follows it, whoever acted then.

    Args:
        bag: A bag or its path, of an episode in a room of the benchmark with the published thresholds and ends.

    Raises:
        ValueError: The episode, played again, is another one: it was recorded with other settings or by another version.
    """
    bag = bag if isinstance(bag, Bag) else Bag(bag)
    header, states = bag.header, bag["/state"]
    settings = {"robot": header["robot"], "gains": header["gains"], "protocol": header["episode_protocol"]}
    env = Env(header["task"], sensors=["last_action"], **settings)
    env.reset(seed=header["seed"], options={"episode": header["episode"]})
    expert, labels, is_over = Expert(env), [], False
    for number, action in enumerate(states["action"][1:]):
        labels.append(expert.label())
        if not is_over:
            _, _, terminated, truncated, _ = env.step(action)
            is_over = terminated or truncated
        if is_over != (number + 2 == len(states["action"])):
            break
    row = bag.row(len(states["action"]) - 1)
    if not is_over or any(not np.array_equal(row[name], env.row()[name]) for name in ("joint_position", "robot_pose")):
        name = f"{header['task']}, seed {header['seed']}, episode {header['episode']}"
        raise ValueError(
            f"bag: {name} played again is another episode; it was recorded with other settings or another version"
        )
    parts: Any = {name: [getattr(one, name) for one in labels] for name in Labels._fields}
    arrays: Any = {name: part if name == "reason" else np.array(part) for name, part in parts.items()}
    return Labels(**arrays)
