"""A calibrated object: what all outputs are written from."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from . import articulation, linkage, mesh
from .error import AssetError
from .linkage import DENSITIES, DENSITY, Joint, check_name
from .mesh import Surface, trimesh
from .pieces import pieces

#: What an object can be in the room; `none` only stands on its own.
ROLES = ("none", "crate", "bulb", "ladder", "bench", "fixture")
#: Masses, kg.
MASSES = (1e-3, 500.0)


@dataclass
class Part:
    """A rigid part, in the object's frame: m, kg."""

    name: str
    surface: Surface
    pieces: list[np.ndarray]
    mass: float
    com: np.ndarray
    #: About the centre of mass, axes of the object, 3 x 3.
    inertia: np.ndarray
    density: float
    #: Origin of its body: the anchor of the joint above it; the object's origin for the root.
    origin: np.ndarray


@dataclass
class Object:
    """Its frame: z up, centred in x and y, the lowest point at z = 0."""

    name: str
    role: str
    parts: list[Part]
    joints: list[Joint]
    friction: tuple[float, float]
    fixed: bool
    #: What it was made from, for the manifest.
    source: dict[str, Any] = field(default_factory=dict)

    @property
    def bounds(self) -> np.ndarray:
        """Lowest and highest corner of all parts."""
        vertices = np.concatenate([part.surface.vertices for part in self.parts])
        return np.array([vertices.min(axis=0), vertices.max(axis=0)])

    @property
    def mass(self) -> float:
        return sum(part.mass for part in self.parts)

    def joint_above(self, part: Part) -> Joint | None:
        return next((joint for joint in self.joints if joint.child == part.name), None)


@dataclass
class Settings:
    """Measures by which `build` calibrates an object."""

    name: str
    role: str = "none"
    #: Largest extent, m; None takes the mesh as it is, in `units`.
    size: float | None = None
    units: str = "m"
    up: str | None = None
    #: kg; None takes the density.
    mass: float | None = None
    #: kg/m^3; None takes that of the parts.
    density: float | None = None
    #: Static and dynamic.
    friction: tuple[float, float] = (1.2, 1.0)
    fixed: bool = False
    threshold: float = 0.03
    seed: int = 0
    repair: bool = False

    def check(self) -> None:
        check_name(self.name, "name")
        if self.role not in ROLES:
            raise AssetError(f"role: '{self.role}' is not known; use {', '.join(ROLES)}")
        if self.mass is not None and not MASSES[0] <= self.mass <= MASSES[1]:
            raise AssetError(f"mass: {self.mass} kg is outside {MASSES[0]} to {MASSES[1]} kg")
        linkage.check_density(self.density, "density")
        if self.mass is not None and self.density is not None:
            raise AssetError("mass and density exclude each other; give one of them")
        if not all(0.0 <= friction <= 5.0 for friction in self.friction) or self.friction[1] > self.friction[0]:
            raise AssetError(
                f"friction: {self.friction} must be static and dynamic, 0 to 5, the dynamic one not larger"
            )
        if not 0.01 <= self.threshold <= 1.0:
            raise AssetError(f"threshold: {self.threshold} is outside 0.01 to 1")


