"""Exports bags as a LeRobot data set."""

import fcntl
import json
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from . import _native
from ._extras import missing
from ._progress import Line, duration
from .bag import ROWS_PER_SECOND, Bag, commands_of, files_below

_CHOSEN = {
    "policy": "policy",
    "task": "task",
    "robot": "robot",
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

COMMAND = tuple(_native.BODY_COMMAND)
"""A command to a whole-body controller: m/s and rad/s, m, rad."""

_UNITED = ("next.reward_terms", "episode.conditions")
"""Columns with a number for each name of any of the bags."""

ActionForm = Literal["joints", "command"]
"""Actions in action units, or commands of velocity, height and torso."""


def export_lerobot(
    bags: str | PathLike[str] | Sequence[str | PathLike[str]],
    out: str | PathLike[str],
    *,
    repo_id: str = "fiatlux/bags",
    fps: int = ROWS_PER_SECOND,
    vcodec: str | None = "libsvtav1",
    state: Sequence[str] = _SENSED,
    action: ActionForm = "joints",
    progress: Callable[[dict[str, Any]], None] | None = None,
) -> Path:
    """Writes complete bags as a LeRobot data set, and returns its folder; needs the extra ``lerobot``.

    A frame is a row with the action that acted in the step after it: the robot's proprioception (``observation.state``, noise
    included), the action in action units (``action``) and its age (``next.action_delay_s``), the instruction (``task``), and the
    reward and outcome of the step (``next.reward``, ``next.reward_terms``, ``next.done``, ``next.success``). ``episode.*`` holds
    for the whole episode: the judge's verdict, the settings, and in ``episode.conditions`` the numbers that were drawn; the data
    set's features give their names. Bags of several tasks make one set: a reward term that a task lacks is 0, and a number that it does
    not draw NaN. Recorded images become videos (``observation.images.*``), depth and labels arrays (``observation.depth``); between
    two of them the older one is repeated.

    The folder appears when it is whole. Until then finished bags are kept in ``OUT.part``: the same call goes on with them.

    Args:
        bags: Bags, or a folder of them.
        out: Folder of the data set, which must not exist or be empty.
        repo_id: Name of the data set.
        fps: Frames a second: 50 divided by a whole number. Rows in between are left out, with their actions; the reward of a
            frame is the sum up to the next one.
        vcodec: Video codec, as LeRobot names it; ``None`` for single pictures, which are exact and faster to train on.
        state: Terms of proprioception for ``observation.state``, in this order.
        action: ``"command"`` for the commands to the whole-body controller (velocity ahead, to the left and about the vertical,
            height, and roll, pitch, yaw of the torso), which bags of policies such as ``walk`` have. Frames begin with the first
            command that acts.
        progress: Called after each bag with a dictionary: number of ``bags``, how many are ``done``, and ``seconds_left``. A
            terminal shows them anyway.

    Raises:
        ImportError: ``lerobot`` is not installed.
        FileExistsError: ``out`` exists already, or another export is at work on it.
        ValueError: There are no bags, a bag was cut or has no proprioception or commands, bags are of different robots, a term
            is unknown, ``fps`` does not divide 50, or ``OUT.part`` is of a call with other bags or arguments.
    """
    aggregate_datasets, LeRobotDataset = writer()
    if fps <= 0 or ROWS_PER_SECOND % fps != 0:
        raise ValueError(f"fps is {fps}; give 50 divided by a whole number, such as 50, 25 or 10")
    unknown = [name for name in state if name not in _SENSED]
    if unknown or not state:
        raise ValueError(f"state: {unknown or 'nothing'} is not known; name some of {', '.join(_SENSED)}")
    if action not in ("joints", "command"):
        raise ValueError(f"action is {action!r}; use joints or command")
    paths, out = _paths(bags), Path(out)
    if out.is_file() or out.is_dir() and any(out.iterdir()):
        raise FileExistsError(f"{out} exists already; name another folder, or remove it")
    features, robot, rows, digests = None, "", [], []
    for path in paths:
        bag = Bag(path)
        of_bag, robot_of_bag = _features(bag, path, state, action, "image" if vcodec is None else "video")
        if features is None:
            features, robot = of_bag, robot_of_bag
        # Tasks pay by other terms, and draw other numbers.
        for name in _UNITED:
            united = list(dict.fromkeys([*features[name]["names"], *of_bag[name]["names"]]))
            features[name] = of_bag[name] = {**of_bag[name], "shape": (len(united),), "names": united}
        if features == of_bag and robot == robot_of_bag:
            pass
        elif features != of_bag or robot != robot_of_bag:
            differ = (
                sorted(set(features) ^ set(of_bag))
                or sorted(n for n in features if features[n] != of_bag[n])
                or ["robot"]
            )
            raise ValueError(f"{path} differs from {paths[0]} in {', '.join(differ)}; export such bags separately")
        rows.append(len(bag["/state"]["step"]) - 1)
        digests.append((bag.result or {})["end"]["digest"])
    video = {"use_videos": False} if vcodec is None else {"use_videos": True, "vcodec": vcodec}
    asked = {"repo_id": repo_id, "fps": fps, "vcodec": vcodec, "state": list(state), "action": action, "bags": digests}
    # Another version may lay out the same bags in another way.
    asked["features"] = features
    with _aside(out, asked) as part, Line() as line:
        parts = [part / f"{index:06}" for index in range(len(paths))]
        missing = [index for index, target in enumerate(parts) if not target.exists()]
        kept = sum(rows) - sum(rows[index] for index in missing)
        done = 0
        for count, index in enumerate(missing, len(paths) - len(missing)):
            fresh = _emptied(part / "unfinished")
            data = LeRobotDataset.create(repo_id, fps, features, root=fresh, robot_type=robot, **video)
            assert features is not None
            names = [features[name]["names"] for name in _UNITED]
            for frame in _frames(Bag(paths[index]), state, action, ROWS_PER_SECOND // fps, *names):
                data.add_frame(frame)
            data.save_episode()
            data.finalize()
            fresh.rename(parts[index])
            done += rows[index]
            left = line.seconds_left(done, sum(rows) - kept)
            line.show(f"{count + 1}/{len(paths)} bags, {duration(left)} left")
            if progress is not None:
                progress({"bags": len(paths), "done": count + 1, "seconds_left": left})
        whole = _emptied(part / "whole")
        aggregate_datasets([repo_id] * len(parts), repo_id, parts, whole)
        whole.rename(out)
    return out


def writer() -> tuple[Any, Any]:
    """LeRobot's function that joins data sets, and its class of one.

    Raises:
        ImportError: ``lerobot`` is not installed, or NumPy is too new for it.
    """
    # It makes numbers of arrays of one number, which NumPy refuses from 2.4 on.
    if np.lib.NumpyVersion(np.__version__) >= "2.4.0":
        raise ImportError(f"lerobot cannot write with NumPy {np.__version__}; pip install 'numpy<2.4'")
    try:
        from lerobot.datasets.aggregate import aggregate_datasets
        from lerobot.datasets.lerobot_dataset import LeRobotDataset
    except ImportError as error:
        raise missing("export_lerobot", "lerobot", error) from error
    return aggregate_datasets, LeRobotDataset


@contextmanager
def _aside(out: Path, asked: Mapping[str, Any]) -> Iterator[Path]:
    """``OUT.part`` for one call at a time, with what an earlier one of the same kind has left there; removed at the end."""
    part = out.with_name(f"{out.name}.part")
    note = part / "export.json"
    if part.exists() and not note.is_file() and any(part.iterdir()):
        raise FileExistsError(
            f"{part} is in the way: unfinished exports are kept there; rename it, or name another folder"
        )
    part.mkdir(parents=True, exist_ok=True)
    with note.open("a+") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise FileExistsError(
                f"another export is at work in {part}; wait for its end, or name another folder"
            ) from None
        file.seek(0)
        begun, text = file.read(), json.dumps(asked)
        if begun not in ("", text):
            raise ValueError(
                f"{part} has an unfinished export of other bags or arguments; repeat its call, or remove it"
            )
        if not begun:
            file.write(text)
            file.flush()
        yield part
        shutil.rmtree(part)


def _emptied(folder: Path) -> Path:
    """A folder that does not exist, for LeRobot to make."""
    shutil.rmtree(folder, ignore_errors=True)
    return folder


def _paths(bags: str | PathLike[str] | Sequence[str | PathLike[str]]) -> list[Path]:
    if isinstance(bags, (str, PathLike)):
        folder = Path(bags)
        paths = files_below(folder) if folder.is_dir() else [folder]
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
        raise no_command(bag, path, "export the joints of this task (action='joints')", "walk")
    if action == "command" and _delay(bag) >= len(bag["/state"]["step"]) - 1:
        raise ValueError(f"{path} ended before its first command acted; leave it out, or export joints")

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
        "action": several(list(COMMAND) if action == "command" else joints),
        "next.action_delay_s": one("float32"),
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
    if _has_commands(bag, action):
        features["command"] = several(list(COMMAND))
    for name, images in _images(bag).items():
        height, width, _ = next(iter(images.values())).shape
        features[f"observation.images.{name}"] = {
            "dtype": picture,
            "shape": (height, width, 3),
            "names": ["height", "width", "channels"],
        }
    for name, seen in bag.channels().items():
        # LeRobot's writer takes no arrays of two axes.
        first = next(iter(seen.values()))
        height, width = first.shape
        features[f"observation.{name}"] = {
            "dtype": str(first.dtype),
            "shape": (first.size,),
            "names": {"height": height, "width": width},
        }
    return features, header["robot"]


def _commands(bag: Bag) -> NDArray[np.float32] | None:
    """The command with each action, rows x 7; ``None`` if any action of the bag lacks it."""
    return commands_of(bag)


def _commanded(bag: Bag) -> int:
    """Number of actions that have a command."""
    actions = bag["/action"]
    rows = actions.get("action.whole_body.vx.rows")
    if rows is None and "action.chunk.values" in actions:
        rows = actions.get("action.chunk.values.rows", ())
    return 0 if rows is None else len(rows)


def no_command(bag: Bag, path: Path, instead: str, policy: str) -> ValueError:
    """The error for a bag in which an action has no command."""
    with_one, steps = _commanded(bag), len(bag["/state"]["step"]) - 1
    return ValueError(
        f"{path} has no command with every action: {bag.header.get('task')} by {bag.header.get('policy')} has one with {with_one} of {steps}; "
        f"{instead}, or record a policy that commands the whole-body controller in every step, such as {policy}"
    )


def _has_commands(bag: Bag, action: ActionForm) -> bool:
    """The commands stand next to the joints' actions. Those of a session that delays actions act later than their row."""
    return action == "joints" and _delay(bag) == 0 and _commands(bag) is not None


def _delay(bag: Bag) -> int:
    """Control steps by which the session delayed its actions."""
    return round(bag.header.get("request", {}).get("action_delay_ms", 0) / 1000 * ROWS_PER_SECOND)


def _ages(bag: Bag) -> NDArray[np.float32]:
    """For each row but the last, how long before it the observation was that the acting action answers, s. Until the first
    action acts, the session's delay. In real time an action that holds gets older with each step."""
    answered, delay = np.asarray(bag["/action"]["action.step"], np.int64), _delay(bag)
    rows = np.arange(len(answered))
    # A real-time client may send ahead.
    ages = np.where(rows < delay, delay, rows - np.maximum(answered[np.maximum(rows - delay, 0)], 0))
    return (np.maximum(ages, 0) / ROWS_PER_SECOND).astype(np.float32)


def _frames(
    bag: Bag,
    terms: Sequence[str],
    action: ActionForm,
    stride: int,
    reward_terms: Sequence[str] | None = None,
    conditions: Sequence[str] | None = None,
) -> Iterator[dict[str, Any]]:
    header, observation, rewards = bag.header, bag["/observation"], bag["/reward"]
    verdict = (bag.result or {})[header["episode_protocol"]]
    rows = len(bag["/state"]["step"]) - 1
    # The action of row k + 1 acted from row k on. A bag has commands as they were sent, and none acts before the delay is over.
    first = _delay(bag) if action == "command" else 0
    commands = _commands(bag) if action == "command" else None
    besides = _commands(bag) if _has_commands(bag, action) else None
    actions = bag["/state"]["action"][1:] if commands is None else commands
    ages = _ages(bag)
    sensed = [np.reshape(observation[f"proprioception.{name}"], (rows + 1, -1)) for name in terms]
    state = np.concatenate(sensed, axis=1).astype(np.float32)
    # A term that the task does not have pays nothing; what was not drawn is NaN.
    none, drawn = np.zeros(rows), _drawn(header)
    names = _reward_terms(bag) if reward_terms is None else reward_terms
    paid = np.stack([rewards.get(f"terms.{name}.reward", none) for name in names], axis=1)
    whole_episode = {
        "episode.success": np.array([bool(verdict["success"])]),
        "episode.gate_progress": np.array([verdict["gate_progress"]], np.float32),
        "episode.seed": np.array([header["seed"]], np.int64),
        "episode.number": np.array([header["episode"]], np.int64),
        **{f"episode.{name}": header[field] for name, field in _CHOSEN.items()},
        "episode.conditions": np.array([drawn.get(name, np.nan) for name in conditions or drawn], np.float32),
    }
    views: dict[str, dict[int, NDArray[Any]]] = {
        f"observation.images.{name}": seen for name, seen in _images(bag).items()
    }
    views |= {
        f"observation.{name}": {row: one.ravel() for row, one in seen.items()} for name, seen in bag.channels().items()
    }
    latest: dict[str, NDArray[Any]] = {}
    for row in range(rows):
        for name, seen in views.items():
            if row in seen:
                latest[name] = seen[row]
        if row < first or (row - first) % stride != 0:
            continue
        last = min(row + stride, rows)
        yield {
            "task": header["instruction"],
            "observation.state": state[row],
            "action": np.asarray(actions[row - first], np.float32),
            "next.action_delay_s": ages[row : row + 1],
            "next.reward": np.sum(rewards["total"][row:last], keepdims=True).astype(np.float32),
            "next.reward_terms": np.sum(paid[row:last], axis=0).astype(np.float32),
            "next.done": np.array([last == rows]),
            "next.success": np.array([last == rows and bool(verdict["success"])]),
            **whole_episode,
            **({} if besides is None else {"command": besides[row]}),
            **{name: latest[name] for name in views},
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
    return Bag.images(bag)
