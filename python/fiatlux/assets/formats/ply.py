"""PLY: text, and binary of both byte orders."""

from __future__ import annotations

import re
import struct
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..error import AssetError
from ..files import named_by
from .parsed import Chunk, Material, Parsed, check_count, check_vertices, image_file, triangulated

TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4"},
    **{"double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"float32": "f4", "float64": "f8"},
}
ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
CORNERS = ("vertex_indices", "vertex_index")
MAX_HEADER_BYTES = 1 << 16
#: A count of a header.
COUNT = re.compile("[0-9]{1,18}")
#: Pairs of properties that are texture coordinates.
TEXTURE = [("s", "t"), ("u", "v"), ("texture_u", "texture_v")]


@dataclass
class Element:
    name: str
    count: int
    #: Name, type of its numbers, and type of its length where it is a list.
    properties: list[tuple[str, str, str | None]] = field(default_factory=list)


@dataclass
class Header:
    order: str
    elements: list[Element]
    image: str | None
    size: int


def read(path: Path, content: bytes) -> Parsed:
    """Reads vertices and polygons.

    Raises:
        AssetError: It is cut off, or has an element or list that is not read.
    """
    header = header_of(path, content, len(content))
    try:
        columns = text(header, content) if header.order == "" else binary(header, content)
    except AssetError:
        raise
    except (ValueError, IndexError, struct.error) as error:
        raise AssetError(f"{path}: cannot be read as ply: its elements do not fit its header: {error}") from error
    return parsed(path, header, columns)


def check_head(path: Path, head: bytes, size: int) -> None:
    """Refuses a file by its header."""
    header_of(path, head, size)


def header_of(path: Path, content: bytes, of: int) -> Header:
    """The header in the first bytes of a file of `of` bytes."""

    def wrong(problem: str) -> AssetError:
        return AssetError(f"{path}: cannot be read as ply: {problem}")

    end = content.find(b"end_header", 0, MAX_HEADER_BYTES)
    if content[:3] != b"ply" or end < 0:
        raise wrong("it has no header of a PLY file")
    size = content.find(b"\n", end) + 1
    order, elements, image = None, [], None
    for line in content[:end].decode("latin-1").splitlines()[1:]:
        words = line.split()
        if not words or words[0] == "obj_info":
            continue
        if words[0] == "comment":
            if len(words) > 2 and words[1].lower() == "texturefile":
                image = line.split(maxsplit=2)[2].strip()
        elif words[0] == "format" and len(words) == 3 and words[1] in ORDERS and words[2] == "1.0":
            order = ORDERS[words[1]]
        elif words[0] == "element" and len(words) == 3 and COUNT.fullmatch(words[2]):
            elements.append(Element(words[1], int(words[2])))
        elif words[0] == "property" and elements and len(words) == 3 and words[1] in TYPES:
            elements[-1].properties.append((words[2], TYPES[words[1]], None))
        elif words[0] == "property" and elements and len(words) == 5 and words[1] == "list":
            if words[2] not in TYPES or TYPES[words[2]][0] == "f" or words[3] not in TYPES:
                raise wrong(f"'{line.strip()}' is not a list of numbers")
            elements[-1].properties.append((words[4], TYPES[words[3]], TYPES[words[2]]))
        else:
            raise wrong(f"'{line.strip()[:60]}' is not a line of a header")
    if order is None or size == 0:
        raise wrong("its header names no format, ascii or binary of version 1.0")
    names = [element.name for element in elements]
    for name in names:
        if name not in ("vertex", "face"):
            raise AssetError(f"{path}: its element '{name}' is not read; export vertices and faces alone")
    if sorted(names) != ["face", "vertex"]:
        raise AssetError(f"{path}: it has the elements {names}; it must have one 'vertex' and one 'face'")
    for element in elements:
        lists = [name for name, _, length in element.properties if length is not None]
        if element.name == "vertex" and lists:
            raise AssetError(f"{path}: the list '{lists[0]}' of its vertices is not read; export it without")
        if element.name == "vertex":
            check_vertices(path, element.count)
        if element.name == "face":
            check_count(path, element.count)
            if len([name for name in lists if name in CORNERS]) != 1:
                raise AssetError(f"{path}: its faces must have one list {' or '.join(CORNERS)}; found {lists}")
        # A number takes at least a byte.
        if element.count * len(element.properties) > of:
            raise wrong(f"its header has {element.count} of '{element.name}', its {of} bytes cannot hold them")
    return Header(order, elements, image, size)


#: By element and property: numbers of all rows, or a list for each row.
Columns = dict[tuple[str, str], Any]


def text(header: Header, content: bytes) -> Columns:
    columns: Columns = {}
    words = content[header.size :].split()
    at = 0
    for element in header.elements:
        if all(length is None for _, _, length in element.properties):
            width = len(element.properties)
            rows = np.array(words[at : at + element.count * width], float).reshape(element.count, width)
            at += element.count * width
            columns |= {(element.name, name): rows[:, k] for k, (name, _, _) in enumerate(element.properties)}
            continue
        listed: dict[str, list[Any]] = {name: [] for name, _, _ in element.properties}
        for _ in range(element.count):
            for name, _, length in element.properties:
                if length is None:
                    at += 1
                    continue
                count = int(words[at])
                if count < 0 or at + 1 + count > len(words):
                    raise ValueError(f"a list of {count} numbers")
                listed[name].append(np.array(words[at + 1 : at + 1 + count], float))
                at += 1 + count
        columns |= {(element.name, name): rows for name, rows in listed.items()}
    if at != len(words):
        raise ValueError(f"{len(words) - at} numbers too many")
    return columns


