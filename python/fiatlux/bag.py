"""Recorded episodes as arrays."""

import difflib
import io
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _native
from ._extras import missing
from ._numbers import size_of, whole
from ._pictures import Picture, picture, png
from .settings import ActionForm
from .spaces import Layout, ObservationForm

ROWS_PER_SECOND = 50
"""Control steps in a second."""

_PICTURES = ("camera", "chest_camera", "left_wrist_camera", "right_wrist_camera")
_CHANNELS = {"depth": "metres", "chest_depth": "metres", "segmentation": "labels", "chest_segmentation": "labels"}


def files_below(folder: Path, pattern: str = "*.mcap") -> list[Path]:
    """The files in a folder and the folders in it, without those that file systems leave behind, such as ``._NAME`` of macOS and recycle bins."""

    def is_meant(path: Path) -> bool:
        return not any(_native.is_leftover(name) for name in path.relative_to(folder).parts)

    return [path for path in sorted(folder.rglob(pattern)) if is_meant(path)]


class Columns(dict[str, Any]):
    """The columns of a topic by name."""

    def __init__(self, topic: str, columns: Mapping[str, Any]) -> None:
        super().__init__(columns)
        self._topic = topic

    def __missing__(self, name: str) -> Any:
        close = difflib.get_close_matches(str(name), self, 3, 0.4)
        hint = f"; did you mean {', '.join(map(repr, close))}?" if close else f"; it has {', '.join(self)}"
        raise KeyError(f"topic {self._topic!r} has no column {name!r}{hint}")


