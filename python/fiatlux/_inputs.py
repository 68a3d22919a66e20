"""Inputs and outputs of a policy of ``train_lerobot``: where a bag has it, how a checkpoint names it, and its mapping for the bridge."""

import hashlib
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from .bag import Bag, scans_of

Images = Mapping[str, Mapping[int, NDArray[np.uint8]]]
Hands = Literal["right", "both"]

CAMERAS = {"camera": "head", "chest_camera": "chest"}
"""Cameras that the bridge knows, and what they are called."""
STATE = ("base_angular_velocity", "projected_gravity", "base_linear_velocity", "base_height", "joint_position")
"""Terms of proprioception, the first part of a state."""
STRIDE = 5
"""Control steps in a row of a chunk."""
RATE_HZ = 10
"""Rows of a chunk in a second."""
BODY = 29
"""Joints of legs, waist and arms, the first ones; fingers follow."""
ARMS = slice(15, BODY)
MAX_FORCE = 20.0
"""Limit of a contact force, N. A grip on a bulb presses with up to 23 N; impacts are many times stronger and say no more."""
LIDAR_COLUMNS = 180
"""Azimuths of a scan (``crates/robot/src/lidar.rs``), once round: behind, left, ahead, right."""
LIDAR_RANGE = 10.0
"""Where nothing is hit, m."""
MIN_STD = {"proprioception": 0.02, "contact": 2.0, "lidar": 0.1}
"""Smaller deviations of a state are noise, and are not blown up: SI units; N; m. Most bodies of a hand feel nothing, ever."""
MAX_BACK = 200
"""Oldest picture, rows."""
MAX_PAST = 4
"""Pictures of the past."""
HORIZON = 20
"""Usual rows of a chunk."""
MAX_CHUNK = 400
"""Most rows of a chunk that the bridge takes."""
SIZE = (128, 128)
"""Usual width and height of a picture, pixels."""
PREFIX = 5
"""Rows of a chunk that are played."""

_VIEW = re.compile(r"(.+?)(?:@-([1-9][0-9]*))?")


def picture_name(cameras: Sequence[str], rows: Sequence[int]) -> str:
    """Name of a picture in which views stand side by side: of each camera, from the oldest on. ``rows`` are 0 and below.

    ACT adds the same positions to all of its pictures, so that it could not tell two from each other; places in one it can.
    """
    return "+".join(f"{camera}@{row}" if row else camera for camera in cameras for row in rows)


def views(name: str) -> list[tuple[str, int]]:
    """The views of a picture by its name, from left to right: the camera, and the row relative to now, 0 or below.

    Any other name is that of a camera.
    """
    parts = [part for part in map(_VIEW.fullmatch, name.split("+")) if part and part[1] in CAMERAS]
    if len(parts) < len(name.split("+")):
        return [(name, 0)]
    return [(part[1], -int(part[2] or 0)) for part in parts]


def rows_back(seconds: Sequence[float]) -> tuple[int, ...]:
    """Rows that pictures of so long ago are back, the oldest first.

    Raises:
        ValueError: A time is not a multiple of a row, or out of range; there are two of one row, or too many.
    """
    rows = []
    for time in seconds:
        row = round(time * RATE_HZ) if math.isfinite(time) else 0
        if not 1 <= row <= MAX_BACK or abs(time * RATE_HZ - row) > 1e-6:
            raise ValueError(f"--history is {time:g}; give multiples of 0.1 s, from 0.1 to {MAX_BACK / RATE_HZ:g}")
        rows.append(row)
    if len(set(rows)) < len(rows) or len(rows) > MAX_PAST:
        raise ValueError(f"--history has {len(rows)} times; give at most {MAX_PAST}, each once")
    return tuple(sorted(rows, reverse=True))


