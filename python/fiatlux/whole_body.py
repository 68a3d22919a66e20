"""The whole-body controller, for policies that move only arms and hands themselves."""

import itertools
import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from os import PathLike, fspath
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _native
from ._memory import check_memory
from ._numbers import whole


@dataclass(frozen=True)
class Reached:
    """Angles that take hands to their goals, and how near they can come. It counts as the array of its angles."""

    angles: NDArray[np.float64]
    """Of the joints of both arms, in joint order, rad, shape (14,): for the next control step."""
    position_error: NDArray[np.float64]
    """For the left and the right hand, the distance between the goal and the nearest pose that was found for the arm alone, m; NaN for a
    hand without a goal. What stays above some millimetres is out of reach: step, bend or turn."""
    rotation_error: NDArray[np.float64]
    """The same of the turn, rad."""

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.array(self.angles, dtype)

    def __len__(self) -> int:
        return len(self.angles)

    def __getitem__(self, index: Any) -> Any:
        return self.angles[index]


LEGS_AND_WAIST = 15
"""Number of joints that the controller moves, the first ones in joint order. The policy moves the others: arms and hands."""

ARMS = 14
"""Number of joints of both arms, which come next."""

DEAD_ZONE: tuple[float, float, float] = tuple(_native.STANDS_BELOW)  # type: ignore[assignment]
"""Speeds ahead and to the left, m/s, and about the vertical, rad/s. Where all three of a command are below, the robot stands."""


