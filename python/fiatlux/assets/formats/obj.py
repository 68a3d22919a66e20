"""Wavefront OBJ with its material library."""

from __future__ import annotations

import io
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ..error import AssetError
from ..files import named_by, read_bytes
from .parsed import (
    MAX_TRIANGLES,
    MAX_VERTICES,
    Chunk,
    Material,
    Parsed,
    check_count,
    check_vertices,
    image_file,
    triangulated,
)

MAX_LIBRARY_BYTES = 1 << 20
#: Names and groups: the whole file is one surface. Normals follow from the faces.
WITHOUT_SHAPE = {"o", "g", "s", "vn"}
WHAT = {
    "l": "lines",
    "p": "points",
    "vp": "a free-form surface",
    "curv": "a free-form curve",
    "curv2": "a free-form curve",
    "surf": "a free-form surface",
    "cstype": "a free-form surface",
    "call": "another file",
    "csh": "a shell command",
}


def read(path: Path, content: bytes) -> Parsed:
    """Reads polygons with texture coordinates, by material.

    Raises:
        AssetError: A line is wrong, or has something that is not read.
    """
    return Reader(path).read(content)


def lines_of(content: bytes) -> Iterator[tuple[int, str]]:
    """Lines with the number of their first part: a backslash at the end continues a line."""
    before, began = "", 1
    for number, raw in enumerate(io.BytesIO(content), start=1):
        line = raw.decode("utf-8", "replace").rstrip("\r\n")
        if line.endswith("\\"):
            before += line[:-1] + " "
            continue
        yield began, before + line
        before, began = "", number + 1
    if before:
        yield began, before


