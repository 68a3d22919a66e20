"""Readers of mesh files and URDF: each feature of a format is read right, or refused or named by its name."""

import base64
import json
import os
import struct
from pathlib import Path

import pytest

if "FIATLUX_EXTRAS" not in os.environ:
    for module in ("trimesh", "scipy", "networkx", "coacd", "PIL", "pxr", "mujoco"):
        pytest.importorskip(module)

import numpy as np
import trimesh
from fiatlux.assets import AssetError, articulation, files, mesh, pieces, urdf, verify
from fiatlux.assets.build import build
from fiatlux.assets.object import Settings, calibrate
from fiatlux.assets.unread import unread
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdPhysics, UsdSkel

RECORDED = Path(__file__).parent / "generated"
BOX = trimesh.creation.box((2.0, 3.0, 4.0))
#: A box of 2 x 3 x 4 as six quadrilaterals.
QUADS = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
CORNERS = [[x, y, z] for z in (0, 4) for y in (0, 3) for x in (0, 2)]


def volume_of(path, **options):
    solid = mesh.read(path, **options).solid()
    return round(float(solid.volume), 6), solid.extents.round(6).tolist()


RIGHT = (24.0, [2.0, 3.0, 4.0])


def box_at(x, y, z, extents=(2.0, 2.0, 2.0)):
    """A box with its lowest corner there."""
    box = trimesh.creation.box(extents)
    box.apply_translation(np.array([x, y, z]) + np.array(extents) / 2)
    return box


@pytest.mark.parametrize("ending", [".stl", ".obj", ".ply", ".glb"])
@pytest.mark.parametrize(
    "boxes",
    [
        [box_at(0, 0, 0), box_at(0, 0, 2)],
        [box_at(0, 0, 0), box_at(2, 0, 0), box_at(0, 2, 0), box_at(2, 2, 0)],
        [box_at(0, 0, 0), box_at(2, 0, 2)],
        [box_at(0, 0, 0), box_at(2, 2, 2)],
        [box_at(0, 0, 0), box_at(0, 0, 2, (1.0, 2.0, 1.0))],
        [box_at(0, 0, 0), box_at(0, 0, 2), box_at(5, 0, 0)],
    ],
    ids=["face", "four at an edge", "edge", "corner", "half of a face", "one apart"],
)
def test_solids_that_touch_stay_apart(tmp_path, boxes, ending):
    file = tmp_path / f"a{ending}"
    trimesh.util.concatenate(boxes).export(file)
    solid = mesh.read(file, up="z").solid()
    assert solid.volume == pytest.approx(sum(box.volume for box in boxes))
    found = pieces.pieces(solid, "a")
    spans = lambda corners: [round(float(at), 6) for at in (*corners.min(axis=0), *corners.max(axis=0))]  # noqa: E731
    assert sorted(map(spans, found)) == sorted(spans(box.vertices) for box in boxes)


def test_a_flat_part_is_named(tmp_path):
    square = trimesh.Trimesh([[5, 0, 0], [6, 0, 0], [6, 1, 0], [5, 1, 0]], [[0, 1, 2], [0, 2, 3], [0, 2, 1], [0, 3, 2]])
    file = tmp_path / "a.stl"
    trimesh.util.concatenate([BOX, square]).export(file)
    with pytest.raises(AssetError, match=r"a part of 4 triangles at \(5.5, 0.5, 0\) m is flat; delete it"):
        pieces.pieces(mesh.read(file).solid(), "a")


def refused(path, message):
    with pytest.raises(AssetError, match=message) as caught:
        mesh.read(path)
    words = str(caught.value)
    assert words.count(str(path.parent)) == 1 and "\n" not in words and "AssetError" not in words


# OBJ


def obj_text(faces=QUADS, head=""):
    return (
        head
        + "".join(f"v {x} {y} {z}\n" for x, y, z in CORNERS)
        + "".join("f " + " ".join(str(at + 1) for at in face) + "\n" for face in faces)
    )


def test_obj_quads_relative_numbers_and_continued_lines(tmp_path):
    file = tmp_path / "a.obj"
    relative = [[at - 8 for at in face] for face in QUADS]
    for text in (
        obj_text(),
        obj_text().replace("f 1 3 4 2", "f 1 3 \\\n 4 2"),
        obj_text().replace("f ", "f  ").replace("v ", "v\t"),
        "o a\ng b\ns off\n" + obj_text().replace("v 0 0 0", "v 0 0 0 1.0 # corner"),
        obj_text(faces=[]) + "".join("f " + " ".join(str(at) for at in face) + "\n" for face in relative),
    ):
        file.write_text(text)
        assert volume_of(file) == RIGHT