class Bag(Mapping[str, dict[str, Any]]):
    """A recorded episode: a mapping of topics, each with its columns.

    ``bag["/state"]["joint_position"]`` is an array of rows x joints. A topic is read on first use. The name of a column is the
    path of a field in the topic's message; if only some messages have the field, ``NAME.rows`` holds their indices.
    """

    def __init__(self, path: str | PathLike[str]) -> None:
        self._bag = _native.Bag(path)
        self._read: dict[str, dict[str, Any]] = {}

    @classmethod
    def below(cls, folder: str | PathLike[str], *, training: bool = False) -> "list[Bag]":
        """The bags in a folder and in the folders in it, by path; with ``training``, for a policy that learns from them.

        Raises:
            FileNotFoundError: There is none.
            ValueError: With ``training``, one is of a room that is for judging.
        """
        if not (paths := files_below(Path(folder))):
            raise FileNotFoundError(f"no bag in '{folder}'")
        bags = [cls(path) for path in paths]
        for path, bag in zip(paths, bags if training else []):
            try:
                _native.check_training(bag.header["seed"])
            except ValueError as error:
                raise ValueError(f"{path}: {error}; fiatlux demonstrate plays such rooms") from error
        return bags

    @cached_property
    def header(self) -> dict[str, Any]:
        """The conditions of the episode, as nested dictionaries with the field names of the message ``EpisodeHeader``."""
        return self._bag.header()

    @cached_property
    def result(self) -> dict[str, Any] | None:
        """The end of the episode, with the field names of ``EpisodeResult``; ``None`` in a bag that was cut."""
        return self._bag.result()

    @property
    def is_whole(self) -> bool:
        """True if the bag holds the whole episode."""
        return self._bag.is_whole

    @property
    def is_thin(self) -> bool:
        """True if the file has actions and result alone: every other topic is simulated on first use, with what the sensors read."""
        return self._bag.is_thin

    @property
    def steps(self) -> int:
        """Number of control steps, and of actions; there is one row and one observation more."""
        # All rows take many times the memory of what else is read.
        if self.is_whole and self.result is not None:
            return int(self.result["end"]["steps"])
        return len(self["/state"]["step"]) - 1

    @property
    def sensors(self) -> list[str]:
        """Names of the sensors that the policy saw as numbers in every step; pictures are in :meth:`images`."""
        sensed = [sensor["name"] for sensor in self.header["sensors"] if not sensor.get("bag_only")]
        return [name for name in sensed if name not in _PICTURES]

    def observations(self, sensors: Sequence[str] | None = None, *, observation: ObservationForm = "dict") -> Any:
        """The observations of the policy, one for each row, with the names, the shapes and the numbers that :class:`fiatlux.Env` and vectors give.

        ``actions()[k]`` answers observation ``k``; the last observation has no action. A sensor with a rate of its own keeps its
        last numbers in between.

        Args:
            sensors: Names of the sensors; observations have them in the simulator's order. By default :attr:`sensors`.
            observation: ``"dict"``: a dictionary of arrays with a row for each observation. ``"flat"``: one array.

        Raises:
            ValueError: The bag does not have a sensor in its observations.
        """
        if isinstance(sensors, str):
            raise ValueError(f"sensors is {sensors!r}; give a list of names, [{sensors!r}]")
        names = self.sensors if sensors is None else list(sensors)
        for name in names:
            if name in _PICTURES:
                raise ValueError(f"sensors: pictures of {name!r} are in images(), by row; leave it out here")
            if name not in self.sensors and name in _native.sensors():
                raise ValueError(
                    f"sensors: the bag has no {name!r} in its observations; it has {', '.join(self.sensors)}"
                )
        fields, numbers = self._bag.observations(names)
        layout = Layout(
            {"observation": fields, "actions": [], "action_range": np.zeros((0, 2)), "rewards": []}, observation
        )
        return layout.show(numbers.reshape(self.steps + 1, layout.words), copy=False)

    def phases(self) -> tuple[list[str], NDArray[np.bool_]] | None:
        """For each step the name of what the policy ``expert`` did, and whether nothing was left to do; ``None`` in other policies' bags."""
        actions = self["/action"]
        names, is_over = actions.get("action.chunk.phase"), actions.get("action.chunk.is_over")
        if names is None or not any(names) or not isinstance(is_over, np.ndarray) or len(is_over) != self.steps:
            return None
        return list(names), is_over.astype(np.bool_)

    def actions(self, form: ActionForm = "action") -> NDArray[np.float64]:
        """The action that acted in each step, steps x joints, in action units or as joint targets, rad.

        Those of experts are here too. In an episode with a delay the action of a step was sent before it.
        """
        acted = np.asarray(self["/state"]["action"], np.float64)[1:]
        if form == "action":
            return acted
        if form != "joint_target":
            raise ValueError(f"form is {form!r}; known ones are action, joint_target")
        return np.asarray(self["/state"]["joint_target"], np.float64)[1:]

    def commands(self) -> NDArray[np.float32] | None:
        """The command to the whole-body controller with each action, steps x 7: vx, vy, wz, height, roll, pitch, yaw.

        ``None`` where an action of the episode has none: the policy moves the joints itself, for a while or always.
        """
        return commands_of(self)

    def images(self) -> dict[str, dict[int, NDArray[np.uint8]]]:
        """Recorded pictures by sensor and row, height x width x 3; needs Pillow for ``camera``."""
        found: dict[str, dict[int, NDArray[np.uint8]]] = {}
        camera = self["/camera"]
        if camera:
            try:
                from PIL import Image
            except ImportError as error:
                raise missing("the picture of /camera, which Pillow reads,", "assets", error) from error

            found["camera"] = {
                row: np.asarray(Image.open(io.BytesIO(data)).convert("RGB"))
                for row, data in zip(_rows(camera), camera["data"])
            }
        observation = self["/observation"]
        for name in _PICTURES[1:]:
            if f"{name}.rgb" not in observation:
                continue
            data = observation[f"{name}.rgb"]
            rows = observation.get(f"{name}.rgb.rows", range(len(data)))
            shape = (int(observation[f"{name}.height"][0]), int(observation[f"{name}.width"][0]), 3)
            found[name] = {int(row): np.frombuffer(rgb, np.uint8).reshape(shape) for row, rgb in zip(rows, data)}
        return found

    def channels(self) -> dict[str, dict[int, NDArray[Any]]]:
        """Recorded depth (m, ``float32``) and labels (``uint8``, see :func:`fiatlux.segments`) by sensor and row, height x width."""
        found: dict[str, dict[int, NDArray[Any]]] = {}
        observation = self["/observation"]
        for name, part in _CHANNELS.items():
            if f"{name}.{part}" not in observation:
                continue
            data = observation[f"{name}.{part}"]
            rows = observation.get(f"{name}.{part}.rows", range(len(data)))
            shape = (int(observation[f"{name}.height"][0]), int(observation[f"{name}.width"][0]))
            found[name] = {
                int(row): np.frombuffer(one, np.uint8).reshape(shape)
                if isinstance(one, bytes)
                else np.asarray(one, np.float32).reshape(shape)
                for row, one in zip(rows, data)
            }
        return found

    def scans(self) -> dict[int, NDArray[np.float32]]:
        """Recorded hits of the LiDAR by row, points x 3, in the LiDAR's frame, m: x ahead, y right, z down, since it hangs
        upside down."""
        return scans_of(self)

    def render(self, row: int, *, size: tuple[int, int] = (640, 480), camera: str | None = None) -> Picture:
        """A picture of a row, height x width x 3, which notebooks show; below 0 it counts from the end.

        Args:
            row: Number of the row.
            size: Width and height, pixels.
            camera: As ``render_camera`` of :class:`fiatlux.Env`.

        Raises:
            ValueError: There is no such row or camera.
        """
        rows = self.steps + 1
        number = whole("row", row, -rows, rows - 1) % rows
        width, height = size_of("size", size)
        return picture(self._bag.render([number], width, height, camera)[0], width, height)

    def _repr_png_(self) -> bytes:
        """Four rows from the first to the last, from left to right, in a notebook."""
        rows = sorted({self.steps * part // 3 for part in range(4)})
        drawn = self._bag.render(rows, 320, 240)
        return png(np.concatenate([picture(pixels, 320, 240) for pixels in drawn], axis=1))

    def __repr__(self) -> str:
        header, end = self.header, "whole" if self.is_whole else "cut"
        return f"<fiatlux.Bag {header['task']}, seed {header['seed']}, {header['policy']}: {self.steps} steps, {end}>"

    def row(self, index: int) -> dict[str, Any]:
        """A recorded row in the form of :meth:`fiatlux.Env.row`, from which :meth:`fiatlux.VectorEnv.reset_worlds` begins."""
        states = self["/state"]
        row: dict[str, Any] = {"step": int(states["step"][index])}
        for name in states:
            body, _, part = name.partition(".")
            if part == "linear_velocity":
                row[f"{body}_pose"] = np.concatenate(
                    [states[f"{body}.{part}"][index] for part in ("position", "quaternion")]
                )
            if part in ("linear_velocity", "angular_velocity"):
                row[f"{body}_{part}"] = states[name][index]
            elif part == "seated":
                row[f"{body}_seated"] = np.atleast_1d(np.float64(states[name][index]))
            elif name in ("joint_position", "joint_velocity", "joint_target", "joint_effort", "action"):
                row[name] = states[name][index]
        return row

    def __getitem__(self, topic: str) -> dict[str, Any]:
        if topic not in self._read:
            self._read[topic] = Columns(topic, self._bag.columns(topic))
        return self._read[topic]

    def __iter__(self) -> Iterator[str]:
        return iter(self._bag.topics())

    def __len__(self) -> int:
        return len(self._bag.topics())


def _rows(messages: Mapping[str, Any]) -> list[int]:
    """Rows of messages with a time stamp."""
    seconds = np.asarray(messages["timestamp.seconds"]) + np.asarray(messages["timestamp.nanos"]) / 1e9
    return [int(row) for row in np.rint(seconds * ROWS_PER_SECOND)]


def scans_of(bag: Mapping[str, Mapping[str, Any]]) -> dict[int, NDArray[np.float32]]:
    """As :meth:`Bag.scans`, of topics as a bag has them."""
    clouds = bag["/lidar"]
    if not clouds:
        return {}
    if any(len(points) % 12 for points in clouds["data"]):
        raise ValueError("has a cloud on /lidar that is not of points with three numbers of 4 bytes")
    data = (np.frombuffer(points, "<f4").reshape(-1, 3) for points in clouds["data"])
    return dict(zip(_rows(clouds), data))


def commands_of(bag: Mapping[str, Mapping[str, Any]]) -> NDArray[np.float32] | None:
    """As :meth:`Bag.commands`, of topics as a bag has them."""
    actions, steps = bag["/action"], len(bag["/state"]["step"]) - 1
    if "action.whole_body.vx" in actions and "action.whole_body.vx.rows" not in actions:
        parts = [actions[f"action.whole_body.{name}"] for name in _native.BODY_COMMAND]
        return np.stack(parts, axis=1).astype(np.float32)
    values, keys = actions.get("action.chunk.values"), actions.get("action.chunk.keys")
    wanted = [_native.BODY_COMMAND_KEYS] * steps
    if not isinstance(values, np.ndarray) or values.shape != (steps, 7) or keys != wanted:
        return None
    return values.astype(np.float32)