def sectors(points: NDArray[np.float32], count: int) -> NDArray[np.float32]:
    """The nearest range in each of ``count`` equal sectors, m, from behind by the left; 10 where nothing is hit.

    The bridge pools in the same way (``crates/bridge/src/lidar.rs``), and one file has the numbers that test both.

    Args:
        points: Hits of a scan in the LiDAR's frame, points x 3, m.
        count: A number that divides the 180 columns of a scan.
    """
    x, y, _ = np.asarray(points, np.float64).reshape(-1, 3).T
    column = np.rint((np.arctan2(y, x) / (2 * np.pi) + 0.5) * LIDAR_COLUMNS).astype(int) % LIDAR_COLUMNS
    nearest = np.full(count, LIDAR_RANGE)
    np.minimum.at(nearest, column * count // LIDAR_COLUMNS, np.linalg.norm(np.reshape(points, (-1, 3)), axis=1))
    return nearest.astype(np.float32)


@dataclass(frozen=True)
class Inputs:
    """The choice of inputs and actions; by default what the mapping ``lerobot_g1_hand`` plays.

    Raises:
        ValueError: A choice is out of range; the message names the option.
    """

    cameras: tuple[str, ...] = ("camera",)
    """Of :data:`CAMERAS`."""
    contacts: bool = False
    """The state has the forces on the bodies of both hands, N, each number within :data:`MAX_FORCE`."""
    lidar: int = 0
    """Sectors of the LiDAR in the state; 0 for none."""
    history: tuple[int, ...] = ()
    """Rows that other pictures are back, the oldest first."""
    hands: Hands = "right"
    """Whose fingers are actions."""

    def __post_init__(self) -> None:
        known = [camera for camera in CAMERAS if camera in self.cameras]
        if not known or sorted(known) != sorted(self.cameras):
            raise ValueError(f"--cameras is {' '.join(self.cameras)}; give {' or '.join(CAMERAS)}, or both, each once")
        object.__setattr__(self, "cameras", tuple(known))
        if self.lidar < 0 or self.lidar and LIDAR_COLUMNS % self.lidar:
            raise ValueError(
                f"--lidar is {self.lidar}; give a number of sectors that divides {LIDAR_COLUMNS}, such as 12"
            )

    @property
    def rows(self) -> tuple[int, ...]:
        """Rows of the pictures relative to now, the oldest first; the last is 0."""
        return (*(-back for back in self.history), 0)

    @property
    def record(self) -> str:
        """Value of ``--record`` with which demonstrations have pictures and scans; forces they have unless ``--sensors`` leaves them out."""
        return ",".join(f"{name}@{RATE_HZ}" for name in (*self.cameras, *(["lidar"] if self.lidar else [])))

    def pictures(self, images: Images, end: int) -> tuple[list[int], NDArray[np.uint8]]:
        """Control steps before ``end`` at which a row begins, and their pictures, steps x height x width x 3 for each camera.

        Raises:
            ValueError: A camera has no pictures, or too few.
        """
        seen = [images.get(camera, {}) for camera in self.cameras]
        for camera, of in zip(self.cameras, seen):
            if not of:
                raise ValueError(f"has no pictures of the {CAMERAS[camera]} camera; record with --record {self.record}")
        steps = [step for step in sorted(seen[0]) if step % STRIDE == 0 and step < end]
        if not steps:
            raise ValueError(
                f"has no pictures of the {CAMERAS[self.cameras[0]]} camera; record with --record {self.record}"
            )
        for camera, of in zip(self.cameras, seen):
            # Pictures that stand for others must be those that the bridge will show.
            wanted = range(0, end, STRIDE) if self.history else steps
            if missing := [step for step in wanted if step not in of]:
                raise ValueError(
                    f"has no picture of the {CAMERAS[camera]} camera at step {missing[0]}; record with --record {self.record}"
                )
        if len({of[step].shape for of in seen for step in steps}) > 1:
            raise ValueError("has pictures of several sizes; record all cameras with one --image")
        return steps, np.stack([np.concatenate([of[step] for of in seen], axis=2) for step in steps])

    def state(self, bag: Mapping[str, Mapping[str, Any]], steps: Sequence[int]) -> NDArray[np.float32]:
        """The state at these control steps, steps x numbers: proprioception, forces on the right and on the left hand, sectors.

        Raises:
            ValueError: The bag lacks forces or scans.
        """
        sensed, rows = bag["/observation"], len(bag["/state"]["step"])
        parts = [np.reshape(sensed[f"proprioception.{name}"], (rows, -1))[steps] for name in STATE]
        if self.contacts:
            forces = sensed.get("hand_contact_force", ())
            missing = [step for step in steps if step >= len(forces) or len(forces[step]) == 0]
            if missing:
                raise ValueError(
                    f"has no forces on the hands at step {missing[0]}; demonstrate with hands, and leave --sensors out or name hand_contact there"
                )
            felt = np.stack([np.asarray(forces[step], np.float32) for step in steps])
            parts.append(np.clip(felt, -MAX_FORCE, MAX_FORCE))
        if self.lidar:
            scans = scans_of(bag)
            if missing := [step for step in steps if step not in scans]:
                raise ValueError(f"has no scan of the LiDAR at step {missing[0]}; record with --record {self.record}")
            parts.append(np.stack([sectors(scans[step], self.lidar) for step in steps]))
        state = np.concatenate(parts, axis=1).astype(np.float32)
        if not np.isfinite(state).all():
            raise ValueError("has a state with a number that is not finite; leave that bag out")
        return state

    def least_std(self, width: int, bodies: int) -> NDArray[np.float32]:
        """The least standard deviations by which a state of ``width`` numbers is scaled; the robot's hands have ``bodies`` that feel."""
        lidar = width - self.lidar
        forces = lidar - (3 * bodies if self.contacts else 0)
        least = np.full(width, MIN_STD["proprioception"], np.float32)
        least[forces:lidar], least[lidar:] = MIN_STD["contact"], MIN_STD["lidar"]
        return least

    def fingers(self, names: Sequence[str]) -> list[int]:
        """Indices of the fingers that are actions among a robot's joints: of the left hand, if it has some, then of the right one."""
        sides = {"right": [("R_", "right_")], "both": [("L_", "left_"), ("R_", "right_")]}[self.hands]
        return [index for side in sides for index in range(BODY, len(names)) if names[index].startswith(side)]

    def _name(self, size: tuple[int, int], chunk: int, sees_room: bool) -> str:
        """Name of the mapping, of at most 64 letters: it is part of the policy's, so that what plays differently is called so."""
        cameras = "-cameras" if len(self.cameras) > 1 else "" if self.cameras == ("camera",) else "-chest"
        past = "-back" + ".".join(map(str, self.history)) if self.history else ""
        lidar = f"-{'room' if sees_room else 'lidar'}{self.lidar}" if self.lidar else ""
        both = "-both" if self.hands == "both" else ""
        seen = "" if size == SIZE else f"-{size[0]}x{size[1]}"
        rows = "" if chunk == HORIZON else f"-rows{chunk}"
        name = f"lerobot_g1_hand{cameras}{'-touch' if self.contacts else ''}{lidar}{past}{both}{seen}{rows}"
        return name if len(name) <= 64 else f"lerobot_g1_hand-{hashlib.sha256(name.encode()).hexdigest()[:12]}"

    def mapping(self, size: tuple[int, int], chunk: int, *, sees_room: bool = False) -> str:
        """The mapping with which the bridge plays a checkpoint, as TOML.

        Args:
            size: Width and height of a camera's picture, pixels.
            chunk: Rows of a chunk.
            sees_room: The LiDAR of the demonstrations sees bench, crate and walls.
        """
        square = f"[{size[0]}, {size[1]}]"
        lines = [
            f'name = "{self._name(size, chunk, sees_room)}"',
            'dialects = ["gr00t"]',
            "bend_low = true",
            f"picture = {square}",
            *(["lidar_sees_room = true"] if self.lidar and sees_room else []),
            f"horizon = {chunk}",
            f"prefix = {min(PREFIX, chunk)}",
            f"rate_hz = {RATE_HZ}",
            'language = "task"',
        ]
        for camera in self.cameras:
            lines += ["", "[[camera]]", f'key = "{camera}"', f'sensor = "{camera}"', f"size = {square}"]
            lines += [f"delta = {list(self.rows)}"] if self.history else []
        terms = [f'{{ term = "{"height" if name == "base_height" else name}" }}' for name in STATE]
        terms += [f"{{ contact = {MAX_FORCE:.1f} }}"] if self.contacts else []
        terms += [f"{{ lidar = {self.lidar} }}"] if self.lidar else []
        moved = [f'{{ term = "{name}" }}' for name in ("navigate", "height", "torso")]
        groups = ["left_arm", "right_arm", *(["left_hand"] if self.hands == "both" else []), "right_hand"]
        moved += [f'{{ group = "{group}" }}' for group in groups]
        for kind, parts in (("state", terms), ("action", moved)):
            lines += ["", f"[[{kind}]]", f'key = "{kind}"', "parts = [", *(f"    {part}," for part in parts), "]"]
        return "\n".join(lines) + "\n"


DEFAULT = Inputs()
"""The inputs of the mapping ``lerobot_g1_hand``."""


def sees_room(bags: Sequence[Bag]) -> bool:
    """True if the LiDAR of these bags sees bench, crate and walls.

    Raises:
        ValueError: It does in some of them.
    """
    sights = {
        any(sensor["name"] == "lidar" and sensor.get("see_room") for sensor in bag.header["sensors"]) for bag in bags
    }
    if len(sights) > 1:
        raise ValueError("--lidar: in some bags it sees the room, in others floor and ladder alone; train on one kind")
    return sights == {True}
