"""Parts and joints of an object, from a TOML or from a URDF such as SimArt writes."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import tomllib

from .error import AssetError
from .files import read_text

KINDS = ("revolute", "prismatic", "fixed")
#: Density of a part that names none, kg/m^3, and the range of densities; the published pipeline has the same.
DENSITY = 1500.0
DENSITIES = (20.0, 12000.0)
#: Largest TOML, URDF or JSON, bytes.
MAX_BYTES = 1 << 22
#: Names of parts and joints become names of prims, bodies and files.
NAME = re.compile(r"[A-Za-z_][A-Za-z0-9_]{0,63}")


@dataclass
class Joint:
    """A joint between two parts; ``lower`` and ``upper`` are in rad or m, infinite where the joint is free."""

    name: str
    kind: str
    parent: str
    child: str
    #: A point of the axis and its direction, in the frame of the object's mesh.
    anchor: np.ndarray
    axis: np.ndarray
    lower: float = -np.inf
    upper: float = np.inf


@dataclass
class Inertial:
    """Mass distribution that a file gives: kg, m and kg m^2, in the axes of the object's mesh."""

    mass: float
    com: np.ndarray
    #: About the centre of mass, 3 x 3.
    inertia: np.ndarray


@dataclass
class PartSource:
    name: str
    mesh: Path
    density: float | None = None
    #: From the frame of the mesh file to that of the object, in its axes and units.
    offset: np.ndarray = field(default_factory=lambda: np.zeros(3))
    #: Of the mesh, along its axes; below 0 it mirrors.
    scale: np.ndarray = field(default_factory=lambda: np.ones(3))
    #: In place of the mesh's own colour, linear.
    color: tuple[float, float, float] | None = None
    #: None takes mass and inertia from the volume.
    inertial: Inertial | None = None


@dataclass
class Articulation:
    """Parts in the frame of the object's mesh; the first one is the root."""

    parts: list[PartSource]
    joints: list[Joint]


def check_name(name: object, what: str) -> str:
    if not isinstance(name, str) or not NAME.fullmatch(name):
        raise AssetError(f"{what}: '{name}' cannot be a name; use letters, digits and _, not a digit first, at most 64")
    return name


def inside(folder: Path, name: object, what: str) -> Path:
    """A file of a folder, by a relative path that does not leave it."""
    path = folder / str(name)
    if not isinstance(name, str) or not path.resolve().is_relative_to(folder.resolve()):
        raise AssetError(f"{what}: '{name}' lies outside of {folder}; put it in there")
    return path


def read(path: Path) -> Articulation:
    """Reads parts and joints from a TOML, or from a URDF and the JSON next to it.

    Raises:
        AssetError: A part or joint is missing, wrong, or part of a loop.
    """
    if path.suffix == ".urdf":
        from . import urdf

        return checked(urdf.read(path), path)
    text = read_text(path, MAX_BYTES)
    try:
        document = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise AssetError(f"{path}: {error}") from error
    except RecursionError as error:
        raise AssetError(f"{path}: its brackets nest too deep; write parts and joints as tables") from error
    _known(document, {"parts", "joints"}, str(path))
    parts = [_part(table, path, index) for index, table in enumerate(document.get("parts", []))]
    joints = [_joint(table, path, index) for index, table in enumerate(document.get("joints", []))]
    return checked(Articulation(parts, joints), path)


