"""Arithmetic of quaternions and poses, for one or for arrays of them. Quaternions are w first; a pose is position, m, and quaternion.

``world_from_hand = compose(world_from_pelvis, pelvis_from_hand)``, and the other way around
``pelvis_from_hand = compose(inverse(world_from_pelvis), world_from_hand)``.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]


def multiply(a: ArrayLike, b: ArrayLike) -> Array:
    """Product of quaternions: turns by ``b``, then by ``a``."""
    aw, ax, ay, az = np.moveaxis(np.asarray(a, np.float64), -1, 0)
    bw, bx, by, bz = np.moveaxis(np.asarray(b, np.float64), -1, 0)
    parts = (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )
    return np.stack(parts, -1)


def conjugate(quaternion: ArrayLike) -> Array:
    """The opposite turn of a unit quaternion."""
    return np.asarray(quaternion, np.float64) * np.array([1.0, -1.0, -1.0, -1.0])


def rotate(quaternion: ArrayLike, vector: ArrayLike) -> Array:
    """Vectors turned by unit quaternions."""
    q, v = np.asarray(quaternion, np.float64), np.asarray(vector, np.float64)
    u, w = q[..., 1:], q[..., :1]
    t = 2.0 * np.cross(u, v)
    turned: Array = v + w * t + np.cross(u, t)
    return turned


def of_vector(vector: ArrayLike) -> Array:
    """Quaternions of rotation vectors, rad."""
    v = np.asarray(vector, np.float64)
    angle = np.linalg.norm(v, axis=-1, keepdims=True)
    return np.concatenate((np.cos(angle / 2), 0.5 * np.sinc(angle / (2 * np.pi)) * v), -1)


def to_vector(quaternion: ArrayLike) -> Array:
    """Rotation vectors of unit quaternions, rad, no longer than half a turn."""
    q = np.asarray(quaternion, np.float64)
    q = np.where(q[..., :1] < 0, -q, q)
    length = np.linalg.norm(q[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(length, q[..., :1])
    return q[..., 1:] * np.where(length > 1e-9, angle / np.maximum(length, 1e-9), 2.0)


def heading(quaternion: ArrayLike) -> Array:
    """Turn about the vertical of the x axis of what has this quaternion, rad."""
    w, x, y, z = np.moveaxis(np.asarray(quaternion, np.float64), -1, 0)
    turned: Array = np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return turned


def upright(pose: ArrayLike) -> Array:
    """Poses at the same places that only turn about the vertical, by their :func:`heading`: with ``transform(inverse(upright(robot)), point)`` a
    point is so far ahead of the robot, to its left and above it."""
    given = _poses("pose", np.asarray(pose, np.float64))
    half = heading(given[..., 3:]) / 2
    zero = np.zeros_like(half)
    return np.concatenate((given[..., :3], np.stack((np.cos(half), zero, zero, np.sin(half)), -1)), -1)


def of(observation: Mapping[str, Any], thing: str) -> Array:
    """World pose of a thing in an observation of the form ``"dict"`` with the sensor ``privileged``, such as ``robot`` or ``fresh_bulb``."""
    names = [f"privileged.{thing}_{part}" for part in ("position", "quaternion")]
    if missing := [name for name in names if name not in observation]:
        known = [name.removeprefix("privileged.").removesuffix("_quaternion") for name in observation]
        things = sorted(name for name in known if f"privileged.{name}_quaternion" in observation)
        raise ValueError(
            f"observation: {missing[0]!r} is missing; "
            + (f"known are {things}" if things else "add the sensor 'privileged'")
        )
    return np.concatenate([np.asarray(observation[name], np.float64) for name in names], -1)


def compose(a: ArrayLike, b: ArrayLike) -> Array:
    """``world_from_b`` of ``world_from_a`` and ``a_from_b``; what counts as the world may be anything."""
    a, b = np.asarray(a, np.float64), np.asarray(b, np.float64)
    a, b = np.broadcast_arrays(_poses("a", a), _poses("b", b))
    return np.concatenate((a[..., :3] + rotate(a[..., 3:], b[..., :3]), multiply(a[..., 3:], b[..., 3:])), -1)


def inverse(pose: ArrayLike) -> Array:
    """``b_from_a`` of ``a_from_b``."""
    given = _poses("pose", np.asarray(pose, np.float64))
    turn = conjugate(given[..., 3:])
    return np.concatenate((-rotate(turn, given[..., :3]), turn), -1)


def transform(pose: ArrayLike, point: ArrayLike) -> Array:
    """A point of ``b`` in the frame of ``a``, of ``a_from_b``."""
    given = _poses("pose", np.asarray(pose, np.float64))
    moved: Array = given[..., :3] + rotate(given[..., 3:], point)
    return moved


def _poses(name: str, given: Array) -> Array:
    if given.shape[-1:] != (7,):
        raise ValueError(f"{name}: shape {given.shape} instead of (..., 7); give position and quaternion, w first")
    length = np.linalg.norm(given[..., 3:], axis=-1)
    if not (np.abs(length - 1.0) < 1e-3).all():
        raise ValueError(f"{name}: a quaternion's length is not 1; positions come first, then w, x, y, z")
    return given
