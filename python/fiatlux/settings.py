"""Settings of episodes: the same keys for single environments, vectors of worlds, and sessions on a server."""

import difflib
import inspect
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path
from typing import Any, Literal, NoReturn, TypedDict, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from . import _native
from ._numbers import size_of, whole
from ._robots import Robot

ROBOTS: tuple[Robot, ...] = tuple(cast(list[Robot], _native.robots()))
"""Names of all robots. The first is the benchmark's."""


def segments(robot: Robot = ROBOTS[0]) -> dict[int, str]:
    """Names by label of what the sensors ``segmentation`` and ``chest_segmentation`` show: things, parts of the room, links of the
    robot. Label 0 is a pixel at which nothing is seen.

    Raises:
        FiatluxError: No robot has that name.
    """
    return {label: name for label, name in enumerate(_native.segments(robot), 1)}


@dataclass(frozen=True)
class Camera:
    """Where a camera is on the robot, and its lens: a pinhole without distortion.

    Attributes:
        link: The link that carries it.
        pose: Its pose in that link: x, y, z, then the quaternion w, x, y, z. It looks along its x axis, y left, z up.
        matrix: The intrinsics, pixels: ``[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]`` from the picture's left and upper edge. They take x right,
            y down, z ahead: ``matrix @ (-y, -z, x)`` of a point (x, y, z) in the camera's own frame is a pixel times its depth.
        near: Nothing nearer along its axis is in the picture, m.
    """

    link: str
    pose: NDArray[np.float64]
    matrix: NDArray[np.float64]
    near: float


def cameras(robot: Robot = ROBOTS[0], image_size: tuple[int, int] = (256, 256)) -> dict[str, Camera]:
    """The robot's cameras by the sensor whose picture they take, as ``SessionInfo.cameras`` describes them to clients.

    Raises:
        FiatluxError: No robot has that name.
    """
    width, height = size_of("image_size", image_size)
    return {
        sensor: Camera(link, np.array(pose), np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]), near)
        for sensor, link, pose, (fx, fy, cx, cy), near in _native.cameras(robot, width, height)
    }


RenderMode = Literal["rgb_array"]
ActionForm = Literal["action", "joint_target"]
Reward = Literal["benchmark", "training"]
Protocol = Literal["strict", "published"]
Gains = Literal["fiatlux", "sonic"]
Sensor = Literal[
    "proprioception",
    "hand_contact",
    "limb_contact",
    "last_action",
    "lidar",
    "camera",
    "features",
    "flat",
    "privileged",
    "verdict",
    "chest_camera",
    "chest_depth",
    "chest_segmentation",
    "depth",
    "goal",
    "left_wrist_camera",
    "right_wrist_camera",
    "segmentation",
]
"""Name of a sensor; ``@`` and a rate may follow it."""
End = Literal["success", "diverged", "fall", "tip", "crush", "drop", "unseated", "impact", "time-out"]
Fixed = Literal["layout", "start", "hand-friction", "light", "tint", "noise", "episodes"]


class EpisodeSettings(TypedDict, total=False):
    """Settings that vectors of worlds, environments and sessions share; all are optional.

    Attributes:
        sensors: Names of the sensors; observations have them in the simulator's order. By default proprioception, contact
            forces and the last action. A name may have a rate in Hz, such as ``"camera@10"``: between two pictures the field keeps the
            last one, and ``camera.age`` says how old it is, s. ``"camera@look"`` is seen at the start of an episode and then only
            when somebody looks: :meth:`fiatlux.Env.look`, or ``look`` of a policy.
        privileged: Adds the exact poses of the things around the robot, which a real robot cannot sense.
        action_form: ``"action"``: joint target = q0 + 0.5 action. ``"joint_target"``: joint targets, rad.
        reward: ``"benchmark"`` pays gate progress only, ``"training"`` the shaped reward.
        protocol: Which judge ends the episode: ``"strict"`` or ``"published"``.
        noise: Whether the sensors have noise.
        robot: Name of the robot, one of ``fiatlux.ROBOTS``, or of its hands; by default the first, the benchmark's.
        gains: Name of the robot's set of gains: ``"fiatlux"`` or ``"sonic"``.
        image_size: Width and height of the cameras' images, each from 1 to 4096 pixels; a server takes 16 to 640.
        weights: Weights of the camera's features, a safetensors file; seeded ones by default. ``"int8"``, or the file's name with ``+int8``,
            computes them in whole numbers: faster, and the same on every processor.
        fix: Quantities to keep fixed, of ``"layout"`` (the room of seed 0), ``"start"``, ``"hand-friction"``, ``"light"``, ``"tint"``,
            ``"noise"``, and ``"episodes"`` for all of them but the layout.
        prop_scale: Sizes of props: ``"random"``, or factors by name: ``ladder_x``, ``ladder_y``, ``ladder_z``, ``socket``,
            ``fresh_bulb``.
        thresholds: Thresholds of the judges by name, such as ``{"fragility_n": 30}``.
        end_on: Conditions that end an episode in place of the task's own, such as ``["fall", "time-out"]``.
        action_delay: Time from the arrival of an action to its effect, ms: 0, 20, ... 100.
    """

    sensors: Sequence[Sensor | str] | None
    privileged: bool
    action_form: ActionForm
    reward: Reward
    protocol: Protocol
    noise: bool
    robot: Robot
    gains: Gains
    image_size: tuple[int, int]
    weights: str | PathLike[str] | None
    fix: Sequence[Fixed]
    prop_scale: str | Mapping[str, float]
    thresholds: Mapping[str, float]
    end_on: Sequence[End]
    action_delay: int


