"""The right hand around a bulb, closed finger by finger."""

from collections import deque
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .kinematics import Kinematics

_FOLLOWS = 0.15
"""Part of the way that the noted angles go towards the sensed ones in a control step, against noise."""


class Grip:
    """Opens and closes the right hand on the way to :attr:`Kinematics.grip`; a finger that feels something presses gently from then on.

    It needs the standard observation in the form ``"dict"``. Call it once for each observation::

        grip = fiatlux.Grip(kinematics)
        targets[grip.joints] = grip(observation, 0.5)

    Args:
        kinematics: Of a robot with fingers.
        touch: Force from which on a finger feels something, N.
        press: Torque with which its joints then press, N m.
        thumb_first: Time by which the thumb moves before the fingers, s, in steps of 0.02.

    Raises:
        ValueError: The robot has no grip.
    """

    def __init__(
        self, kinematics: Kinematics, *, touch: float = 1.0, press: float = 0.3, thumb_first: float = 0.0
    ) -> None:
        if not kinematics.grip:
            raise ValueError("kinematics: this robot has no fingers; use one with hands")
        names = list(kinematics.grip)
        self.joints: NDArray[np.int64] = np.array([kinematics.joints.index(name) for name in names])
        """Where the joints of the hand that it moves are in an action."""
        self._closed = np.array(list(kinematics.grip.values()))
        self._q0, self._yields = kinematics.q0[self.joints], press / kinematics.stiffness[self.joints]
        self._touch, self._is_thumb = touch, np.array(["thumb" in name for name in names])
        finger = lambda name: name.split("_")[1]
        bodies = kinematics.hand_bodies["right"]
        self._of_finger = np.array([[finger(name) == finger(body) for body in bodies] for name in names])
        self._late = round(50 * thumb_first)
        self.reset()

    def __repr__(self) -> str:
        return f"<fiatlux.Grip: {len(self.joints)} joints>"

    def reset(self) -> None:
        """Forgets what the fingers felt, for another episode."""
        self._felt = np.zeros(len(self.joints), bool)
        self._angles: NDArray[np.float64] | None = None
        self._shares: deque[NDArray[np.float64]] = deque(maxlen=self._late + 1)

    def __call__(self, observation: Mapping[str, Any], share: ArrayLike) -> NDArray[np.float64]:
        """Targets of :attr:`joints`, rad.

        Args:
            observation: Fields by name; ``joint_position`` and ``right_hand_contact`` are read.
            share: 0 for straight fingers, 1 for the grip, below 0 beyond straight; one number, or one for each joint.
        """
        now = self._q0 + np.asarray(observation["joint_position"], np.float64)[self.joints]
        self._angles = now if self._angles is None else self._angles + _FOLLOWS * (now - self._angles)
        force = np.linalg.norm(np.asarray(observation["right_hand_contact"], np.float64), axis=1)
        self._felt |= self._of_finger @ (force > self._touch)
        self._shares.append(np.broadcast_to(np.asarray(share, np.float64), self._closed.shape))
        wanted = self._closed * np.where(self._is_thumb, self._shares[-1], self._shares[0])
        return np.minimum(wanted, np.where(self._felt, self._angles + self._yields, np.inf))