def checked(articulation: Articulation, path: Path) -> Articulation:
    names = [part.name for part in articulation.parts]
    if not names:
        raise AssetError(f"{path}: it has no parts; give at least one with a mesh")
    for word, listed in [("part", names), ("joint", [joint.name for joint in articulation.joints])]:
        for name in listed:
            if listed.count(name) > 1:
                raise AssetError(f"{path}: two {word}s have the name '{name}'; rename one")
    for joint in articulation.joints:
        what = f"{path}: joint '{joint.name}'"
        for side, part in [("parent", joint.parent), ("child", joint.child)]:
            if part not in names:
                raise AssetError(f"{what}: its {side} '{part}' is not a part; the parts are {', '.join(names)}")
        if joint.kind not in KINDS:
            raise AssetError(f"{what}: kind '{joint.kind}' is not known; use {', '.join(KINDS)}")
        if joint.anchor.shape != (3,) or joint.axis.shape != (3,):
            raise AssetError(f"{what}: its anchor and axis need three numbers each")
        if not (np.isfinite(joint.anchor).all() and np.isfinite(joint.axis).all()):
            raise AssetError(f"{what}: its anchor or axis has a NaN or infinite number")
        length = np.linalg.norm(joint.axis)
        if not length > 1e-6:
            raise AssetError(f"{what}: its axis has no length; give a direction such as [0, 0, 1]")
        joint.axis = joint.axis / length
        limit = 2.0 * np.pi if joint.kind == "revolute" else 100.0
        if np.isnan([joint.lower, joint.upper]).any() or not joint.lower <= joint.upper:
            raise AssetError(f"{what}: lower {joint.lower} is not below upper {joint.upper}")
        if np.isfinite([joint.lower, joint.upper]).all() and joint.upper - joint.lower > limit + 1e-6:
            raise AssetError(
                f"{what}: it spans {joint.upper - joint.lower:.4g}; at most 360 degrees or 100 m are allowed"
            )
    depths: dict[str, int] = {}
    for name in names:
        above = [joint.name for joint in articulation.joints if joint.child == name]
        if len(above) != (0 if name == names[0] else 1):
            raise AssetError(
                f"{path}: part '{name}' is the child of {len(above)} joints; the first part is the root, each other one is"
                " the child of one joint"
            )
        reached, at = {name}, name
        while at != names[0]:
            at = next(joint.parent for joint in articulation.joints if joint.child == at)
            if at in reached:
                raise AssetError(f"{path}: the joints around part '{at}' form a loop")
            reached.add(at)
        depths[name] = len(reached)
    # Every part comes after the one that it hangs on.
    articulation.parts.sort(key=lambda part: depths[part.name])
    return articulation


def check_density(value: object, what: str) -> float | None:
    if value is None:
        return None
    if not isinstance(value, int | float) or not DENSITIES[0] <= value <= DENSITIES[1]:
        raise AssetError(f"{what}: density {value} is outside {DENSITIES[0]} to {DENSITIES[1]} kg/m^3")
    return float(value)


def _known(table: Any, keys: set[str], what: str) -> None:
    if not isinstance(table, dict):
        raise AssetError(f"{what}: it must be a table")
    unknown = sorted(set(table) - keys)
    if unknown:
        raise AssetError(f"{what}: '{unknown[0]}' is not known; use {', '.join(sorted(keys))}")


def _part(table: Any, path: Path, index: int) -> PartSource:
    what = f"{path}: parts[{index}]"
    _known(table, {"name", "mesh", "density"}, what)
    mesh = inside(path.parent, table.get("mesh"), f"{what}.mesh")
    return PartSource(check_name(table.get("name"), f"{what}.name"), mesh, check_density(table.get("density"), what))


def _vector(value: Any, what: str) -> np.ndarray:
    try:
        vector = np.array(value, float)
    except (TypeError, ValueError):
        vector = np.zeros(0)
    if vector.shape != (3,):
        raise AssetError(f"{what}: {value} is not a list of three numbers")
    return vector


def _joint(table: Any, path: Path, index: int) -> Joint:
    what = f"{path}: joints[{index}]"
    _known(table, {"name", "kind", "parent", "child", "anchor", "axis", "lower", "upper"}, what)
    limits = [table.get("lower", -np.inf), table.get("upper", np.inf)]
    if not all(isinstance(limit, int | float) for limit in limits):
        raise AssetError(f"{what}: lower and upper must be numbers, in rad or m")
    return Joint(
        check_name(table.get("name"), f"{what}.name"),
        str(table.get("kind")),
        str(table.get("parent")),
        str(table.get("child")),
        _vector(table.get("anchor"), f"{what}.anchor"),
        _vector(table.get("axis"), f"{what}.axis"),
        float(limits[0]),
        float(limits[1]),
    )