class Settings(EpisodeSettings, total=False):
    """Settings that environments and sessions take; all are optional. Those of :class:`EpisodeSettings` and this one.

    Attributes:
        ranges: Least and greatest value of what the benchmark holds constant, drawn anew for each episode: ``gravity`` (m/s^2),
            ``noise`` (factor of the width of the sensors' noise), ``action_delay`` (ms, in steps of 20), ``floor_friction`` (floor
            and soles), ``hand_friction``, ``robot_mass`` and ``gains`` (factors), and by name ``friction`` of surfaces and
            ``thing_mass`` (factors), such as ``{"noise": (0.5, 2), "friction": {"floor": (0.5, 1.1)}}``; and ``camera``, by name: ``x``,
            ``y``, ``z`` (m), ``roll``, ``pitch``, ``yaw`` (rad), ``angle`` (a factor of the angle of view), ``exposure`` (powers of
            two), ``noise`` (levels of 255), ``blur`` (pixels), ``delay`` (ms, in steps of 20), ``colours`` (a share), ``pattern`` (0
            for none, 1 to 8) and ``look`` (1 for the benchmark's, 2 for that of pictures for people). ``"real"`` stands for those of
            a real robot, as does ``{"preset": "real"}``, next to which other ranges override its own.
    """

    ranges: Mapping[str, Any] | str | None


_DEFAULTS: dict[str, Any] = {
    "sensors": None,
    "privileged": False,
    "action_form": "action",
    "reward": "benchmark",
    "protocol": "strict",
    "noise": True,
    "robot": ROBOTS[0],
    "gains": "fiatlux",
    "image_size": (256, 256),
    "weights": None,
    "fix": (),
    "prop_scale": {},
    "thresholds": {},
    "end_on": (),
    "action_delay": 0,
    "ranges": None,
}


Function = TypeVar("Function", bound=Callable[..., Any])


def spelt_out(*kinds: Any, **defaults: Any) -> Callable[[Function], Function]:
    """Lets the signature of a function show the arguments that it takes as ``**settings``, so that editors and ``help`` name them.

    Args:
        kinds: Classes of settings, of which ``**settings`` is made.
        defaults: Where they are not the usual ones.
    """

    def wrap(function: Function) -> Function:
        signature = inspect.signature(function)
        own = [part for part in signature.parameters.values() if part.kind is not inspect.Parameter.VAR_KEYWORD]
        known = {part.name for part in own}
        for kind in kinds:
            for name, type_of in kind.__annotations__.items():
                if name not in known:
                    default = defaults.get(name, _DEFAULTS.get(name))
                    own.append(
                        inspect.Parameter(name, inspect.Parameter.KEYWORD_ONLY, default=default, annotation=type_of)
                    )
                    known.add(name)
        function.__signature__ = signature.replace(parameters=own)  # type: ignore[attr-defined]
        return function

    return wrap


def refuse_argument(name: str, known: Iterable[str]) -> NoReturn:
    """Refuses an argument that a call does not have, with the nearest one that it has."""
    known = list(dict.fromkeys(known))
    close = difflib.get_close_matches(name, known, 1)
    hint = f" (did you mean {close[0]!r}?)" if close else ""
    raise TypeError(f"unexpected argument {name!r}{hint}; the arguments are {', '.join(known)}")


