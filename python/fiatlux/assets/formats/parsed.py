"""The content of a mesh file, before it is checked."""

from __future__ import annotations

import io
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..error import AssetError, needs
from ..files import read_bytes

#: More are refused before they are decoded. Hunyuan3D writes 40 000.
MAX_TRIANGLES = 1_000_000
MAX_VERTICES = 3 * MAX_TRIANGLES
#: Largest mesh file, and largest image next to it, bytes.
MAX_FILE_BYTES = 1 << 28
MAX_IMAGE_BYTES = 1 << 28
#: Largest image, pixels: 8192 x 8192.
MAX_PIXELS = 1 << 26


@dataclass
class Material:
    """Metallic-roughness material; factors are linear, images are PIL's."""

    color: tuple[float, float, float] | None = None
    metallic: float | None = None
    roughness: float | None = None
    #: ``color``, ``metallic_roughness`` and ``normal``.
    images: dict[str, Any] = field(default_factory=dict)


@dataclass
class Chunk:
    """Triangles of one material: ``vertices`` (n, 3), ``faces`` (m, 3), ``uv`` (n, 2) with v upwards, or None."""

    vertices: np.ndarray
    faces: np.ndarray
    uv: np.ndarray | None = None
    material: Material | None = None


@dataclass
class Parsed:
    chunks: list[Chunk]
    #: Parts of the look that were left out, by name.
    not_read: set[str] = field(default_factory=set)


def check_count(path: Path, triangles: int) -> None:
    if triangles > MAX_TRIANGLES:
        raise AssetError(f"{path}: {triangles} triangles; the limit is {MAX_TRIANGLES}; simplify the mesh first")


def check_vertices(path: Path, vertices: int) -> None:
    if vertices > MAX_VERTICES:
        raise AssetError(f"{path}: {vertices} vertices; the limit is {MAX_VERTICES}; simplify the mesh first")


def image(content: bytes, path: Path, what: str) -> Any:
    try:
        from PIL import Image
    except ImportError as error:
        raise needs(error) from error

    try:
        opened = Image.open(io.BytesIO(content))
        if opened.width * opened.height > MAX_PIXELS:
            raise AssetError(f"{path}: {what} has {opened.width} x {opened.height} pixels; the limit is {MAX_PIXELS}")
        opened.load()
    except AssetError:
        raise
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError) as error:
        raise AssetError(f"{path}: {what} cannot be read as an image: {error}") from error
    return opened


def image_file(file: Path, path: Path) -> Any:
    return image(read_bytes(file, MAX_IMAGE_BYTES), path, f"'{file.name}'")


def triangulated(positions: np.ndarray, numbers: np.ndarray, sizes: np.ndarray, where: Any, path: Path) -> np.ndarray:
    """Polygons as fans of triangles.

    Args:
        positions: Of the corners of all polygons, one polygon after the other, (k, 3).
        numbers: The vertices of the same corners, (k,).
        sizes: The number of corners of each polygon, at least 3.
        where: From a polygon's index to its place in the file, for a message.
        path: For a message.

    Raises:
        AssetError: A polygon is not convex: a fan would cover points outside of it.
    """
    faces = []
    starts = np.cumsum(sizes) - sizes
    for size in np.unique(sizes).tolist():
        members = np.flatnonzero(sizes == size)
        at = starts[members][:, None] + np.arange(size)
        fan = np.array([[0, k, k + 1] for k in range(1, size - 1)])
        if size > 3:
            corners = positions[at]
            first = corners[:, :1]
            normals = np.cross(corners[:, fan[:, 1]] - first, corners[:, fan[:, 2]] - first)
            whole = normals.sum(axis=1)
            edges = np.roll(corners, -1, axis=1) - corners
            turns = np.cross(edges, np.roll(edges, -1, axis=1))
            least = -1e-9 * np.einsum("px,px->p", whole, whole)
            # A corner that turns the other way, or an edge that runs around twice.
            wrong = [np.einsum("pkx,px->pk", of, whole) < least[:, None] for of in (normals, turns)]
            polygons = members[np.any(wrong[0], axis=1) | np.any(wrong[1], axis=1)]
            if polygons.size:
                raise AssetError(
                    f"{path}: {where(int(polygons[0]))} is a polygon that is not convex; triangulate the mesh"
                )
        faces.append(numbers[at][:, fan].reshape(-1, 3))
    return np.concatenate(faces) if faces else np.zeros((0, 3), int)