def calibrate(source: Path, settings: Settings) -> Object:
    """Makes an object from a mesh, or from the TOML or URDF of its parts.

    The mesh is centred and brought to a largest extent of 1, then to its size.

    Raises:
        AssetError: The source or a setting is refused.
    """
    settings.check()
    if source.suffix in (".toml", ".urdf"):
        articulated = articulation.read(source)
    else:
        articulated = linkage.Articulation([linkage.PartSource(settings.name, source, None)], [])
    surfaces = [placed(part, settings) for part in articulated.parts]
    # A mesh with y up has its joints in the same axes.
    up = settings.up or mesh.FORMATS[articulated.parts[0].mesh.suffix.lower()]
    joints = articulated.joints
    if up == "y":
        for joint in joints:
            joint.anchor, joint.axis = turned(joint.anchor), turned(joint.axis)

    cloud = np.concatenate([surface.vertices for surface in surfaces])
    low, high = cloud.min(axis=0), cloud.max(axis=0)
    whole = Surface(cloud, np.zeros((0, 3), int), None, mesh.Look())
    sized = mesh.in_meters(whole, str(source), settings.units, settings.size)
    scale = float(sized.extents.max() / (high - low).max())
    shift = -scale * np.array([(low[0] + high[0]) / 2.0, (low[1] + high[1]) / 2.0, low[2]])
    for joint in joints:
        joint.anchor = joint.anchor * scale + shift
        if joint.kind == "prismatic":
            joint.lower, joint.upper = joint.lower * scale, joint.upper * scale
    surfaces = [surface.moved(scale, shift) for surface in surfaces]

    solids = [surface.solid() for surface in surfaces]
    given = [inertial_of(part, up, scale, shift, settings) for part in articulated.parts]
    densities = [
        settings.density or (own.mass / solid.volume if own else part.density or DENSITY)
        for part, own, solid in zip(articulated.parts, given, solids)
    ]
    if settings.mass is not None:
        total = sum(solid.volume * density for solid, density in zip(solids, densities))
        densities = [density * settings.mass / total for density in densities]
    parts = []
    for of, surface, solid, density, own in zip(articulated.parts, surfaces, solids, densities, given):
        if not DENSITIES[0] <= density <= DENSITIES[1]:
            low_mass, high_mass = (solid.volume * bound for bound in DENSITIES)
            raise AssetError(
                f"mass: part '{of.name}' of {solid.volume:.4g} m^3 would have a density of {density:.4g} kg/m^3, outside"
                f" {DENSITIES[0]} to {DENSITIES[1]}; its mass must be {low_mass:.3g} to {high_mass:.3g} kg; is the size right?"
            )
        above = next((joint for joint in joints if joint.child == of.name), None)
        mass = solid.volume * density
        com, moment = np.asarray(solid.center_mass), inertia(solid) * density
        if own is not None:
            com, moment = own.com, own.inertia * (mass / own.mass)
            if (com < surface.vertices.min(axis=0)).any() or (com > surface.vertices.max(axis=0)).any():
                raise AssetError(
                    f"mass: the centre of mass of part '{of.name}' lies outside of it; correct its inertial"
                )
        parts.append(
            Part(
                of.name,
                surface,
                pieces(solid, of.name, settings.threshold, settings.seed),
                mass,
                com,
                moment,
                density,
                np.zeros(3) if above is None else above.anchor,
            )
        )
    for part in parts:
        if not MASSES[0] <= part.mass <= MASSES[1]:
            raise AssetError(f"mass: part '{part.name}' has {part.mass:.4g} kg, outside {MASSES[0]} to {MASSES[1]} kg")
    record = {
        "source": source.name,
        "meshes": {part.mesh.name: mesh.sha256(part.mesh) for part in articulated.parts},
        "up": up,
        "unit_extent_per_mesh_unit": float(1.0 / (high - low).max()),
        "meters_per_mesh_unit": scale,
        "not_read": sorted({name for surface in surfaces for name in surface.look.not_read}),
        "triangles": int(sum(len(surface.faces) for surface in surfaces)),
        "pieces": [len(part.pieces) for part in parts],
    }
    return Object(settings.name, settings.role, parts, joints, settings.friction, settings.fixed, record)


def placed(part: linkage.PartSource, settings: Settings) -> Surface:
    """The surface of a part in the frame of the object, z up."""
    surface = mesh.read(part.mesh, settings.up, settings.repair)
    offset, scale = part.offset, part.scale
    if (settings.up or mesh.FORMATS[part.mesh.suffix.lower()]) == "y":
        offset, scale = turned(offset), part.scale[[0, 2, 1]]
    if part.color is not None:
        if surface.look.images:
            surface.look.not_read.append(f"images of {part.mesh.name}, for the URDF's colour")
        surface.look = mesh.Look(part.color, not_read=surface.look.not_read)
    return surface.moved(scale, offset)


def turned(vector: np.ndarray) -> np.ndarray:
    """From y up to z up."""
    return vector[[0, 2, 1]] * [1.0, -1.0, 1.0]


def inertial_of(
    part: linkage.PartSource, up: str, scale: float, shift: np.ndarray, settings: Settings
) -> linkage.Inertial | None:
    """The mass distribution that the source gives, in the frame of the object."""
    own = part.inertial
    if own is None:
        return None
    if settings.density is not None:
        raise AssetError(f"density: part '{part.name}' has its mass and inertia in the source; remove one of them")
    com, moment = own.com, own.inertia
    if up == "y":
        turn = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
        com, moment = turn @ com, turn @ moment @ turn.T
    return linkage.Inertial(own.mass, com * scale + shift, moment * scale**2)


def inertia(solid: trimesh.Trimesh) -> np.ndarray:
    """About the centre of mass, at density 1, with exact symmetry."""
    density, solid.density = solid.density, 1.0
    moment = np.array(solid.moment_inertia)
    solid.density = density
    return (moment + moment.T) / 2.0