@pytest.mark.parametrize(
    "line, message",
    [
        ("l 1 2", "'l' is lines that is not read"),
        ("p 1", "'p' is points"),
        ("vp 0.1", "'vp' is a free-form surface"),
        ("cstype bezier", "'cstype' is a free-form surface"),
        ("call other.obj", "'call' is another file"),
        ("csh rm", "'csh' is a shell command"),
        ("lod 1", "'lod' is an element that is not read"),
        ("v 0 0 0 2.0", "the weight 2 of a point"),
        ("v 0 0", "a point has 2 numbers"),
        ("v 0 0 x", "could not convert"),
        ("f 1 2", "a face has 2 corners"),
        ("f 1 2 0", "names point 0 of 8"),
        ("f 1 2 9", "names point 9 of 8"),
        ("f 1/1 2/1 3/1", "names texture coordinate 1 of 0"),
        ("f 1 2 3.5", "'3.5' is not the number of a point"),
        ("vt 0 0 0.5", "only two numbers are read"),
    ],
)
def test_obj_lines_that_are_not_read(tmp_path, line, message):
    (tmp_path / "a.obj").write_text(obj_text() + line + "\n")
    refused(tmp_path / "a.obj", f"line 15: .*{message}")


def test_obj_polygons_must_be_convex(tmp_path):
    outline = [(0, 0), (4, 0), (4, 4), (2, 1), (0, 4)]
    points = [(x, y, z) for z in (0, 1) for x, y in outline]
    sides = [[k, (k + 1) % 5, 5 + (k + 1) % 5, 5 + k] for k in range(5)]
    text = "".join(f"v {x} {y} {z}\n" for x, y, z in points)
    for face in [[4, 3, 2, 1, 0], [5, 6, 7, 8, 9], *sides]:
        text += "f " + " ".join(str(at + 1) for at in face) + "\n"
    (tmp_path / "a.obj").write_text(text)
    refused(tmp_path / "a.obj", "the face of line 11 is a polygon that is not convex")


def test_obj_materials(tmp_path):
    file = tmp_path / "a.obj"
    file.write_text("mtllib a.mtl\nusemtl red\n" + obj_text())
    (tmp_path / "a.mtl").write_text("newmtl red\nKd 0.5 0.25 0.125\nKs 1 1 1\nPm 0.5\nPr 0.25\nd 1.0\n")
    look = mesh.read(file).look
    assert look.color == pytest.approx((0.5, 0.25, 0.125), abs=0.01)
    assert (look.metallic, look.roughness, look.not_read) == (0.5, 0.25, ["Ks of materials"])
    (tmp_path / "a.mtl").write_text("newmtl red\nmap_Kd -s 2 2 2 a.png\n")
    refused(file, "options of an image are not read")
    (tmp_path / "a.mtl").write_text("newmtl red\nKd spectral file.rfl\n")
    refused(file, "'Kd spectral file.rfl' cannot be read")
    (tmp_path / "a.mtl").unlink()
    assert "materials: there is no 'a.mtl'" in mesh.read(file).look.not_read
    os.mkfifo(tmp_path / "a.mtl")
    refused(file, "it is not a regular file")


# STL


def stl_text(word=str):
    lines = ["solid facets of a box"]
    for triangle in BOX.triangles:
        lines += ["facet normal 0 0 1", "outer loop"]
        lines += [f"  vertex {x} {y} {z}" for x, y, z in triangle]
        lines += ["endloop", "endfacet"]
    return word("\n".join([*lines, "endsolid"])) + "\n"


def test_stl_text_and_binary(tmp_path):
    file = tmp_path / "a.stl"
    for text in (
        stl_text(),
        stl_text(str.upper),
        stl_text().replace("\n", "\r\n"),
        stl_text().replace("facet n", "\tfacet  n"),
    ):
        file.write_bytes(text.encode())
        assert volume_of(file) == RIGHT
    BOX.export(file)
    content = file.read_bytes()
    # A header may begin with "solid".
    file.write_bytes(b"solid binary".ljust(80, b" ") + content[80:])
    assert volume_of(file) == RIGHT and mesh.read(file).look.not_read == []
    file.write_bytes(content[:-2] + b"\1\2")
    assert mesh.read(file).look.not_read == ["colours of facets"]


@pytest.mark.parametrize(
    "change, message",
    [
        (lambda text: text.replace("endloop", "vertex 1 1 1\nendloop", 1), "a facet with 4 corners"),
        (lambda text: text.replace("outer loop", "inner loop", 1), "'inner' after 'facet'"),
        (lambda text: text.replace("  vertex", "  vertex 1", 1), "a vertex has three numbers"),
        (lambda text: text[: text.index("endfacet")], "the file is cut off"),
        (lambda text: "solid x\nfacet \x00", "cut off"),
        (lambda text: "stl", "it is not text"),
    ],
)
def test_stl_that_is_wrong(tmp_path, change, message):
    (tmp_path / "a.stl").write_text(change(stl_text()))
    refused(tmp_path / "a.stl", message)


def test_stl_binary_that_is_cut_or_swapped(tmp_path):
    BOX.export(tmp_path / "a.stl")
    content = (tmp_path / "a.stl").read_bytes()
    big = content[:80] + struct.pack(">I", 12) + content[84:]
    for broken in (content[:-1], content + b"\0", big):
        (tmp_path / "a.stl").write_bytes(broken)
        refused(tmp_path / "a.stl", "cannot be read as stl")


# PLY


