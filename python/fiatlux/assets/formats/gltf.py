"""glTF 2.0, as JSON with its files or as GLB."""

from __future__ import annotations

import base64
import binascii
import json
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from ..error import AssetError
from ..files import named_by, read_bytes
from .parsed import MAX_FILE_BYTES, MAX_TRIANGLES, Chunk, Material, Parsed, check_vertices, image

#: Nodes nest this deep, and are this many.
MAX_DEPTH = 64
MAX_NODES = 100_000
#: Extensions that are read.
READ = {"KHR_mesh_quantization", "EXT_texture_webp"}
#: Extensions that change neither shape nor what is read of the look, unless a file requires them.
WITHOUT_SHAPE = {"KHR_xmp_json_ld", "KHR_lights_punctual"}
#: Looks are named and left out, but for those that hold what is read of other looks.
LOOKS, NOT_LOOKS = "KHR_materials_", {"KHR_materials_pbrSpecularGlossiness", "KHR_materials_variants"}
REMEDIES = {
    "KHR_draco_mesh_compression": "it is compressed by Draco, which is not read; export it without compression",
    "EXT_meshopt_compression": "it is compressed by meshopt, which is not read; export it without compression",
    "EXT_mesh_gpu_instancing": "it repeats meshes by EXT_mesh_gpu_instancing, which is not read; export each copy as a node",
}
MODES = ["points", "lines", "line loops", "line strips", "triangles", "triangle strips", "triangle fans"]
COMPONENTS = {5120: "i1", 5121: "u1", 5122: "i2", 5123: "u2", 5125: "u4", 5126: "f4"}
WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
#: Of vertices; normals and tangents follow from the faces.
ATTRIBUTES = {"POSITION", "NORMAL", "TANGENT", "TEXCOORD_0"}
REPEAT = 10497


def read(path: Path, content: bytes) -> Parsed:
    """Reads the triangles of its scene, each mesh as often as nodes show it.

    Raises:
        AssetError: It is cut off, or has something that is not read.
    """
    try:
        return Reader(path, *chunks(content)).read()
    except AssetError:
        raise
    except (KeyError, IndexError, TypeError, AttributeError, ValueError, OverflowError, struct.error) as error:
        raise AssetError(f"{path}: cannot be read as gltf: {type(error).__name__}: {error}") from error
    except RecursionError as error:
        raise AssetError(f"{path}: cannot be read as gltf: its JSON nests too deep") from error


def chunks(content: bytes) -> tuple[dict[str, Any], bytes]:
    """The JSON and the binary chunk."""
    if content[:4] != b"glTF":
        return json.loads(content), b""
    _, version, length = struct.unpack("<4sII", content[:12])
    if version != 2 or length > len(content):
        raise ValueError(f"version {version}, {length} of {len(content)} bytes")
    found: dict[bytes, bytes] = {}
    at = 12
    while at + 8 <= length:
        size, kind = struct.unpack("<I4s", content[at : at + 8])
        if at + 8 + size > length:
            raise ValueError("a chunk is cut off")
        found.setdefault(kind, content[at + 8 : at + 8 + size])
        at += 8 + size
    return json.loads(found[b"JSON"]), found.get(b"BIN\0", b"")


