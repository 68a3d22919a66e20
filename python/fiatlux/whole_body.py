"""The whole-body controller, for policies that move only arms and hands themselves."""

from os import PathLike, fspath
from typing import Any, Iterable, Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _native

LEGS_AND_WAIST = 15
"""Number of joints that the controller moves, the first ones in joint order. The policy moves the others: arms and hands."""

ARMS = 14
"""Number of joints of both arms, which come next."""


class WholeBody:
    """Walks, stands and bends on command, whatever the arms do: the controller of the policy ``wbc``.

    It needs the standard observation in the form ``"dict"``, and an episode with the benchmark's gains. What it returns are
    joint targets in rad, so a policy that uses it says so with ``action_form``::

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
        self._last: NDArray[np.float64] | None = None

    def reset(self) -> None:
        """Resets the controller for another episode."""
        self._native.restart()
        self._last = None

    def targets(self, observation: Mapping[str, Any]) -> NDArray[np.float64]:
        """The last targets of all joints, rad; at first those that the episode starts with."""
        last = np.asarray(observation["last_action"], np.float64)
        q0 = np.zeros(last.shape)
        q0[: len(self.q0)] = self.q0
        return q0 + 0.5 * last

    def hold_arms(self, observation: Mapping[str, Any], angles: ArrayLike) -> NDArray[np.float64]:
        """Returns targets with which the arms come to these angles; call it once for each observation.

        The arms' drives are soft: with the angles themselves as targets they sag by up to 0.2 rad under their own weight. It
        does not know what the hands hold.

        Args:
            observation: Fields by name; only those of proprioception are read.
            angles: Of the joints of both arms, in joint order, rad, shape (14,).

        Raises:
            ValueError: An angle is not finite, their number is not 14, or the observation lacks a field or is not finite.
        """
        wanted = np.asarray(angles, np.float64)
        if wanted.shape != (ARMS,):
            raise ValueError(f"angles: shape {wanted.shape} instead of ({ARMS},); give the angles of both arms")
        gravity, position = _read(observation, ("projected_gravity", "joint_position"))
        return np.array(self._native.hold_arms(gravity, position, wanted.tolist()))

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
            observation: Fields by name; only those of proprioception are read.
            vx, vy, wz: Velocity of the pelvis forwards and to the left, m/s, and about the vertical, rad/s.
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
        self._last = np.array(self._native.step(turning, gravity, moving, above, position, velocity, command))
        return self._last.copy()

    def _refuse_actions(self, observation: Mapping[str, Any]) -> None:
        """Refuses an episode in which the last targets came back as actions, which are half as large and relative to ``q0``."""
        if self._last is None or "last_action" not in observation:
            return
        played = np.asarray(observation["last_action"], np.float64)[:LEGS_AND_WAIST]
        if np.abs(played - np.clip(self._last, -1.0, 1.0)).max() < 1e-4:
            raise ValueError(
                "the joint targets of the last step were played as actions; evaluate with action_form='joint_target', or give "
                "the policy an attribute action_form = 'joint_target'"
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
        raise ValueError(f"observation: {error} is missing; use the form 'dict' and the sensor 'proprioception'") from error