def ply(order="ascii", spelled="element face", faces=QUADS, head="", after=""):
    text = f"ply\nformat {order} 1.0\n{head}element vertex 8\nproperty float x\nproperty float y\nproperty float z\n"
    text += f"{spelled} {len(faces)}\nproperty list uchar int vertex_indices\n{after}end_header\n"
    if order == "ascii":
        text += "".join(f"{x} {y} {z}\n" for x, y, z in CORNERS)
        return (text + "".join(f"{len(face)} {' '.join(map(str, face))}\n" for face in faces)).encode()
    sign = "<" if "little" in order else ">"
    content = b"".join(struct.pack(sign + "3f", *corner) for corner in CORNERS)
    content += b"".join(struct.pack(f"{sign}B{len(face)}i", len(face), *face) for face in faces)
    return text.encode() + content


#: Two of the quadrilaterals as triangles.
MIXED = [[0, 2, 3], [0, 3, 1], *QUADS[1:]]


@pytest.mark.parametrize("order", ["ascii", "binary_little_endian", "binary_big_endian"])
@pytest.mark.parametrize("faces", [QUADS, MIXED])
def test_ply_of_every_order(tmp_path, order, faces):
    (tmp_path / "a.ply").write_bytes(ply(order, faces=faces, head="comment made here\nobj_info x\n"))
    assert volume_of(tmp_path / "a.ply") == RIGHT
    (tmp_path / "a.ply").write_bytes(ply(order, faces=faces)[: -1 if order != "ascii" else -3])
    refused(tmp_path / "a.ply", "do not fit its header")
    (tmp_path / "a.ply").write_bytes(ply(order, faces=[*faces[1:], [0, 2, 3, 8]]))
    refused(tmp_path / "a.ply", "names vertex 8 of 8")


@pytest.mark.parametrize(
    "old, new, message",
    [
        ("element face 6", "element  face\t2000000", "2000000 triangles; the limit is 1000000"),
        ("element face 6", "element face 900000", "its header has 900000 of 'face'"),
        ("element vertex 8", "element vertex 9000000", "9000000 vertices; the limit is 3000000"),
        ("element face 6", "element edge 6", "its element 'edge' is not read"),
        ("element face 6", "element tristrips 6", "its element 'tristrips' is not read"),
        ("property float z", "property list uchar float z", "the list 'z' of its vertices is not read"),
        ("property float z", "property float w", "its vertices have no 'z'"),
        ("property float z", "property quad z", "is not a line of a header"),
        ("vertex_indices", "corners", "its faces must have one list"),
        ("format ascii 1.0", "format ascii 2.0", "is not a line of a header"),
        ("format ascii 1.0\n", "", "names no format"),
        ("end_header", "end", "it has no header"),
        ("4 0 2 3 1", "2 0 2", "do not fit|has 2 corners"),
        ("4 0 2 3 1", "4 0 2 3 0.5", "names vertex 0.5 of 8"),
    ],
)
def test_ply_that_is_wrong_or_not_read(tmp_path, old, new, message):
    text = ply().decode()
    assert old in text
    (tmp_path / "a.ply").write_text(text.replace(old, new))
    refused(tmp_path / "a.ply", message)


@pytest.mark.parametrize("count", ["\u00b9", "9" * 5000, "-6", "0x6", "6.0", "+6"])
def test_ply_counts_are_plain_numbers(tmp_path, count):
    (tmp_path / "a.ply").write_bytes(ply().replace(b"element face 6", f"element face {count}".encode("latin-1")))
    refused(tmp_path / "a.ply", "is not a line of a header")


def test_ply_names_what_it_leaves_out(tmp_path):
    text = ply().decode().replace("property float z\n", "property float z\nproperty uchar red\n")
    head, body = text.split("end_header\n")
    lines = body.splitlines()
    body = "\n".join([line + " 200" for line in lines[:8]] + lines[8:]) + "\n"
    (tmp_path / "a.ply").write_text(head + "end_header\n" + body)
    assert mesh.read(tmp_path / "a.ply").look.not_read == ["vertex property 'red'"]
    (tmp_path / "a.ply").write_bytes(ply(head="comment TextureFile ../b.png\n"))
    refused(tmp_path / "a.ply", "lies outside of its folder")


# glTF


def gltf(tmp_path, change=None, name="a.gltf"):
    """A box with y up as a document that a test may change."""
    points = np.array(CORNERS, np.float32)
    triangles = np.array([[face[0], face[k], face[k + 1]] for face in QUADS for k in (1, 2)], np.uint16)
    content = points.tobytes() + triangles.tobytes()
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.25, 0.125, 1.0], "roughnessFactor": 0.5}}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 8, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": 36, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": 96},
            {"buffer": 0, "byteOffset": 96, "byteLength": 72},
        ],
        "buffers": [
            {"byteLength": 168, "uri": "data:application/octet-stream;base64," + base64.b64encode(content).decode()}
        ],
    }
    if change is not None:
        change(document)
    (tmp_path / name).write_text(json.dumps(document))
    return tmp_path / name


def put(*path, value):
    def change(document):
        at = document
        for step in path[:-1]:
            at = at[step]
        at[path[-1]] = value

    return change


def test_gltf_has_y_up_and_the_defaults_of_its_specification(tmp_path):
    read = mesh.read(gltf(tmp_path))
    assert volume_of(tmp_path / "a.gltf") == (24.0, [2.0, 4.0, 3.0])
    assert (read.look.metallic, read.look.roughness, read.look.not_read) == (1.0, 0.5, [])
    assert read.look.color == pytest.approx((0.5, 0.25, 0.125), abs=0.01)