def binary(header: Header, content: bytes) -> Columns:
    columns: Columns = {}
    order, at = header.order, header.size
    for element in header.elements:
        if all(length is None for _, _, length in element.properties):
            kind = np.dtype([(f"{k}", order + of) for k, (_, of, _) in enumerate(element.properties)])
            rows = np.frombuffer(content, kind, element.count, at)
            at += kind.itemsize * element.count
            columns |= {
                (element.name, name): rows[f"{k}"].astype(float) for k, (name, _, _) in enumerate(element.properties)
            }
            continue
        alike = of_one_length(element, order, content, at)
        if alike is not None:
            rows, size = alike
            at += size
            columns |= {(element.name, name): rows[f"{k}"] for k, (name, _, _) in enumerate(element.properties)}
            continue
        listed: dict[str, list[Any]] = {name: [] for name, _, _ in element.properties}
        kinds = [
            (name, np.dtype(order + of), None if length is None else np.dtype(order + length))
            for name, of, length in element.properties
        ]
        for _ in range(element.count):
            for name, of, length in kinds:
                if length is None:
                    at += of.itemsize
                    continue
                count = int.from_bytes(
                    content[at : at + length.itemsize],
                    "little" if order == "<" else "big",
                    signed=length.kind == "i",
                )
                if count < 0 or at + length.itemsize > len(content):
                    raise ValueError(f"a list of {count} numbers")
                at += length.itemsize
                listed[name].append(np.frombuffer(content, of, count, at))
                at += count * of.itemsize
        columns |= {(element.name, name): rows for name, rows in listed.items()}
    if at != len(content):
        raise ValueError(f"{len(content) - at} bytes too many")
    return columns


def of_one_length(element: Element, order: str, content: bytes, at: int) -> tuple[np.ndarray, int] | None:
    """The rows of an element whose lists are all as long as those of its first row, and their size; None for others."""
    fields: list[Any] = []
    start = at
    for k, (_, of, length) in enumerate(element.properties):
        if length is None:
            fields.append((f"{k}", order + of))
        else:
            kind = np.dtype(order + length)
            count = int(np.frombuffer(content, kind, 1, start)[0])
            if not 0 <= count <= 255:
                return None
            fields += [(f"{k} length", kind), (f"{k}", order + of, (count,))]
        start = at + np.dtype(fields).itemsize
    rows_kind = np.dtype(fields)
    size = rows_kind.itemsize * element.count
    if element.count == 0 or at + size > len(content):
        return None
    rows = np.frombuffer(content, rows_kind, element.count, at)
    lengths = [name for name in rows_kind.names or () if name.endswith(" length")]
    return (rows, size) if all((rows[name] == rows[name][0]).all() for name in lengths) else None


def parsed(path: Path, header: Header, columns: Columns) -> Parsed:
    missing = [axis for axis in "xyz" if ("vertex", axis) not in columns]
    if missing:
        raise AssetError(f"{path}: its vertices have no '{missing[0]}'")
    points = np.column_stack([columns["vertex", axis] for axis in "xyz"]).astype(float)
    known = {("vertex", axis) for axis in ("x", "y", "z", "nx", "ny", "nz")}
    (corners,) = (rows for (element, name), rows in columns.items() if element == "face" and name in CORNERS)
    known |= {("face", name) for name in CORNERS}
    uv = None
    for pair in TEXTURE:
        if all(("vertex", name) in columns for name in pair):
            uv = np.column_stack([columns["vertex", name] for name in pair]).astype(float)
            known |= {("vertex", name) for name in pair}
    not_read = {f"{element} property '{name}'" for element, name in set(columns) - known}
    material = None
    if header.image is not None:
        file = named_by(path, header.image)
        if uv is None:
            not_read.add(f"image '{header.image}': vertices have no texture coordinates")
        else:
            material = Material(images={"color": image_file(file, path)})
    sizes = np.array([len(row) for row in corners], np.int64)
    if (sizes < 3).any():
        raise AssetError(f"{path}: face {int(sizes.argmin())} has {sizes.min()} corners; it must have at least 3")
    check_count(path, int((sizes - 2).sum()))
    flat = np.concatenate([np.zeros(0), *([np.ravel(corners)] if isinstance(corners, np.ndarray) else corners)])
    wrong = flat[~((flat >= 0) & (flat < len(points)) & (flat == np.floor(flat)))]
    if wrong.size:
        raise AssetError(f"{path}: a face names vertex {wrong[0]:g} of {len(points)}")
    flat = flat.astype(np.int64)
    faces = triangulated(points[flat], flat, sizes, lambda index: f"face {index}", path)
    return Parsed([Chunk(points, faces, uv, material)], not_read)
