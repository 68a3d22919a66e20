"""Exports bags as a LeRobot data set."""

import io
from os import PathLike
from pathlib import Path
from typing import Any, Iterator, Literal, Mapping, Optional, Sequence

import numpy as np
from numpy.typing import NDArray

from .bag import Bag

ROWS_PER_SECOND = 50
"""Control steps in a second."""

_CHOSEN = {
    "policy": "policy",
    "task": "task",
    "robot": "hands",
    "gains": "gains",
    "reward": "reward",
    "protocol": "episode_protocol",
}
"""Columns of the episode's settings, with their fields in its header."""

_SENSED = (
    "base_angular_velocity",
    "projected_gravity",
    "base_linear_velocity",
    "base_height",
    "joint_position",
    "joint_velocity",
)

_COMMAND = ["navigate:3", "height:1", "torso:3"]
"""The keys of a command to a whole-body controller, as they are recorded."""

ActionForm = Literal["joints", "command"]
"""Actions in action units, or commands of velocity, height and torso."""


def export_lerobot(
    bags: str | PathLike[str] | Sequence[str | PathLike[str]],
    out: str | PathLike[str],
    *,
    repo_id: str = "fiatlux/bags",
    fps: int = ROWS_PER_SECOND,
    vcodec: Optional[str] = "libsvtav1",
    state: Sequence[str] = _SENSED,
    action: ActionForm = "joints",
) -> Path:
    """Writes complete bags as a LeRobot data set, and returns its folder; needs the extra ``lerobot``.

    A frame is a row with the action that answers it: the robot's proprioception (``observation.state``, noise included), the
    action in action units (``action``), the instruction (``task``), and the reward and outcome of the step (``next.reward``,
    ``next.reward_terms``, ``next.done``, ``next.success``). ``episode.*`` holds for the whole episode: the judge's verdict, the
    settings, and in ``episode.conditions`` the numbers that were drawn; the data set's features give their names. Recorded
    images become videos (``observation.images.*``); between two images the older one is repeated.

    Args:
        bags: Bags, or a folder of them.
        out: Folder of the data set, which must not exist.
        repo_id: Name of the data set.
        fps: Frames a second: 50 divided by a whole number. Rows in between are left out, with their actions; the reward of a
            frame is the sum up to the next one.
        vcodec: Video codec, as LeRobot names it; ``None`` for single pictures, which are exact and faster to train on.
        state: Terms of proprioception for ``observation.state``, in this order.
        action: ``"command"`` for the commands to the whole-body controller (velocity ahead, to the left and about the vertical,
            height, and roll, pitch, yaw of the torso), which bags of policies such as ``walk`` have.

    Raises:
        ImportError: ``lerobot`` is not installed.
        ValueError: There are no bags, a bag was cut or has no proprioception or commands, bags are of different robots, a term
            is unknown, or ``fps`` does not divide 50.
    """
    try:
        from lerobot.datasets.lerobot_dataset import LeRobotDataset
    except ImportError as error:
        raise ImportError("export_lerobot needs lerobot; install the wheel with its extra lerobot (docs/python/wheels.md)") from error
    if fps <= 0 or ROWS_PER_SECOND % fps != 0:
        raise ValueError(f"fps is {fps}; give 50 divided by a whole number, such as 50, 25 or 10")
    unknown = [name for name in state if name not in _SENSED]
    if unknown or not state:
        raise ValueError(f"state: {unknown or 'nothing'} is not known; name some of {', '.join(_SENSED)}")
    if action not in ("joints", "command"):
        raise ValueError(f"action is {action!r}; use joints or command")
    paths = _paths(bags)
    features, robot = None, ""
    for path in paths:
        of_bag, robot_of_bag = _features(Bag(path), path, state, action, "image" if vcodec is None else "video")
        if features is None:
            features, robot = of_bag, robot_of_bag
        elif features != of_bag or robot != robot_of_bag:
            differ = sorted(set(features) ^ set(of_bag)) or sorted(n for n in features if features[n] != of_bag[n]) or ["robot"]
            raise ValueError(f"{path} differs from {paths[0]} in {', '.join(differ)}; export such bags separately")
    video = {"use_videos": False} if vcodec is None else {"use_videos": True, "vcodec": vcodec}
    data = LeRobotDataset.create(repo_id, fps, features, root=out, robot_type=robot, **video)
    for path in paths:
        for frame in _frames(Bag(path), state, action, ROWS_PER_SECOND // fps):
            data.add_frame(frame)
        data.save_episode()
    data.finalize()
    return Path(out)


def _paths(bags: str | PathLike[str] | Sequence[str | PathLike[str]]) -> list[Path]:
    if isinstance(bags, (str, PathLike)):
        folder = Path(bags)
        paths = sorted(folder.rglob("*.mcap")) if folder.is_dir() else [folder]
    else:
        paths = [Path(bag) for bag in bags]
    if not paths:
        raise ValueError(f"bags: no file *.mcap in {bags}")
    return paths


def _features(
    bag: Bag, path: Path, state: Sequence[str], action: ActionForm, picture: str
) -> tuple[dict[str, Any], str]:
    """Columns of a bag's data set, and the name of its robot."""
    if not bag.is_whole or bag.result is None:
        raise ValueError(f"{path} is incomplete; export bags of episodes that have ended")
    header, observation = bag.header, bag["/observation"]
    joints: list[str] = list(header["joint_names"])
    if len(observation.get("proprioception.joint_position", ())) != len(bag["/state"]["step"]):
        raise ValueError(f"{path} has no proprioception in every row; record sessions that observe it in every step")
    if action == "command" and _commands(bag) is None:
        raise ValueError(f"{path} has no command with every action; record a policy on a whole-body controller, such as walk")

    def parts(name: str) -> list[str]:
        if name == "base_height":
            return [name]
        return [f"{name}.{part}" for part in (joints if name.startswith("joint_") else ("x", "y", "z"))]

    def one(dtype: str) -> dict[str, Any]:
        return {"dtype": dtype, "shape": (1,), "names": None}

    def several(names: list[str]) -> dict[str, Any]:
        return {"dtype": "float32", "shape": (len(names),), "names": names}

    features: dict[str, Any] = {
        "observation.state": several([part for name in state for part in parts(name)]),
        "action": several(["vx", "vy", "wz", "height", "roll", "pitch", "yaw"] if action == "command" else joints),
        "next.reward": one("float32"),
        "next.reward_terms": several(_reward_terms(bag)),
        "next.done": one("bool"),
        "next.success": one("bool"),
        "episode.success": one("bool"),
        "episode.gate_progress": one("float32"),
        "episode.seed": one("int64"),
        "episode.number": one("int64"),
        **{f"episode.{name}": one("string") for name in _CHOSEN},
        "episode.conditions": several(list(_drawn(header))),
    }
    for name, images in _images(bag).items():
        height, width, _ = next(iter(images.values())).shape
        features[f"observation.images.{name}"] = {
            "dtype": picture,
            "shape": (height, width, 3),
            "names": ["height", "width", "channels"],
        }
    return features, f"g1_{header['hands']}"


def _commands(bag: Bag) -> Optional[NDArray[np.float32]]:
    """The command with each action, rows x 7; ``None`` if any action of the bag lacks it."""
    actions = bag["/action"]
    values, keys = actions.get("action.chunk.values"), actions.get("action.chunk.keys")
    rows = len(bag["/state"]["step"]) - 1
    if not isinstance(values, np.ndarray) or values.shape != (rows, 7) or keys != [_COMMAND] * rows:
        return None
    return values


def _frames(bag: Bag, terms: Sequence[str], action: ActionForm, stride: int) -> Iterator[dict[str, Any]]:
    header, observation, rewards = bag.header, bag["/observation"], bag["/reward"]
    verdict = (bag.result or {})[header["episode_protocol"]]
    rows = len(bag["/state"]["step"]) - 1
    # The action that answers row k led to row k + 1.
    actions = _commands(bag) if action == "command" else bag["/state"]["action"][1:]
    assert actions is not None, "_features has checked it"
    sensed = [np.reshape(observation[f"proprioception.{name}"], (rows + 1, -1)) for name in terms]
    state = np.concatenate(sensed, axis=1).astype(np.float32)
    paid = np.stack([rewards[f"terms.{name}.reward"] for name in _reward_terms(bag)], axis=1)
    whole_episode = {
        "episode.success": np.array([bool(verdict["success"])]),
        "episode.gate_progress": np.array([verdict["gate_progress"]], np.float32),
        "episode.seed": np.array([header["seed"]], np.int64),
        "episode.number": np.array([header["episode"]], np.int64),
        **{f"episode.{name}": header[field] for name, field in _CHOSEN.items()},
        "episode.conditions": np.array(list(_drawn(header).values()), np.float32),
    }
    images = {f"observation.images.{name}": seen for name, seen in _images(bag).items()}
    latest: dict[str, NDArray[np.uint8]] = {}
    for row in range(rows):
        for name, seen in images.items():
            if row in seen:
                latest[name] = seen[row]
        if row % stride != 0:
            continue
        last = min(row + stride, rows)
        yield {
            "task": header["instruction"],
            "observation.state": state[row],
            "action": np.asarray(actions[row], np.float32),
            "next.reward": np.sum(rewards["total"][row:last], keepdims=True).astype(np.float32),
            "next.reward_terms": np.sum(paid[row:last], axis=0).astype(np.float32),
            "next.done": np.array([last == rows]),
            "next.success": np.array([last == rows and bool(verdict["success"])]),
            **whole_episode,
            **{name: latest[name] for name in images},
        }


def _reward_terms(bag: Bag) -> list[str]:
    ends = (name.removeprefix("terms.") for name in bag["/reward"] if name.startswith("terms."))
    return sorted(name.removesuffix(".reward") for name in ends if name.endswith(".reward"))


def _drawn(header: Mapping[str, Any]) -> dict[str, float]:
    """The numbers that were drawn for the episode, by name."""
    found: dict[str, float] = {}
    _flatten("", header.get("domain_sample", {}), found)
    return found


def _flatten(path: str, value: Any, found: dict[str, float]) -> None:
    if isinstance(value, Mapping):
        for name, part in value.items():
            _flatten(f"{path}.{name}" if path else name, part, found)
    elif isinstance(value, list):
        for index, part in enumerate(value):
            _flatten(f"{path}.{index}", part, found)
    elif isinstance(value, (bool, int, float)):
        found[path] = float(value)


def _images(bag: Bag) -> dict[str, dict[int, NDArray[np.uint8]]]:
    """Recorded images by camera and row."""
    found: dict[str, dict[int, NDArray[np.uint8]]] = {}
    camera = bag["/camera"]
    if camera:
        from PIL import Image

        seconds = np.asarray(camera["timestamp.seconds"]) + np.asarray(camera["timestamp.nanos"]) / 1e9
        rows = np.rint(seconds * ROWS_PER_SECOND).astype(int)
        found["camera"] = {
            int(row): np.asarray(Image.open(io.BytesIO(data)).convert("RGB")) for row, data in zip(rows, camera["data"])
        }
    observation = bag["/observation"]
    if "chest_camera.rgb" in observation:
        data = observation["chest_camera.rgb"]
        rows = observation.get("chest_camera.rgb.rows", range(len(data)))
        shape = (int(observation["chest_camera.height"][0]), int(observation["chest_camera.width"][0]), 3)
        found["chest_camera"] = {int(row): np.frombuffer(rgb, np.uint8).reshape(shape) for row, rgb in zip(rows, data)}
    return found