class WholeBody:
    """Walks, stands and bends on command, whatever the arms do: the controller of the policy ``wbc``.

    It needs the standard observation in the form ``"dict"``, and an episode with the benchmark's gains. What it returns are
    joint targets in rad, so a policy that uses it says so with ``action_form``. Targets that come back as actions are refused,
    which only the sensor ``last_action`` shows: without it there is a warning::

        class Wave:
            action_form = "joint_target"

            def reset(self, info):
                self.body = fiatlux.WholeBody()
                self.arms = self.body.q0[15:].copy()
                self.arms[1] += 0.5  # the left one goes up sideways

            def __call__(self, observation):
                targets = self.body.targets(observation)
                targets[:15] = self.body(observation, vx=0.3)
                targets[15:29] = self.body.hold_arms(observation, self.arms)
                return targets

    Args:
        weights: File that ``python -m fiatlux.train export`` wrote, in place of the weights that come with the package.

    Raises:
        ValueError: The file is damaged, or made for another engine.
    """

    def __init__(self, weights: str | PathLike[str] | None = None) -> None:
        self._native = _native.WholeBody(None if weights is None else fspath(weights))
        joints = self._native.joints()
        self.joint_names: list[str] = [joint[0] for joint in joints]
        """Names of the joints of legs, waist and arms, in the order of actions."""
        self.q0: NDArray[np.float64] = np.array([joint[1] for joint in joints])
        """Their angles in the standing posture, rad."""
        self._last: dict[str, NDArray[np.float64]] = {}
        """The targets that each method returned last, of the joints of legs, waist and arms; NaN for those it does not move."""
        self._has_warned = False

    def __repr__(self) -> str:
        return f"<fiatlux.WholeBody: legs, waist and arms, {len(self.joint_names)} joints>"

    def reset(self) -> None:
        """Resets the controller for another episode."""
        self._native.restart()
        self._last.clear()

    def targets(self, observation: Mapping[str, Any]) -> NDArray[np.float64]:
        """The last targets of all joints, rad; at first those that the episode starts with.

        Raises:
            ValueError: The observation lacks ``last_action``, or the last targets were played as actions.
        """
        if "last_action" not in observation:
            raise ValueError("observation: 'last_action' is missing; use the form 'dict' and the sensor 'last_action'")
        self._refuse_actions(observation)
        last = np.asarray(observation["last_action"], np.float64)
        q0 = np.zeros(last.shape)
        q0[: len(self.q0)] = self.q0
        targets = q0 + 0.5 * last
        self._note("targets", slice(0, len(self.q0)), targets[: len(self.q0)])
        return targets

    def hold_arms(self, observation: Mapping[str, Any], angles: ArrayLike) -> NDArray[np.float64]:
        """Returns targets with which the arms come to these angles; call it once for each observation.

        The arms' drives are soft: with the angles themselves as targets they sag by up to 0.2 rad under their own weight. It
        does not know what the hands hold.

        Args:
            observation: Fields by name; only those of proprioception and ``last_action`` are read.
            angles: Of the joints of both arms, in joint order, rad, shape (14,).

        Raises:
            ValueError: An angle is not finite, their number is not 14, the observation lacks a field or is not finite, or the
                last targets were played as actions.
        """
        wanted = np.asarray(angles, np.float64)
        if wanted.shape != (ARMS,):
            raise ValueError(f"angles: shape {wanted.shape} instead of ({ARMS},); give the angles of both arms")
        gravity, position = _read(observation, ("projected_gravity", "joint_position"))
        self._refuse_actions(observation)
        targets = np.array(self._native.hold_arms(gravity, position, wanted.tolist()))
        self._note("hold_arms", slice(LEGS_AND_WAIST, LEGS_AND_WAIST + ARMS), targets)
        return targets

    def palms(self, observation: Mapping[str, Any]) -> NDArray[np.float64]:
        """Poses of the left and the right palm in the pelvis frame: position, m, and quaternion, w first; shape (2, 7)."""
        (position,) = _read(observation, ("joint_position",))
        return np.array(self._native.palms(position))

    def reach(
        self,
        observation: Mapping[str, Any],
        *,
        left: ArrayLike | None = None,
        right: ArrayLike | None = None,
        firmness: ArrayLike = (1.0, 1.0, 1.0),
    ) -> Reached:
        """Returns angles of both arms that take the hands to poses, and what remains; call it once for each observation.

        Give the angles to :meth:`hold_arms`, which adds what the arms weigh. A hand that is blocked presses, and does not press
        more with time; it comes back as soon as its goal does.

        Args:
            observation: Fields by name; only those of proprioception are read.
            left, right: Pose of the palm in the pelvis frame (7 numbers, as of :meth:`palms`); without it, the arm stays.
            firmness: How firmly the hands are held there along x, y and z of the pelvis, from 0 (not at all) to 1.

        Raises:
            ValueError: A pose does not have 7 numbers or is not finite, or the observation lacks a field or is not finite.
        """
        (position,) = _read(observation, ("joint_position",))
        firm = np.broadcast_to(np.asarray(firmness, np.float64), (3,)).tolist()
        goals: list[tuple[list[float], list[float]] | None] = []
        for side, pose in (("left", left), ("right", right)):
            given = None if pose is None else np.asarray(pose, np.float64)
            if given is not None and given.shape != (7,):
                raise ValueError(
                    f"{side}: shape {given.shape} instead of (7,); give position and quaternion of the palm"
                )
            goals.append(None if given is None else (given.tolist(), firm))
        angles, left_over = self._native.reach(position, goals)
        errors = np.array([(np.nan, np.nan) if rest is None else rest for rest in left_over])
        return Reached(np.array(angles), errors[:, 0], errors[:, 1])

    def __call__(
        self,
        observation: Mapping[str, Any],
        *,
        vx: float = 0.0,
        vy: float = 0.0,
        wz: float = 0.0,
        height: float = 0.75,
        roll: float = 0.0,
        pitch: float = 0.0,
        yaw: float = 0.0,
    ) -> NDArray[np.float64]:
        """Returns the targets of the 15 joints of legs and waist, rad; call it once for each observation.

        Args:
            observation: Fields by name; only those of proprioception and ``last_action`` are read.
            vx, vy, wz: Velocity of the pelvis forwards and to the left, m/s, and about the vertical, rad/s. Where all three are
                below :data:`fiatlux.whole_body.DEAD_ZONE` (0.05), the robot stands still: it takes no smaller steps.
            height: Height of the pelvis above the floor, m.
            roll, pitch, yaw: Angles of the torso, rad, relative to upright axes that point where the pelvis points.

        Raises:
            ValueError: The command is outside the trained range, the observation lacks a field or is not finite, or the
                last targets were played as actions.
        """
        command = [vx, vy, wz, height, roll, pitch, yaw]
        self._native.check(command)
        turning, gravity, moving, base_height, position, velocity = _read(observation, _FIELDS)
        (above,) = base_height
        self._refuse_actions(observation)
        targets = np.array(self._native.step(turning, gravity, moving, above, position, velocity, command))
        self._note("legs and waist", slice(0, LEGS_AND_WAIST), targets)
        return targets

    def joint_targets(
        self,
        observation: Mapping[str, Any],
        *,
        arms: ArrayLike | None = None,
        vx: float = 0.0,
        vy: float = 0.0,
        wz: float = 0.0,
        height: float = 0.75,
        roll: float = 0.0,
        pitch: float = 0.0,
        yaw: float = 0.0,
    ) -> NDArray[np.float64]:
        """Returns targets of all joints, rad: legs and waist follow a command; call it once for each observation.

        Args:
            observation: Fields by name; those of proprioception and ``last_action`` are read.
            arms: Angles at which both arms are held, as of :meth:`hold_arms`; without them their targets stay, as those of the hands do.
            vx, vy, wz, height, roll, pitch, yaw: As of a call of the controller itself.

        Raises:
            ValueError: As of :meth:`targets`, :meth:`hold_arms` and a call.
        """
        targets = self.targets(observation)
        targets[:LEGS_AND_WAIST] = self(
            observation, vx=vx, vy=vy, wz=wz, height=height, roll=roll, pitch=pitch, yaw=yaw
        )
        if arms is not None:
            targets[LEGS_AND_WAIST : LEGS_AND_WAIST + ARMS] = self.hold_arms(observation, arms)
        return targets

    def _note(self, method: str, place: slice, targets: NDArray[np.float64]) -> None:
        """Keeps what a method returned, for the check of the next step."""
        noted = np.full(len(self.q0), np.nan)
        noted[place] = targets
        self._last[method] = noted

    def _refuse_actions(self, observation: Mapping[str, Any]) -> None:
        """Refuses an episode in which the last targets came back as actions, which are half as large and relative to ``q0``."""
        if not self._last:
            return
        if "last_action" not in observation:
            if not self._has_warned:
                self._has_warned = True
                message = (
                    "WholeBody cannot tell whether its joint targets are played as actions, for the observation has no "
                    "last_action; add the sensor 'last_action'"
                )
                warnings.warn(message, stacklevel=3)
            return
        played = np.asarray(observation["last_action"], np.float64)[: len(self.q0)]
        # The policy may have replaced a part of what a method returned. A target of 0 tells nothing, nor does one that is clipped.
        for noted, part in itertools.product(
            self._last.values(), (slice(0, LEGS_AND_WAIST), slice(LEGS_AND_WAIST, None))
        ):
            tells = (0.01 < np.abs(noted[part])) & (np.abs(noted[part]) < 1.0)
            if tells.sum() > 1 and np.abs(played[part] - noted[part])[tells].max() < 1e-4:
                raise ValueError(
                    "WholeBody: the joint targets of the last step were played as actions; evaluate with "
                    "action_form='joint_target', or give the policy an attribute action_form = 'joint_target'"
                )