@pytest.mark.parametrize(
    "node, extents",
    [
        ({"scale": [2, 1, 1]}, [4.0, 4.0, 3.0]),
        ({"scale": [-1, 1, 1]}, [2.0, 4.0, 3.0]),
        ({"scale": [-1, -1, -1], "translation": [5, 6, 7]}, [2.0, 4.0, 3.0]),
        ({"rotation": [0.7071067811865476, 0, 0, 0.7071067811865476]}, [2.0, 3.0, 4.0]),
        ({"matrix": [0, 2, 0, 0, 1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]}, [3.0, 4.0, 4.0]),
    ],
)
def test_gltf_nodes_move_turn_scale_and_mirror(tmp_path, node, extents):
    """Mirrored ones, too, have a positive volume: their faces are turned again."""
    file = gltf(tmp_path, put("nodes", value=[{"mesh": 0, **node}]))
    volume, found = volume_of(file)
    assert found == pytest.approx(extents, abs=1e-5) and volume == pytest.approx(float(np.prod(extents)), abs=1e-4)


def test_gltf_counts_what_its_scene_shows(tmp_path):
    def instanced(count):
        def change(document):
            nodes = [{"mesh": 0, "translation": [9.0 * k, 0, 0]} for k in range(count)]
            document["nodes"] = [*nodes, {"children": list(range(count))}]
            document["scenes"] = [{"nodes": [count]}]

        return change

    assert volume_of(gltf(tmp_path, instanced(3)))[0] == 72.0
    refused(gltf(tmp_path, instanced(90_000)), "1080000 triangles in 90000 nodes; the limit is 1000000")


def nested(depth):
    nodes = [{"children": [k + 1]} for k in range(depth)] + [{"mesh": 0}]
    return lambda document: document.update(nodes=nodes)


EXTENSIONS = ["extensionsUsed"]


@pytest.mark.parametrize(
    "change, message",
    [
        (nested(20_000), "its nodes nest deeper than 64"),
        (put("nodes", value=[{"mesh": 0, "children": [0]}]), "node 0 has two places"),
        (put("nodes", value=[{"children": [1, 1]}, {"mesh": 0}]), "node 1 has two places"),
        (put("nodes", value=[{"children": [7]}]), "node 7 does not exist"),
        (put("nodes", value=[{"mesh": 0, "scale": [1, 0, 1]}]), "flattens"),
        (put("nodes", value=[{"mesh": 0, "translation": [1e999, 0, 0]}]), "NaN, infinite"),
        (put("nodes", value=[{"mesh": 0, "rotation": [1, 1, 0, 0]}]), "not a unit quaternion"),
        (put("nodes", value=[{"mesh": 0, "weights": [0.5]}]), "morph targets"),
        (put("asset", "version", value="1.0"), "it is glTF 1.0"),
        (put("asset", value={}), "KeyError"),
        (put("scenes", value=[{"nodes": [0]}, {"nodes": []}]), "it has 2 scenes"),
        (put("scenes", value=[]), "it has 0 scenes"),
        (put("animations", value=[{}]), "it has animations, which are not read"),
        (put("skins", value=[{}]), "it has skins"),
        (put("cameras", value=[{}]), "it has cameras"),
        (put("meshes", 0, "primitives", 0, "mode", value=5), "it has triangle strips, which are not read"),
        (put("meshes", 0, "primitives", 0, "mode", value=0), "it has points"),
        (put("meshes", 0, "primitives", 0, "targets", value=[{"POSITION": 0}]), "morph targets"),
        (put("meshes", 0, "primitives", 0, "attributes", "JOINTS_0", value=0), "joints and weights"),
        (put("accessors", 0, "sparse", value={"count": 1}), "accessor 0 is sparse"),
        (put("accessors", 1, value={"componentType": 5123, "count": 36, "type": "SCALAR"}), "has no buffer"),
        (put("accessors", 0, "count", value=9), "accessor 0 leaves its buffer view"),
        (put("accessors", 0, "count", value=10**12), "vertices; the limit is"),
        (put("accessors", 1, "count", value=35), "35 corners, which are not triangles"),
        (put("bufferViews", 1, "byteLength", value=10**9), "buffer view 1 leaves its buffer"),
        (put("bufferViews", 0, "byteOffset", value=-4), "begins before its buffer"),
        (put("extensionsUsed", value=["KHR_draco_mesh_compression"]), "compressed by Draco"),
        (put("extensionsUsed", value=["EXT_meshopt_compression"]), "compressed by meshopt"),
        (put("extensionsUsed", value=["KHR_texture_transform"]), "'KHR_texture_transform' is not read"),
        (put("extensionsUsed", value=["KHR_texture_basisu"]), "'KHR_texture_basisu' is not read"),
        (put("extensionsUsed", value=["KHR_materials_variants"]), "'KHR_materials_variants' is not read"),
        (put("extensionsUsed", value=["KHR_materials_pbrSpecularGlossiness"]), "is not read"),
        (put("extensionsUsed", value=["MSFT_lod"]), "'MSFT_lod' is not read"),
        (put("extensionsRequired", value=["KHR_materials_unlit"]), "'KHR_materials_unlit' is not read"),
        # In use, but not listed.
        (put("nodes", 0, "extensions", value={"EXT_mesh_gpu_instancing": {}}), "repeats meshes by EXT_mesh_gpu"),
        (put("materials", 0, "normalTexture", value={"index": 0, "texCoord": 1}), "coordinates 1; only the first"),
        (put("buffers", 0, "uri", value="data:text/plain,abc"), "not base64"),
        (put("buffers", 0, "uri", value="http://example.org/a.bin"), "lies outside of its folder"),
        (put("meshes", 0, "primitives", 0, "indices", value=9), "IndexError"),
    ],
)
def test_gltf_that_is_wrong_or_not_read(tmp_path, change, message):
    refused(gltf(tmp_path, change), message)


