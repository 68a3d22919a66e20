"""The climb of the step ladder as a controller, for policies that say how fast and how upright."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _native
from .whole_body import _FIELDS

_TERMS = (*_FIELDS, "last_action")


class Climber:
    """Climbs the step ladder on command, up or down, and keeps the robot's balance: what the policy ``climb`` does.

    It needs the sensors ``proprioception`` and ``last_action`` in the form ``"dict"``, the benchmark's robot and gains, and where the ladder
    is. The robot may begin a few steps before the ladder, which it then walks, or anywhere in the climb. What it returns are joint
    targets, rad::

        climber = fiatlux.Climber("S12")
        robot, ladder = poses.of(observation, "robot"), poses.of(observation, "ladder")
        targets = climber(observation, poses.compose(poses.inverse(robot), ladder), rate=0.5)

    Args:
        task: The climb: ``"S02"`` up, ``"S10"`` up with a bulb in the right hand, ``"S12"`` down, ``"S04"`` down with a bulb.

    Raises:
        ValueError: Another task.
    """

    def __init__(self, task: str) -> None:
        self._native = _native.Climber(task)
        self._task = task

    def __repr__(self) -> str:
        return f"<fiatlux.Climber: {self._task}>"

    def reset(self) -> None:
        """Begins another episode with the next observation."""
        self._native.restart()

    def __call__(
        self,
        observation: Mapping[str, Any],
        ladder: ArrayLike,
        *,
        rate: float = 1.0,
        lean: tuple[float, float] = (0.0, 0.0),
    ) -> NDArray[np.float64]:
        """Returns the targets of all joints, rad; call it once for each observation.

        Args:
            observation: Fields by name; only those of proprioception and ``last_action`` are read.
            ladder: Pose of the ladder in the pelvis frame: position, m, and quaternion, w first; shape (7,).
            rate: Part of the plan's own speed, from 0, which waits, to 1.25.
            lean: By how much farther ahead and to the left the centre of mass is wanted, m, at most 0.03 each way.

        Raises:
            ValueError: A number is missing, not finite or out of range, or the climb cannot be played from where the robot is.
        """
        pose = np.asarray(ladder, np.float64)
        if pose.shape != (7,) or not np.isfinite(pose).all() or abs(np.linalg.norm(pose[3:]) - 1) > 1e-3:
            raise ValueError("ladder: give a position, m, and a unit quaternion, w first; shape (7,)")
        if missing := [name for name in _TERMS if name not in observation]:
            raise ValueError(
                f"observation: '{missing[0]}' is missing; use the form 'dict' and the sensor 'last_action'"
            )
        terms = [np.asarray(observation[name], np.float32).ravel() for name in _TERMS]
        if wrong := [name for name, term in zip(_TERMS, terms) if not np.isfinite(term).all()]:
            raise ValueError(f"observation: '{wrong[0]}' is not finite")
        sensed: Any = tuple(
            term.tolist() if name != "base_height" else float(term[0]) for name, term in zip(_TERMS, terms)
        )
        command = float(rate), (float(lean[0]), float(lean[1]))
        return np.array(self._native.step(sensed, pose.tolist(), command))

    @property
    def phase(self) -> str:
        """Name of what it does now."""
        return self._native.progress()[0]

    @property
    def part_done(self) -> float:
        """Part of the climb that is done, from 0 to 1; NaN before it begins."""
        done = self._native.progress()[1]
        return float("nan") if done is None else done
