"""STL: binary, and text."""

from __future__ import annotations

import io
import struct
from pathlib import Path

import numpy as np

from ..error import AssetError
from .parsed import Chunk, Parsed, check_count

HEAD, RECORD = 84, 50


def read(path: Path, content: bytes) -> Parsed:
    """Reads triangles; normals are ignored, since the order of the corners says the same.

    Raises:
        AssetError: It is cut off, or text that is not STL.
    """
    count = struct.unpack("<I", content[80:HEAD])[0] if len(content) >= HEAD else 0
    if len(content) == HEAD + RECORD * count and len(content) > HEAD:
        check_count(path, count)
        records = np.frombuffer(
            content, np.dtype([("normal", "<f4", 3), ("corners", "<f4", 9), ("color", "<u2")]), count, HEAD
        )
        not_read = {"colours of facets"} if records["color"].any() or b"COLOR=" in content[:80] else set()
        return of_corners(records["corners"].reshape(-1, 3).astype(float), not_read)
    if not content[:512].lstrip().lower().startswith(b"solid"):
        raise AssetError(
            f"{path}: cannot be read as stl: it is not text, and {len(content)} bytes are not {HEAD} + {RECORD} x {count}"
        )
    return of_corners(np.array(corners_of(path, content), float).reshape(-1, 3), set())


def check_head(path: Path, head: bytes, size: int) -> None:
    """Refuses a binary file by its first bytes."""
    if len(head) >= HEAD:
        (count,) = struct.unpack("<I", head[80:HEAD])
        if size == HEAD + RECORD * count:
            check_count(path, count)


def of_corners(corners: np.ndarray, not_read: set[str]) -> Parsed:
    vertices, faces = np.unique(corners, axis=0, return_inverse=True)
    return Parsed([Chunk(vertices, faces.reshape(-1, 3))], not_read)


def corners_of(path: Path, content: bytes) -> list[list[float]]:
    corners: list[list[float]] = []
    #: Words that may follow, by the word before.
    after = {
        "": ["solid"],
        "solid": ["facet", "endsolid"],
        "facet": ["outer"],
        "outer": ["vertex"],
        "vertex": ["vertex", "endloop"],
        "endloop": ["endfacet"],
        "endfacet": ["facet", "endsolid"],
        "endsolid": ["solid"],
    }
    last, in_loop = "", 0
    for number, line in enumerate(io.BytesIO(content), start=1):
        words = line.decode("latin-1").split()
        if not words:
            continue
        word = words[0].lower()
        if word not in after[last]:
            raise AssetError(
                f"{path}: cannot be read as stl: line {number}: '{words[0][:40]}' after '{last}'; it must be {' or '.join(after[last])}"
            )
        last = word
        if word == "outer":
            in_loop = 0
        elif word == "vertex":
            try:
                x, y, z = (float(value) for value in words[1:])
            except ValueError as error:
                raise AssetError(f"{path}: line {number}: a vertex has three numbers: {error}") from error
            corners.append([x, y, z])
            in_loop += 1
        elif word == "endloop" and in_loop != 3:
            raise AssetError(f"{path}: line {number}: a facet with {in_loop} corners; only triangles are read")
        elif word == "facet" and len(corners) % 3_000 == 0:
            check_count(path, len(corners) // 3)
    if last != "endsolid":
        raise AssetError(f"{path}: cannot be read as stl: it ends after '{last}'; the file is cut off")
    check_count(path, len(corners) // 3)
    return corners
