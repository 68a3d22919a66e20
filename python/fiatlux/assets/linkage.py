"""Parts and joints of an object, from whatever file, and checks of their names and densities."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from .error import AssetError

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


def check_density(value: object, what: str) -> float | None:
    if value is None:
        return None
    if not isinstance(value, int | float) or not DENSITIES[0] <= value <= DENSITIES[1]:
        raise AssetError(f"{what}: density {value} is outside {DENSITIES[0]} to {DENSITIES[1]} kg/m^3")
    return float(value)