class Reader:
    def __init__(self, path: Path, document: dict[str, Any], binary: bytes) -> None:
        self.path, self.document, self.binary = path, document, binary
        self.not_read: set[str] = set()
        self.buffers: dict[int, bytes] = {}
        self.arrays: dict[int, np.ndarray] = {}
        self.materials: dict[int, Material] = {}

    def error(self, problem: str) -> AssetError:
        return AssetError(f"{self.path}: {problem}")

    def of(self, name: str) -> list[Any]:
        return self.document.get(name, [])

    def read(self) -> Parsed:
        for entry in [*self.of("buffers"), *self.of("images")]:
            uri = entry.get("uri", "data:")
            if not uri.startswith("data:"):
                named_by(self.path, uri)
        self.check()
        placed = list(self.placed())
        counts = [self.count(mesh) for mesh, _ in placed]
        if sum(counts) > MAX_TRIANGLES:
            raise self.error(
                f"{sum(counts)} triangles in {len(counts)} nodes; the limit is {MAX_TRIANGLES}; simplify the mesh first"
            )
        check_vertices(self.path, sum(self.vertices(mesh) for mesh, _ in placed))
        found = [self.chunk(primitive, world) for mesh, world in placed for primitive in mesh["primitives"]]
        return Parsed(found, self.not_read)

    def check(self) -> None:
        version = str(self.document["asset"]["version"])
        if not version.startswith("2."):
            raise self.error(f"it is glTF {version}; only 2.0 is read")
        required = set(self.of("extensionsRequired"))
        for name in sorted({*self.of("extensionsUsed"), *required, *extensions(self.document)}):
            if name in REMEDIES:
                raise self.error(REMEDIES[name])
            is_look = name.startswith(LOOKS) and name not in NOT_LOOKS
            if name in READ:
                continue
            if not (is_look or name in WITHOUT_SHAPE) or name in required:
                raise self.error(f"its extension '{name}' is not read; export it without")
            self.not_read.add(name)
        for name in ("skins", "animations", "cameras"):
            if self.of(name):
                raise self.error(f"it has {name}, which are not read; export the mesh in its pose, without {name}")
        if len(self.of("scenes")) != 1:
            raise self.error(f"it has {len(self.of('scenes'))} scenes; export one")

    def placed(self) -> Iterator[tuple[dict[str, Any], np.ndarray]]:
        """Meshes with their transforms into the scene."""
        nodes, meshes = self.of("nodes"), self.of("meshes")
        todo = [(at, np.eye(4), 1) for at in reversed(self.document["scenes"][0].get("nodes", []))]
        seen: set[int] = set()
        while todo:
            at, parent, depth = todo.pop()
            if not isinstance(at, int) or not 0 <= at < len(nodes):
                raise self.error(f"node {at} does not exist; it has {len(nodes)}")
            if at in seen:
                raise self.error(f"node {at} has two places in the scene; nodes must form a tree")
            seen.add(at)
            if depth > MAX_DEPTH or len(seen) > MAX_NODES:
                raise self.error(
                    f"its nodes nest deeper than {MAX_DEPTH} or are more than {MAX_NODES}; export a flat scene"
                )
            node = nodes[at]
            world = parent @ self.transform(node, at)
            if "mesh" in node:
                if node.get("weights") or meshes[node["mesh"]].get("weights"):
                    raise self.error(f"node {at} has morph targets, which are not read; apply them")
                yield meshes[node["mesh"]], world
            todo += [(child, world, depth + 1) for child in reversed(node.get("children", []))]

    def transform(self, node: dict[str, Any], at: int) -> np.ndarray:
        if "matrix" in node:
            local = np.array(node["matrix"], float).reshape(4, 4).T
            if len({"translation", "rotation", "scale"} & set(node)) or np.abs(local[3] - [0, 0, 0, 1]).max() > 1e-6:
                raise self.error(f"node {at} has a matrix with a projection, or with a translation, rotation or scale")
        else:
            x, y, z, w = np.array(node.get("rotation", [0, 0, 0, 1]), float)
            if not abs(x * x + y * y + z * z + w * w - 1.0) < 1e-3:
                raise self.error(f"node {at} has a rotation that is not a unit quaternion")
            turn = np.array(
                [
                    [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                    [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                    [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
                ]
            )
            local = np.eye(4)
            local[:3, :3] = turn * np.array(node.get("scale", [1, 1, 1]), float).reshape(3)
            local[:3, 3] = np.array(node.get("translation", [0, 0, 0]), float).reshape(3)
        if not np.isfinite(local).all() or np.linalg.det(local[:3, :3]) == 0.0:
            raise self.error(f"node {at} has a transform that is NaN, infinite, or flattens what it holds")
        return local

    def count(self, mesh: dict[str, Any]) -> int:
        count = 0
        for primitive in mesh["primitives"]:
            mode = primitive.get("mode", 4)
            if mode != 4:
                name = MODES[mode] if isinstance(mode, int) and 0 <= mode < len(MODES) else f"mode {mode}"
                raise self.error(f"it has {name}, which are not read; export triangles")
            if primitive.get("targets"):
                raise self.error("it has morph targets, which are not read; apply them")
            at = primitive.get("indices", primitive["attributes"]["POSITION"])
            corners = self.of("accessors")[at]["count"]
            if not isinstance(corners, int) or corners < 0 or corners % 3:
                raise self.error(f"a primitive has {corners} corners, which are not triangles")
            count += corners // 3
        return count

    def vertices(self, mesh: dict[str, Any]) -> int:
        of = [self.of("accessors")[primitive["attributes"]["POSITION"]] for primitive in mesh["primitives"]]
        return sum(int(accessor["count"]) for accessor in of)

    def chunk(self, primitive: dict[str, Any], world: np.ndarray) -> Chunk:
        attributes = primitive["attributes"]
        vertices = self.array(attributes["POSITION"], "VEC3")
        if "indices" in primitive:
            faces = self.array(primitive["indices"], "SCALAR").reshape(-1, 3).astype(np.int64)
        else:
            faces = np.arange(len(vertices)).reshape(-1, 3)
        if faces.size and faces.max() >= len(vertices):
            raise self.error(f"a face names vertex {faces.max()} of {len(vertices)}")
        if any(name.startswith(("JOINTS_", "WEIGHTS_")) for name in attributes):
            raise self.error("its vertices have joints and weights, which are not read; export the mesh in its pose")
        for name in attributes:
            if name.startswith("COLOR_"):
                self.not_read.add("colours of vertices")
            elif name not in ATTRIBUTES:
                self.not_read.add(f"attribute '{name}' of vertices")
        vertices = vertices @ world[:3, :3].T + world[:3, 3]
        if np.linalg.det(world[:3, :3]) < 0.0:
            faces = faces[:, ::-1]
        uv = None
        if "TEXCOORD_0" in attributes:
            uv = self.array(attributes["TEXCOORD_0"], "VEC2") * [1.0, -1.0] + [0.0, 1.0]
            if len(uv) != len(vertices):
                raise self.error(f"{len(uv)} texture coordinates for {len(vertices)} vertices")
        material = self.material(primitive["material"]) if "material" in primitive else None
        if uv is None and material is not None and material.images:
            self.not_read.add("images of faces without texture coordinates")
        return Chunk(vertices, faces, uv, material)

    def array(self, at: int, kind: str) -> np.ndarray:
        """Numbers of an accessor, (n, width), as f64; normalised integers from 0 or -1 to 1."""
        if at in self.arrays:
            return self.arrays[at]
        accessor = self.of("accessors")[at]
        if "sparse" in accessor or "bufferView" not in accessor:
            raise self.error(f"accessor {at} is sparse, or has no buffer, which is not read; export it without")
        if accessor["type"] != kind:
            raise self.error(f"accessor {at} has {accessor['type']}, not {kind}")
        view = self.of("bufferViews")[accessor["bufferView"]]
        component = np.dtype("<" + COMPONENTS[accessor["componentType"]])
        width = WIDTHS[kind]
        stride = view.get("byteStride", component.itemsize * width)
        count, offset = accessor["count"], accessor.get("byteOffset", 0)
        size = component.itemsize * width
        if min(count, offset) < 0 or stride < size or offset + (count - 1) * stride + size > view["byteLength"]:
            raise self.error(f"accessor {at} leaves its buffer view")
        start = view.get("byteOffset", 0)
        if start < 0:
            raise self.error(f"buffer view {accessor['bufferView']} begins before its buffer")
        content = self.buffer(view["buffer"])[start : start + view["byteLength"]]
        if len(content) < view["byteLength"]:
            raise self.error(f"buffer view {accessor['bufferView']} leaves its buffer")
        numbers = np.ndarray((count, width), component, content, offset, (stride, component.itemsize)).astype(float)
        if accessor.get("normalized") and component.kind != "f":
            numbers = np.maximum(numbers / np.iinfo(component).max, -1.0)
        self.arrays[at] = numbers
        return numbers

    def buffer(self, at: int) -> bytes:
        if at not in self.buffers:
            entry = self.of("buffers")[at]
            self.buffers[at] = self.content(entry["uri"]) if "uri" in entry else self.binary
        return self.buffers[at]

    def content(self, uri: str) -> bytes:
        if not uri.startswith("data:"):
            return read_bytes(named_by(self.path, uri), MAX_FILE_BYTES)
        head, _, data = uri.partition(",")
        if not head.endswith(";base64"):
            raise self.error("it has data that is not base64")
        try:
            return base64.b64decode(data, validate=True)
        except binascii.Error as error:
            raise self.error(f"its data is not base64: {error}") from error

    def material(self, at: int) -> Material:
        if at in self.materials:
            return self.materials[at]
        entry = self.of("materials")[at]
        pbr = entry.get("pbrMetallicRoughness", {})
        red, green, blue, alpha = (float(value) for value in pbr.get("baseColorFactor", [1, 1, 1, 1]))
        made = Material(
            (red, green, blue), float(pbr.get("metallicFactor", 1.0)), float(pbr.get("roughnessFactor", 1.0))
        )
        channels = {
            "color": pbr.get("baseColorTexture"),
            "metallic_roughness": pbr.get("metallicRoughnessTexture"),
            "normal": entry.get("normalTexture"),
        }
        made.images = {channel: self.texture(info) for channel, info in channels.items() if info is not None}
        if entry.get("alphaMode", "OPAQUE") != "OPAQUE" or alpha != 1.0:
            self.not_read.add("transparency")
        if (entry.get("normalTexture") or {}).get("scale", 1.0) != 1.0:
            self.not_read.add("scale of normals")
        if "emissiveTexture" in entry or any(entry.get("emissiveFactor", [])):
            self.not_read.add("light of materials")
        if "occlusionTexture" in entry:
            self.not_read.add("occlusion")
        self.materials[at] = made
        return made

    def texture(self, info: dict[str, Any]) -> Any:
        if info.get("texCoord", 0) != 0:
            raise self.error(f"a texture has coordinates {info['texCoord']}; only the first ones are read")
        entry = self.of("textures")[info["index"]]
        sampler = self.of("samplers")[entry["sampler"]] if "sampler" in entry else {}
        if {sampler.get("wrapS", REPEAT), sampler.get("wrapT", REPEAT)} != {REPEAT}:
            self.not_read.add("textures that do not repeat")
        source = entry.get("extensions", {}).get("EXT_texture_webp", entry)["source"]
        found = self.of("images")[source]
        if "uri" in found:
            content = self.content(found["uri"])
        else:
            view = self.of("bufferViews")[found["bufferView"]]
            start = view.get("byteOffset", 0)
            content = self.buffer(view["buffer"])[start : start + view["byteLength"]]
        return image(content, self.path, f"image {source}")


def extensions(document: dict[str, Any]) -> set[str]:
    """Names of all extensions in use, also of those that it does not list."""
    found: set[str] = set()
    todo: list[Any] = [document]
    while todo:
        entry = todo.pop()
        if isinstance(entry, dict):
            if isinstance(entry.get("extensions"), dict):
                found |= set(entry["extensions"])
            # Extras mean what their authors like.
            todo += [value for key, value in entry.items() if key != "extras"]
        elif isinstance(entry, list):
            todo += [value for value in entry if isinstance(value, dict | list)]
    return found