class Reader:
    def __init__(self, path: Path) -> None:
        self.path = path
        self.points: list[list[float]] = []
        self.uv: list[list[float]] = []
        self.materials: dict[str, Material] = {}
        self.not_read: set[str] = set()
        #: By material: each polygon's numbers of points, of texture coordinates (-1 for none), and its line.
        self.polygons: dict[str, list[tuple[list[int], list[int], int]]] = {}
        self.triangles = 0
        self.normals = 0

    def error(self, line: int, problem: str) -> AssetError:
        return AssetError(f"{self.path}: line {line}: {problem}")

    def read(self, content: bytes) -> Parsed:
        material = ""
        for number, line in lines_of(content):
            word, _, rest = line.split("#", 1)[0].strip().partition(" ")
            if "\t" in word:
                word, _, rest = line.split("#", 1)[0].strip().partition("\t")
            if word == "v":
                self.point(rest, number)
            elif word == "vt":
                values = self.numbers(rest, number)
                if len(values) not in (2, 3) or any(values[2:]):
                    raise self.error(number, f"texture coordinates '{rest}'; only two numbers are read")
                self.uv.append(values[:2])
                if len(self.uv) > MAX_VERTICES:
                    check_vertices(self.path, len(self.uv))
            elif word == "f":
                self.face(rest, number, material)
            elif word == "usemtl":
                material = rest.strip()
            elif word == "mtllib":
                self.library(rest.strip())
            elif word == "vn":
                self.normals += 1
            elif word and word not in WITHOUT_SHAPE:
                what = WHAT.get(word, "an element")
                raise self.error(number, f"'{word[:40]}' is {what} that is not read; export a mesh of polygons")
        return Parsed([self.chunk(name) for name in self.polygons], self.not_read)

    def numbers(self, text: str, line: int) -> list[float]:
        try:
            return [float(value) for value in text.split()]
        except ValueError as error:
            raise self.error(line, f"{error}") from error

    def point(self, text: str, line: int) -> None:
        values = self.numbers(text, line)
        if len(values) == 6:
            self.not_read.add("colours of vertices")
        elif len(values) == 4 and values[3] != 1.0:
            raise self.error(line, f"the weight {values[3]:g} of a point is not read; only 1 is")
        elif len(values) not in (3, 4):
            raise self.error(line, f"a point has {len(values)} numbers; it must have 3")
        self.points.append(values[:3])
        if len(self.points) > MAX_VERTICES:
            check_vertices(self.path, len(self.points))

    def face(self, text: str, line: int, material: str) -> None:
        corners, uv = [], []
        for corner in text.split():
            parts = corner.split("/")
            if len(parts) > 3:
                raise self.error(line, f"corner '{corner[:40]}' cannot be read")
            corners.append(self.index(parts[0], len(self.points), "point", line))
            uv.append(
                self.index(parts[1], len(self.uv), "texture coordinate", line) if len(parts) > 1 and parts[1] else -1
            )
            if len(parts) == 3 and parts[2]:
                self.index(parts[2], self.normals, "normal", line)
        if len(corners) < 3:
            raise self.error(line, f"a face has {len(corners)} corners; it must have at least 3")
        self.triangles += len(corners) - 2
        if self.triangles > MAX_TRIANGLES:
            check_count(self.path, self.triangles)
        self.polygons.setdefault(material, []).append((corners, uv, line))

    def index(self, text: str, count: int, what: str, line: int) -> int:
        """From 1, or from -1 backwards from the last one so far."""
        try:
            number = int(text)
        except ValueError as error:
            raise self.error(line, f"'{text[:40]}' is not the number of a {what}") from error
        at = number - 1 if number > 0 else count + number
        if number == 0 or not 0 <= at < count:
            raise self.error(line, f"a face names {what} {number} of {count}")
        return at

    def library(self, name: str) -> None:
        file = named_by(self.path, name)
        if not file.exists():
            self.not_read.add(f"materials: there is no '{name}'")
            return
        material = Material()
        for line in read_bytes(file, MAX_LIBRARY_BYTES).decode("utf-8", "replace").splitlines():
            key, _, rest = line.split("#", 1)[0].strip().partition(" ")
            rest = rest.strip()
            try:
                if key == "newmtl":
                    material = self.materials.setdefault(rest, Material())
                elif key == "Kd":
                    red, green, blue = (float(value) for value in rest.split())
                    material.color = (red, green, blue)
                elif key == "Pm":
                    material.metallic = float(rest)
                elif key == "Pr":
                    material.roughness = float(rest)
                elif key.lower() == "map_kd":
                    if rest.startswith("-"):
                        raise AssetError(f"{file}: '{key} {rest.split()[0]}': options of an image are not read")
                    material.images["color"] = image_file(named_by(self.path, rest), self.path)
                elif key.lower().startswith(("map_", "bump", "disp", "decal", "norm", "refl")):
                    named_by(self.path, rest.split()[-1] if rest else "")
                    self.not_read.add(f"{key} of materials")
                elif key and not (key == "d" and float(rest) == 1.0) and not (key == "Tr" and float(rest) == 0.0):
                    self.not_read.add(f"{key} of materials")
            except AssetError:
                raise
            except ValueError as error:
                raise AssetError(f"{file}: '{key} {rest}' cannot be read: {error}") from error

    def chunk(self, name: str) -> Chunk:
        polygons = self.polygons[name]
        points = np.array(self.points, float).reshape(-1, 3)
        if name and name not in self.materials:
            self.not_read.add(f"material '{name}': it is in no library")
        material = self.materials.get(name)
        has_uv = bool(self.uv) and all(min(uv) >= 0 for _, uv, _ in polygons)
        if not has_uv and material is not None and material.images:
            self.not_read.add(f"the image of material '{name}': its faces have no texture coordinates")
        # A vertex for each pair of a point and a texture coordinate.
        flat = np.array([at for corners, _, _ in polygons for at in corners])
        flat_uv = np.array([at for _, uv, _ in polygons for at in uv]) if has_uv else np.full(len(flat), -1)
        pairs, vertex = np.unique(np.column_stack([flat, flat_uv]), axis=0, return_inverse=True)
        sizes = np.array([len(corners) for corners, _, _ in polygons])
        where = lambda index: f"the face of line {polygons[index][2]}"
        faces = triangulated(points[flat], vertex.reshape(-1), sizes, where, self.path)
        uv = np.array(self.uv, float)[pairs[:, 1]] if has_uv else None
        return Chunk(points[pairs[:, 0]], faces, uv, material)
