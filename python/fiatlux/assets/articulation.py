"""Reads the parts and joints of an object from a TOML, or from a URDF such as SimArt writes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import tomllib

from . import urdf
from .error import AssetError
from .files import read_text
from .linkage import KINDS, MAX_BYTES, Articulation, Joint, PartSource, check_density, check_name, inside


def read(path: Path) -> Articulation:
    """Reads parts and joints from a TOML, or from a URDF and the JSON next to it.

    Raises:
        AssetError: A part or joint is missing, wrong, or part of a loop.
    """
    if path.suffix == ".urdf":
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