def test_gltf_names_looks_that_it_leaves_out(tmp_path):
    def change(document):
        document["materials"][0].update(alphaMode="BLEND", emissiveFactor=[1, 1, 1], doubleSided=True)
        document["extensionsUsed"] = ["KHR_materials_ior"]
        document["meshes"][0]["primitives"][0]["attributes"].update(COLOR_0=0, NORMAL=0, TEXCOORD_1=0, _HEAT=0)

    read = mesh.read(gltf(tmp_path, change))
    assert read.look.not_read == [
        "KHR_materials_ior",
        "attribute 'TEXCOORD_1' of vertices",
        "attribute '_HEAT' of vertices",
        "colours of vertices",
        "light of materials",
        "transparency",
    ]


def test_gltf_integers_and_strides(tmp_path):
    """Positions as normalised bytes with a stride, as KHR_mesh_quantization allows."""

    def change(document):
        points = np.zeros((8, 4), np.uint8)
        points[:, :3] = np.array(CORNERS) * [127, 85, 63]
        content = points.tobytes()
        document["buffers"].append(
            {"byteLength": len(content), "uri": "data:;base64," + base64.b64encode(content).decode()}
        )
        document["bufferViews"].append({"buffer": 1, "byteLength": 32, "byteStride": 4})
        document["accessors"][0] = {
            "bufferView": 2,
            "componentType": 5121,
            "normalized": True,
            "count": 8,
            "type": "VEC3",
        }
        document["extensionsUsed"] = document["extensionsRequired"] = ["KHR_mesh_quantization"]

    _, extents = volume_of(gltf(tmp_path, change))
    assert extents == pytest.approx([254 / 255, 252 / 255, 255 / 255], abs=1e-6)


def test_gltf_brackets_are_one_sentence(tmp_path):
    (tmp_path / "a.gltf").write_text('{"asset": ' + "[" * 100_000)
    refused(tmp_path / "a.gltf", "cannot be read as gltf")


