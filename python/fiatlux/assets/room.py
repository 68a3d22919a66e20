"""Objects as data of our own engine: `object.toml`, with convex pieces and the numbers that rules read."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

import numpy as np

from .._scene import SCENE
from .error import AssetError, needs
from .object import Object, Part

try:
    from scipy.spatial import ConvexHull
except ImportError as error:
    raise needs(error) from error

#: Version of `object.toml`.
FORMAT = 1
#: Decimals of lengths, m.
DIGITS = 6
#: A bulb's origin lies this far below its cap, as that of the stock bulb.
BULB_ORIGIN: float = SCENE["bulb"]["seat_z"]
#: Up to this height above the cap's bottom a bulb in the room has the stock plug: the socket fits no other one.
PLUG_HEIGHT = 0.0335
#: From the seat to the stop of the stock socket, below which a fixture has its own shape.
STOP_HEIGHT: float = SCENE["fixture"]["stop_height"]
#: From the seat to the mouth of the stock socket.
MOUTH_HEIGHT: float = SCENE["fixture"]["mouth_height"]


def to_toml(thing: Object) -> str:
    """The text of `object.toml`.

    Raises:
        AssetError: Its shape does not fit its role.
    """
    lines = [f"format = {FORMAT}"]
    fields: dict[str, Any] = {
        "name": thing.name,
        "role": thing.role,
        "fixed": thing.fixed,
        "static_friction": thing.friction[0],
        "friction": thing.friction[1],
    }
    lines += assignments(fields)
    shift = role_shift(thing)
    for part in thing.parts:
        i = part.inertia
        joint = thing.joint_above(part)
        fields = {
            "name": part.name,
            "mass": part.mass,
            "com": rounded(part.com + shift),
            "inertia": [i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]],
        }
        lines += ["", "[[links]]", *assignments(fields), "pieces = ["]
        lines += [f"    {text(rounded(corners + shift))}," for corners in role_pieces(thing, part)]
        lines.append("]")
        if joint is not None:
            fields = {
                "parent": joint.parent,
                "kind": joint.kind,
                "anchor": rounded(joint.anchor + shift),
                "axis": joint.axis.tolist(),
                "lower": joint.lower,
                "upper": joint.upper,
            }
            lines += ["", "[links.joint]", *assignments({"name": joint.name, **fields})]
    for section, numbers in role_numbers(thing, shift).items():
        lines += ["", f"[scene.{section}]", *assignments(numbers)]
    return "\n".join(lines) + "\n"


def assignments(fields: Mapping[str, Any]) -> list[str]:
    return [f"{key} = {text(value)}" for key, value in fields.items()]


def text(value: Any) -> str:
    if isinstance(value, bool | str):
        return json.dumps(value)
    if isinstance(value, list | tuple):
        return f"[{', '.join(text(item) for item in value)}]"
    if isinstance(value, int):
        return str(value)
    number = repr(float(value))
    return "0.0" if number == "-0.0" else number


def rounded(values: np.ndarray) -> list[Any]:
    return np.round(values, DIGITS).tolist()


def role_shift(thing: Object) -> np.ndarray:
    """From the object's frame to that of its role in the room."""
    if thing.role == "bulb":
        return np.array([0.0, 0.0, BULB_ORIGIN])
    if thing.role == "fixture":
        return np.array([0.0, 0.0, BULB_ORIGIN + MOUTH_HEIGHT - thing.bounds[1, 2]])
    return np.zeros(3)


def role_pieces(thing: Object, part: Part) -> list[np.ndarray]:
    """The pieces of a part without those for which the room has standard contact geometry."""
    if thing.role not in ("bulb", "fixture"):
        return part.pieces
    if thing.role == "bulb":
        kept = [above(corners, PLUG_HEIGHT) for corners in part.pieces]
    else:
        height = thing.bounds[1, 2] - MOUTH_HEIGHT + STOP_HEIGHT
        mirror = np.array([1.0, 1.0, -1.0])
        kept = [above(corners * mirror, -height) * mirror for corners in part.pieces]
    kept = [corners for corners in kept if len(corners) >= 4]
    if not kept:
        raise AssetError(
            f"role: nothing of '{thing.name}' is left beyond the plug and socket of the room; is its size right?"
        )
    return kept


def above(corners: np.ndarray, height: float) -> np.ndarray:
    """The part of a convex piece above a height; empty where it is thinner than a millimetre."""
    hull = ConvexHull(corners)
    edges = {tuple(sorted((face[k], face[k - 1]))) for face in hull.simplices for k in range(3)}
    points = [corners[at] for at in hull.vertices if corners[at, 2] >= height]
    for a, b in sorted(edges):
        (low, high) = sorted((corners[a], corners[b]), key=lambda corner: corner[2])
        if low[2] < height < high[2]:
            points.append(low + (high - low) * (height - low[2]) / (high[2] - low[2]))
    kept = np.array(points).reshape(-1, 3)
    if len(kept) < 4 or np.ptp(kept[:, 2]) < 1e-3:
        return np.zeros((0, 3))
    from .pieces import thinned

    return thinned(kept)