def complete(
    task: str | None, observation: str, given: Mapping[str, Any], others: Iterable[str] = ()
) -> dict[str, Any]:
    """All settings in the form that the native part takes; refuses an unknown key, and names ``others`` as known ones too. Without a
    task, ``privileged`` is refused unless the sensors are named."""
    for name in given:
        if name not in _DEFAULTS:
            refuse_argument(name, (*others, *_DEFAULTS))
    settings = {**_DEFAULTS, **given}
    settings["sensors"] = _sensors(task, observation, settings["sensors"], settings.pop("privileged"))
    settings["image_size"] = size_of("image_size", settings["image_size"])
    if not isinstance(settings["noise"], (bool, np.bool_)):
        raise ValueError(f"noise is {settings['noise']!r}; give True or False (a factor goes into ranges)")
    settings["noise"] = bool(settings["noise"])
    for name in ("robot", "gains", "protocol", "reward", "action_form"):
        if not isinstance(settings[name], str):
            raise ValueError(f"{name} is {settings[name]!r}; give a name")
    for name in ("fix", "end_on"):
        if isinstance(settings[name], str) or not all(isinstance(part, str) for part in settings[name]):
            raise ValueError(f"{name} is {settings[name]!r}; give a list of names")
        settings[name] = list(settings[name])
    sizes = settings["prop_scale"]
    settings["prop_scale"] = [sizes] if isinstance(sizes, str) else [f"{name}={float(sizes[name])!r}" for name in sizes]
    settings["thresholds"] = {name: float(value) for name, value in settings["thresholds"].items()}
    settings["ranges"] = list(_ranges(by_preset(settings["ranges"]) or {}))
    settings["action_delay"] = whole("action_delay", settings["action_delay"], 0, 100)
    if settings["weights"] is not None:
        settings["weights"] = fspath(settings["weights"])
        file = settings["weights"].removesuffix("+int8")
        if settings["weights"] != "int8" and not Path(file).is_file():
            raise ValueError(f"weights is {settings['weights']!r}; there is no such file")
    return settings


def by_preset(ranges: Mapping[str, Any] | str | None) -> dict[str, Any] | None:
    """Ranges as a mapping, in which a preset is the first entry: what follows overrides its ranges."""
    if isinstance(ranges, str):
        return {"preset": ranges}
    if ranges is None or "preset" not in ranges:
        return None if ranges is None else dict(ranges)
    return {"preset": ranges["preset"], **ranges}


_OF_VECTORS = {
    **dict.fromkeys(("mass", "com_shift_m"), "an episode draws one factor for all bodies: robot_mass"),
    **dict.fromkeys(("stiffness", "damping", "effort_limit"), "an episode draws one factor for all drives: gains"),
    "light": "every episode draws its light but with fix=['light']",
}
"""Ranges that only vectors have, and what takes their place."""


def _ranges(ranges: Mapping[str, Any], group: str = "") -> Iterator[str]:
    """Each range as the programs' flag has it."""
    for name, value in ranges.items():
        if name == "preset" and not group:
            yield str(value)
            continue
        if name in _OF_VECTORS and not group:
            raise ValueError(f"ranges: {name} is for vectors of worlds alone; {_OF_VECTORS[name]}")
        if isinstance(value, Mapping):
            if group:
                raise ValueError(f"ranges: {group}{name} is a mapping; give (least, most)")
            yield from _ranges(value, f"{name}.")
            continue
        try:
            least, most = map(float, value)
        except (TypeError, ValueError):
            raise ValueError(f"ranges: {group}{name} is {value!r}; give (least, most)") from None
        yield f"{group}{name}={least!r}..{most!r}"


def names_of(argument: str, names: Sequence[str]) -> list[str]:
    """A list of names; refuses a single one."""
    if isinstance(names, str) or not all(isinstance(name, str) for name in names):
        raise ValueError(f"{argument} is {names!r}; give a list of names")
    return list(names)


def _sensors(task: str | None, observation: str, sensors: Sequence[str] | None, privileged: bool) -> list[str] | None:
    """Names of the sensors; ``None`` for the default ones."""
    if isinstance(sensors, str):
        raise ValueError(f"sensors is {sensors!r}; give a list of names")
    if observation == "published":
        if sensors is not None or privileged:
            raise ValueError("observation='published' is a vector of its own; leave sensors and privileged out")
        return ["flat"]
    if not privileged:
        return None if sensors is None else list(dict.fromkeys(sensors))
    if sensors is None:
        if task is None:
            raise ValueError("privileged: name the sensors too, since the tasks of a run have different defaults")
        sensors = _native.body_sensors(task)
    return list(dict.fromkeys([*sensors, "privileged"]))