_FIELDS = (
    "base_angular_velocity",
    "projected_gravity",
    "base_linear_velocity",
    "base_height",
    "joint_position",
    "joint_velocity",
)


def _read(observation: Mapping[str, Any], names: Iterable[str]) -> list[list[float]]:
    try:
        return [np.asarray(observation[name], np.float64).ravel().tolist() for name in names]
    except (KeyError, TypeError, IndexError) as error:
        raise ValueError(
            f"observation: {error} is missing; use the form 'dict' and the sensor 'proprioception'"
        ) from error


_BODY_BYTES = 200_000
"""A controller takes somewhat more."""


class WholeBodies:
    """:class:`WholeBody` for many worlds: legs and waist follow commands, hands go to poses, arms are borne.

    Args:
        num_envs: Number of worlds.
        num_threads: Number of threads; results do not depend on it.
        weights: As of :class:`WholeBody`.
        bends_low: A robot that stands may be commanded to a height of 0.40 m and a pitch of 1.2 rad, as the expert does in S06 and S08.
        steps: Without, it never takes a step, not even to catch itself, as on the ladder's platform in S03 and S11.

    Raises:
        ValueError: The file is damaged, or made for another engine.
    """

    def __init__(
        self,
        num_envs: int,
        num_threads: int = 1,
        weights: str | PathLike[str] | None = None,
        *,
        bends_low: bool = False,
        steps: bool = True,
    ) -> None:
        self.num_envs = whole("num_envs", num_envs, 1, _native.MAX_WORLDS)
        threads = whole("num_threads", num_threads, 1, _native.MAX_THREADS)
        check_memory(num_envs * _BODY_BYTES, f"num_envs: no memory for the controllers of {num_envs} worlds")
        file, stance = None if weights is None else fspath(weights), [bool(bends_low), not steps]
        self._native = _native.WholeBodies(self.num_envs, threads, file, stance)

    def __repr__(self) -> str:
        return f"<fiatlux.WholeBodies: {self.num_envs} worlds>"

    def reset(self, mask: Any = None) -> None:
        """Resets the controllers of the marked worlds for another episode; by default all."""
        marks = np.ones(self.num_envs, np.bool_) if mask is None else np.ascontiguousarray(mask, np.bool_)
        if marks.shape != (self.num_envs,):
            raise ValueError(f"mask: shape {marks.shape} instead of ({self.num_envs},)")
        self._native.restart(marks)

    def palms(self, sensed: ArrayLike) -> NDArray[np.float64]:
        """Poses of both palms in the pelvis frame, as of :meth:`WholeBody.palms`; shape (worlds, 2, 7)."""
        numbers, joints = self._sensed(sensed)
        palms = np.zeros((self.num_envs, 2, 7))
        self._native.palms(numbers, joints, palms)
        return palms

    def __call__(self, sensed: ArrayLike, commands: ArrayLike, goals: ArrayLike) -> NDArray[np.float64]:
        """Targets of legs, waist and arms, rad, shape (worlds, 29); call it once for each observation.

        Args:
            sensed: The sensor ``proprioception`` of each world as a flat vector.
            commands: vx, vy, wz, height, roll, pitch and yaw of each world, as of :class:`WholeBody`; what is beyond the trained
                range counts as its end.
            goals: Poses of both palms in the pelvis frame, shape (worlds, 2, 7); NaN where an arm stays where it is.

        Raises:
            ValueError: A shape is wrong, or what is sensed is not finite.
        """
        numbers, joints = self._sensed(sensed)
        targets = np.zeros((self.num_envs, LEGS_AND_WAIST + ARMS))
        wanted = self._shaped("commands", commands, (7,)), self._shaped("goals", goals, (2, 7))
        self._native.step(numbers, joints, *wanted, targets)
        return targets

    def _shaped(self, name: str, value: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float64]:
        array = np.ascontiguousarray(value, np.float64)
        if array.shape != (self.num_envs, *shape):
            raise ValueError(f"{name}: shape {array.shape} instead of {(self.num_envs, *shape)}")
        return array

    def _sensed(self, sensed: ArrayLike) -> tuple[NDArray[np.float64], int]:
        """The sensed quantities, and the number of joints in it."""
        numbers = np.ascontiguousarray(sensed, np.float64)
        joints, rest = divmod(numbers.shape[-1] - 10, 2)
        if numbers.shape != (self.num_envs, 10 + 2 * joints) or rest or joints < LEGS_AND_WAIST + ARMS:
            raise ValueError(
                f"sensed: shape {numbers.shape}; give the sensor 'proprioception' of each of {self.num_envs} worlds"
            )
        return numbers, joints