def test_images_have_a_limit(tmp_path):
    from PIL import Image

    Image.new("1", (20_000, 20_000)).save(tmp_path / "a.png")

    def change(document):
        document["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = {"index": 0}
        document["textures"], document["images"] = [{"source": 0}], [{"uri": "a.png"}]

    refused(gltf(tmp_path, change), "20000 x 20000 pixels|cannot be read as an image")


# URDF

URDF = """<robot name="box">
  <material name="red"><color rgba="1 0 0 1"/></material>
  <link name="base"><visual><geometry><mesh filename="base.obj"/></geometry></visual></link>
  <link name="lid">
    <visual name="v"><origin xyz="0 0 0"/><geometry><mesh filename="lid.obj" scale="1 1 1"/></geometry><material name="red"/></visual>
    <collision><geometry><mesh filename="lid.obj"/></geometry></collision>
  </link>
  <joint name="hinge" type="revolute"><parent link="base"/><child link="lid"/><origin xyz="0 0.15 0.2"/>
    <axis xyz="1 0 0"/><limit lower="0" upper="1.5" effort="1" velocity="1"/><dynamics damping="0"/></joint>
</robot>"""


@pytest.fixture
def chest(tmp_path):
    base = trimesh.creation.box((0.4, 0.3, 0.2))
    base.apply_translation((0, 0, 0.1))
    base.export(tmp_path / "base.obj")
    lid = trimesh.creation.box((0.4, 0.3, 0.02))
    lid.apply_translation((0, -0.15, 0.012))
    lid.export(tmp_path / "lid.obj")
    (tmp_path / "chest.urdf").write_text(URDF)
    return tmp_path / "chest.urdf"


def test_urdf_scales_mirrors_and_colours_a_mesh(chest):
    thing = calibrate(chest, Settings("chest"))
    assert thing.parts[1].surface.look.color == (1.0, 0.0, 0.0)
    right = thing.parts[1].com
    lid = trimesh.load(chest.parent / "lid.obj", process=False)
    for scale in ([1000.0] * 3, [1.0, -1.0, 1.0], [-2.0, 0.5, -4.0]):
        changed = lid.copy()
        changed.vertices = lid.vertices * scale
        changed.export(chest.parent / "lid.obj")
        text = " ".join(repr(1.0 / factor) for factor in scale)
        chest.write_text(
            URDF.replace('scale="1 1 1"', f'scale="{text}"').replace(
                '<collision><geometry><mesh filename="lid.obj"/></geometry></collision>', ""
            )
        )
        # Written with its faces outwards.
        if np.prod(scale) < 0.0:
            changed.invert()
            changed.export(chest.parent / "lid.obj")
        made = calibrate(chest, Settings("chest"))
        assert made.parts[1].com == pytest.approx(right, abs=1e-6)
        assert made.parts[1].mass == pytest.approx(thing.parts[1].mass, rel=1e-5)


def test_urdf_inertials_are_read(chest):
    inertial = '<inertial><origin xyz="0.01 -0.1 0.012"/><mass value="3"/><inertia ixx="0.03" iyy="0.05" izz="0.07" ixy="0.001" ixz="0" iyz="0"/></inertial>'
    chest.write_text(URDF.replace('<link name="lid">', '<link name="lid">' + inertial))
    lid = calibrate(chest, Settings("chest")).parts[1]
    assert (lid.mass, lid.com) == (pytest.approx(3.0), pytest.approx([0.01, 0.05, 0.212]))
    assert lid.inertia == pytest.approx(np.array([[0.03, 0.001, 0], [0.001, 0.05, 0], [0, 0, 0.07]]))
    # A mass for the whole spreads over the parts as theirs do.
    whole = calibrate(chest, Settings("chest"))
    doubled = calibrate(chest, Settings("chest", mass=2.0 * whole.mass)).parts[1]
    assert (doubled.mass, doubled.inertia) == (pytest.approx(6.0), pytest.approx(2.0 * lid.inertia))
    halved = calibrate(chest, Settings("chest", size=0.5 * float(np.ptp(whole.bounds, axis=0).max()))).parts[1]
    assert (halved.mass, halved.inertia) == (pytest.approx(3.0), pytest.approx(0.25 * lid.inertia))
    with pytest.raises(AssetError, match="has its mass and inertia in the source"):
        calibrate(chest, Settings("chest", density=500.0))
    for old, new, message in [
        ('value="3"', 'value="-3"', "is of no body"),
        ('izz="0.07"', 'izz="0.09"', "is of no body"),
        ('iyz="0"', "", "iyz"),
        ('xyz="0.01 -0.1 0.012"', 'xyz="1 0 0"', "lies outside of it"),
        ('xyz="0.01 -0.1 0.012"', 'xyz="0 0 0" rpy="1 0 0"', "its frame is turned"),
    ]:
        chest.write_text(URDF.replace('<link name="lid">', '<link name="lid">' + inertial.replace(old, new)))
        with pytest.raises(AssetError, match=message):
            calibrate(chest, Settings("chest"))


VISUAL = '<visual><geometry><mesh filename="base.obj"/></geometry></visual>'


@pytest.mark.parametrize(
    "old, new, message",
    [
        (VISUAL, VISUAL + VISUAL, "link 'base': it has 2 of 'visual'; only one is read"),
        (VISUAL, "", "link 'base': it has no visual mesh"),
        ('<mesh filename="base.obj"/>', '<box size="1 1 1"/>', "'box' in 'geometry' is not read; export it as a mesh"),
        ('filename="base.obj"', 'filename="package://x/base.obj"', "is a URL"),
        ('filename="base.obj"', 'filename="base.obj" unit="mm"', "attribute 'unit' of 'mesh' is not read"),
        ('scale="1 1 1"', 'scale="1 0 1"', "flattens it"),
        ('scale="1 1 1"', 'scale="2"', "scale '2' must be 3 finite numbers"),
        ('scale="1 1 1"', 'scale="nan 1 1"', "must be 3 finite numbers"),
        ('scale="1 1 1"', 'scale="2 1 1"', "its collision is another shape than its visual"),
        ("<collision>", '<collision><origin xyz="0 0 1"/>', "its collision is another shape"),
        ("<collision>", '<collision name="c"><origin xyz="0 0 0" rpy="0 0 1"/>', "its frame is turned"),
        ("<dynamics", '<mimic joint="other"/><dynamics', "'mimic' in 'joint' is not read"),
        ("<dynamics", '<safety_controller k_velocity="1"/><dynamics', "'safety_controller' in 'joint'"),
        ("<dynamics", '<calibration rising="1"/><dynamics', "'calibration' in 'joint'"),
        ('damping="0"', 'damping="0.5"', "its damping 0.5 is not read"),
        ('damping="0"', 'friction="0.5"', "its friction 0.5 is not read"),
        ('type="revolute"', 'type="floating"', "type 'floating' is not read"),
        ('type="revolute"', 'type="planar"', "type 'planar' is not read"),
        ('type="revolute"', 'type="continuous"', "a continuous joint has no lower and upper"),
        ('<limit lower="0" upper="1.5" effort="1" velocity="1"/>', "", "a revolute joint needs a limit"),
        ('effort="1"', 'effort="much"', "effort: a number cannot be read"),
        ('xyz="0 0.15 0.2"', 'xyz="0 0.15 0.2" quat_xyzw="0 0 0 1"', "attribute 'quat_xyzw' of 'origin'"),
        ('xyz="0 0.15 0.2"', 'xyz="0 inf 0.2"', "must be 3 finite numbers"),
        ('rgba="1 0 0 1"', 'rgba="1 0 0 0.5"', "an alpha of 1"),
        ('<color rgba="1 0 0 1"/>', '<texture filename="a.png"/>', "'texture' in 'material' is not read"),
        (
            '<material name="red"/>',
            '<material name="rot"/>',
            "link 'lid': its material 'rot' is not defined; give it a",
        ),
        ('<material name="red"/>', "<material/>", "link 'lid' material: it names no name"),
        ("</robot>", '<material name="red"><color rgba="1 0 0 1"/></material></robot>', "two of that name"),
        (
            '<material name="red"/>',
            '<material name="red"><color rgba="0 0 1 1"/></material>',
            "material 'red': there are two of that name",
        ),
        ("</robot>", "<transmission/></robot>", "'transmission' in 'robot' is not read"),
        ("</robot>", "<gazebo/></robot>", "'gazebo' in 'robot' is not read"),
        ('name="box">', 'name="box" version="2.0">', "version 2.0 is not read"),
        ('name="box">', 'name="box" xmlns:xacro="http://ros.org/wiki/xacro"><xacro:include/>', "expand the xacro"),
    ],
)
def test_urdf_that_is_not_read(chest, old, new, message):
    assert URDF.count(old) >= 1
    chest.write_text(URDF.replace(old, new, 1))
    with pytest.raises(AssetError, match=message):
        articulation.read(chest)


def test_urdf_meshes_have_one_axis_up(chest):
    trimesh.load(chest.parent / "lid.obj").export(chest.parent / "lid.glb")
    chest.write_text(URDF.replace("lid.obj", "lid.glb"))
    with pytest.raises(AssetError, match="have different axes up"):
        articulation.read(chest)


def test_brackets_of_toml_and_json_are_one_sentence(tmp_path, chest):
    (tmp_path / "a.toml").write_text("parts = " + "[" * 20_000)
    chest.with_suffix(".json").write_text("[" * 100_000)
    for path in (tmp_path / "a.toml", chest):
        with pytest.raises(AssetError) as caught:
            articulation.read(path)
        assert "\n" not in str(caught.value)


# USD, as `verify` reads it.


@pytest.fixture
def stage(tmp_path):
    build_from = tmp_path / "a.obj"
    build_from.write_text(obj_text())
    build(build_from, tmp_path / "out", Settings("thing", size=0.4, density=500.0))
    return Usd.Stage.Open(str(tmp_path / "out/thing.usda"))


def instancer(usd):
    UsdGeom.PointInstancer.Define(usd, "/thing/many")


def curves(usd):
    UsdGeom.BasisCurves.Define(usd, "/thing/hair")


def skeleton(usd):
    UsdSkel.Skeleton.Define(usd, "/thing/bones")


def spherical(usd):
    UsdPhysics.SphericalJoint.Define(usd, "/thing/ball")


def samples(usd):
    UsdGeom.Mesh(usd.GetPrimAtPath("/thing/thing/visual")).GetPointsAttr().Set([Gf.Vec3f(0)] * 8, 5.0)


def left_handed(usd):
    UsdGeom.Mesh(usd.GetPrimAtPath("/thing/thing/visual")).CreateOrientationAttr(UsdGeom.Tokens.leftHanded)


def holes(usd):
    UsdGeom.Mesh(usd.GetPrimAtPath("/thing/thing/visual")).CreateHoleIndicesAttr([1])


def invisible(usd):
    UsdGeom.Imageable(usd.GetPrimAtPath("/thing/thing/visual")).MakeInvisible()


def inactive(usd):
    usd.GetPrimAtPath("/thing/thing/visual").SetActive(False)


def camera(usd):
    UsdGeom.Camera.Define(usd, "/thing/eye")


def light(usd):
    UsdLux.SphereLight.Define(usd, "/thing/lamp")


def dome(usd):
    UsdLux.DomeLight.Define(usd, "/thing/sky")


def group(usd):
    UsdPhysics.CollisionGroup.Define(usd, "/thing/group")


def pairs(usd):
    api = UsdPhysics.FilteredPairsAPI.Apply(usd.GetPrimAtPath("/thing/thing"))
    api.CreateFilteredPairsRel().AddTarget("/thing/nothing")


def drive(usd):
    UsdPhysics.DriveAPI.Apply(usd.GetPrimAtPath("/thing/thing"), "angular")


def negative_drive(usd):
    joint = UsdPhysics.RevoluteJoint.Define(usd, "/thing/hinge").GetPrim()
    UsdPhysics.DriveAPI.Apply(joint, "angular").CreateDampingAttr(-1.0)


def limit(usd):
    UsdPhysics.LimitAPI.Apply(usd.GetPrimAtPath("/thing/thing"), "transX")


def variants(usd):
    chosen = usd.GetDefaultPrim().GetVariantSets().AddVariantSet("size")
    chosen.AddVariant("small")
    chosen.AddVariant("large")


def body_of(usd):
    return UsdPhysics.RigidBodyAPI(usd.GetPrimAtPath("/thing/thing"))


def hinge(usd):
    return UsdPhysics.Joint(UsdPhysics.RevoluteJoint.Define(usd, "/thing/hinge"))


def collider_off(usd):
    collider = next(prim for prim in usd.Traverse() if prim.HasAPI(UsdPhysics.CollisionAPI))
    UsdPhysics.CollisionAPI(collider).CreateCollisionEnabledAttr(False)


@pytest.mark.parametrize(
    "change, message",
    [
        (lambda usd: body_of(usd).CreateRigidBodyEnabledAttr(False), "its rigid body is switched off"),
        (lambda usd: body_of(usd).CreateKinematicEnabledAttr(True), "it is kinematic"),
        (lambda usd: body_of(usd).CreateStartsAsleepAttr(True), "it starts asleep"),
        (lambda usd: body_of(usd).CreateAngularVelocityAttr(Gf.Vec3f(0, 0, 1)), "it starts with a velocity"),
        (collider_off, "its collider is switched off"),
        (lambda usd: hinge(usd).CreateJointEnabledAttr(False), "/thing/hinge: it is switched off"),
        (lambda usd: hinge(usd).CreateExcludeFromArticulationAttr(True), "it is not part of the articulation"),
        (lambda usd: hinge(usd).CreateCollisionEnabledAttr(True), "its bodies touch each other"),
        (lambda usd: hinge(usd).CreateBreakTorqueAttr(1.0), "it breaks at a force"),
        (lambda usd: UsdGeom.Xformable(usd.GetPrimAtPath("/thing/thing/visual")).SetResetXformStack(True), "resetXformStack"),
    ],
)  # fmt: skip
def test_usd_physics_that_is_switched_off_is_refused(stage, change, message):
    """The assertions count bodies, colliders and joints that a simulator would leave out."""
    change(stage)
    stage.GetRootLayer().Save()
    with pytest.raises(AssetError, match=message):
        verify.verify(stage.GetRootLayer().realPath)


@pytest.mark.parametrize(
    "change, message",
    [
        (instancer, "a PointInstancer is not read"),
        (curves, "a BasisCurves is not read"),
        (skeleton, "a Skeleton is not read"),
        (spherical, "a PhysicsSphericalJoint is not read"),
        (left_handed, "its faces are leftHanded"),
        (holes, "it has holeIndices"),
        (invisible, "it is invisible"),
        (inactive, "/thing/thing/visual: it is inactive"),
        (camera, "a Camera is not read"),
        (light, "a SphereLight is not read"),
        (dome, "a DomeLight is not read"),
        (group, "a PhysicsCollisionGroup is not read"),
        (pairs, "a pair without contact names /thing/nothing, which does not exist"),
        (drive, "its drive 'angular' is not of its joint"),
        (negative_drive, "its drive 'angular' has a number that is negative"),
        (limit, "its limit of 'transX' is not read"),
        (samples, "it changes in time"),
        (variants, "variant set 'size' has 2 variants"),
    ],
)
def test_usd_that_is_not_looked_into_is_refused(stage, change, message):
    file = stage.GetRootLayer().realPath
    assert list(unread(stage)) == [] and verify.verify(file)
    change(stage)
    stage.GetRootLayer().Save()
    with pytest.raises(AssetError, match=message):
        verify.verify(file)


def test_meshes_inside_of_instances_are_checked(stage, tmp_path):
    """A damaged mesh that is reached through an instance alone is found."""
    whole = Usd.Stage.CreateNew(str(tmp_path / "out/whole.usda"))
    prim = whole.DefinePrim("/whole/copy")
    prim.GetReferences().AddReference("./thing.usda")
    prim.SetInstanceable(True)
    whole.GetRootLayer().Save()
    UsdGeom.Mesh(stage.GetPrimAtPath("/thing/thing/visual")).GetFaceVertexIndicesAttr().Set([0, 1, 999])
    stage.GetRootLayer().Save()
    rows = {row.name: row for row in verify.verify(tmp_path / "out/whole.usda")}
    assert any("/whole/copy/thing/visual" in finding for finding in rows["mesh_indices"].findings)


def test_other_shapes_count_in_the_size(stage):
    ball = UsdGeom.Sphere.Define(stage, "/thing/thing/ball")
    ball.CreateRadiusAttr(30.0)
    stage.GetRootLayer().Save()
    rows = {row.name: row for row in verify.verify(stage.GetRootLayer().realPath)}
    assert rows["size"].status == "fail" and "60 m" in rows["size"].findings[0]


# Files that never end.


def test_devices_pipes_and_folders_are_refused_unread(tmp_path):
    (tmp_path / "device.obj").symlink_to("/dev/zero")
    os.mkfifo(tmp_path / "pipe.stl")
    (tmp_path / "folder.ply").mkdir()
    for name in ("device.obj", "pipe.stl", "folder.ply"):
        refused(tmp_path / name, "regular file|cannot be read")
    (tmp_path / "parts.toml").symlink_to("/dev/zero")
    os.mkfifo(tmp_path / "parts.urdf")
    for name in ("parts.toml", "parts.urdf"):
        with pytest.raises(AssetError, match="it is not a regular file"):
            articulation.read(tmp_path / name)
    (tmp_path / "long").write_bytes(bytes(11))
    with pytest.raises(AssetError, match="more than 10 bytes"):
        files.read_bytes(tmp_path / "long", 10)
    assert Sdf is not None and urdf.TYPES