def role_numbers(thing: Object, shift: np.ndarray) -> dict[str, dict[str, Any]]:
    """The numbers of the room's scene config that the object replaces, by section."""
    low, high = thing.bounds
    if thing.role == "crate":
        return {"crate": of_crate(thing)}
    if thing.role == "bulb":
        return {"bulb": of_bulb(thing, shift)}
    if thing.role == "bench":
        return {"bench": {"surface_height": rounded(high)[2], "footprint_half": rounded((high - low) / 2.0)[:2]}}
    return {}


def of_crate(thing: Object) -> dict[str, Any]:
    """Outer size, and the interior as its pieces leave it: the room between walls, above the floor, below the rim."""
    low, high = thing.bounds
    hulls = [ConvexHull(corners).equations for part in thing.parts for corners in part.pieces]

    def is_inside(points: np.ndarray) -> np.ndarray:
        signed = [points @ planes[:, :3].T + planes[:, 3] for planes in hulls]
        return np.any([(heights <= 1e-6).all(axis=1) for heights in signed], axis=0)

    half = (high - low)[:2] / 2.0
    rim = float(high[2])
    fine = np.linspace(0.0, 1.0, 400)
    # Down from the rim, over the middle half: the highest point of the floor.
    floors = []
    for x in np.linspace(-0.5, 0.5, 5) * half[0]:
        for y in np.linspace(-0.5, 0.5, 5) * half[1]:
            heights = rim * (1.0 - fine)
            hit = np.flatnonzero(is_inside(np.column_stack([np.full(400, x), np.full(400, y), heights])))
            floors.append(float(heights[hit[0]]) if len(hit) else 0.0)
    floor = max(floors)
    if not floor < 0.8 * rim:
        raise AssetError(
            f"role: crate '{thing.name}' is closed or full: its floor is at {floor:.3f} of {rim:.3f} m; it must be open above"
        )
    walls = []
    for axis in (0, 1):
        free = []
        for side in (-1.0, 1.0):
            for across in np.linspace(-0.6, 0.6, 7):
                for height in np.linspace(floor + 0.25 * (rim - floor), rim - 0.05 * (rim - floor), 5):
                    points = np.zeros((400, 3))
                    points[:, axis] = side * half[axis] * fine
                    points[:, 1 - axis] = across * half[1 - axis]
                    points[:, 2] = height
                    hit = np.flatnonzero(is_inside(points))
                    if not len(hit):
                        raise AssetError(
                            f"role: crate '{thing.name}' has no wall towards {'xy'[axis]} {side:+.0f} at height {height:.3f} m"
                        )
                    free.append(half[axis] * fine[hit[0]])
        walls.append(float(min(free)))
    return {
        "outer_half": rounded(half),
        "interior_half": rounded(np.array(walls)),
        "rim_height": round(rim, DIGITS),
        "floor_height": round(max(floor, 1e-3), DIGITS),
    }


def of_bulb(thing: Object, shift: np.ndarray) -> dict[str, Any]:
    """Outline and mass distribution of a body of revolution about z, cap below."""
    (part,) = thing.parts if len(thing.parts) == 1 else (None,)
    if part is None:
        raise AssetError(f"role: bulb '{thing.name}' has {len(thing.parts)} parts; a bulb has one")
    vertices = part.surface.vertices
    radii = np.hypot(vertices[:, 0], vertices[:, 1])
    top = float(vertices[:, 2].max())
    i = part.inertia
    across, along = (i[0, 0] + i[1, 1]) / 2.0, i[2, 2]
    off = np.hypot(*part.com[:2])
    uneven = abs(i[0, 0] - i[1, 1]) / across
    if off > 0.05 * radii.max() or uneven > 0.1:
        found = f"its inertias about x and y differ by {uneven:.0%}"
        if uneven <= 0.1:
            found = f"its centre of mass is {1000.0 * off:.1f} mm off"
        raise AssetError(
            f"role: bulb '{thing.name}' is not round about z ({found}); turn it so that its axis is z and its cap is below"
        )
    heights = np.linspace(0.0, top, 25)
    outline: list[list[float]] = []
    for low, height, high in zip([0.0, *heights], heights, [*heights[1:], top]):
        near = (vertices[:, 2] >= low - 1e-6) & (vertices[:, 2] <= high + 1e-6)
        outline.append([height, float(radii[near].max()) if near.any() else outline[-1][1]])
    outline[-1][1] = 0.0
    profile = np.array(outline) + [shift[2], 0.0]
    return {
        "mass": part.mass,
        "axial_inertia": float(min(along, 1.999 * across)),
        "transverse_inertia": float(across),
        "com_z": round(float(part.com[2] + shift[2]), DIGITS),
        "seat_z": round(float(shift[2]), DIGITS),
        "outline": rounded(profile),
        "lying_height": round(float(radii.max()), DIGITS),
    }
