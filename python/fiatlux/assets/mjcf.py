"""Objects as MJCF, with their meshes as OBJ files."""

from __future__ import annotations

import xml.etree.ElementTree as ElementTree
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from .object import Object, Part
from .usd import texture_file


def write(thing: Object, file: Path) -> None:
    """Writes a model with one body for each part, its inertia authored, and its meshes into `meshes` next to the file."""
    folder = file.parent
    (folder / "meshes").mkdir(exist_ok=True)
    root = ElementTree.Element("mujoco", model=thing.name)
    ElementTree.SubElement(root, "compiler", angle="radian", autolimits="true", meshdir="meshes", texturedir=".")
    asset = ElementTree.SubElement(root, "asset")
    world = ElementTree.SubElement(root, "worldbody")
    bodies: dict[str, ElementTree.Element] = {}
    for part in thing.parts:
        joint = thing.joint_above(part)
        parent = next((other for other in thing.parts if joint and other.name == joint.parent), None)
        above = world if parent is None else bodies[parent.name]
        offset = part.origin if parent is None else part.origin - parent.origin
        body = ElementTree.SubElement(above, "body", name=part.name, pos=numbers(offset))
        bodies[part.name] = body
        if joint is None and not thing.fixed:
            ElementTree.SubElement(body, "freejoint", name=thing.name)
        elif joint is not None and joint.kind != "fixed":
            kind = {"revolute": "hinge", "prismatic": "slide"}[joint.kind]
            element = ElementTree.SubElement(body, "joint", name=joint.name, type=kind, axis=numbers(joint.axis))
            if np.isfinite([joint.lower, joint.upper]).any():
                bounds = np.nan_to_num([joint.lower, joint.upper], posinf=1e6, neginf=-1e6)
                element.set("range", numbers(bounds))
        i = part.inertia
        moments = [i[0, 0], i[1, 1], i[2, 2], i[0, 1], i[0, 2], i[1, 2]]
        ElementTree.SubElement(
            body,
            "inertial",
            pos=numbers(part.com - part.origin),
            mass=repr(float(part.mass)),
            fullinertia=numbers(moments),
        )
        geoms(part, asset, body, folder, thing.friction[1])
    ElementTree.indent(root)
    ElementTree.ElementTree(root).write(file, encoding="unicode")


def geoms(part: Part, asset: ElementTree.Element, body: ElementTree.Element, folder: Path, friction: float) -> None:
    name = f"{part.name}_visual"
    write_obj(
        folder / "meshes" / f"{name}.obj", part.surface.vertices - part.origin, part.surface.faces, part.surface.uv
    )
    # The shell counts as filled: thin surfaces are refused otherwise.
    ElementTree.SubElement(asset, "mesh", name=name, file=f"{name}.obj", inertia="legacy")
    look = part.surface.look
    material = ElementTree.SubElement(asset, "material", name=f"{part.name}_look", rgba=numbers([*look.color, 1.0]))
    if part.surface.uv is not None and "color" in look.images:
        image = texture_file(folder, part, "color")
        ElementTree.SubElement(asset, "texture", name=f"{part.name}_color", type="2d", file=image)
        material.set("texture", f"{part.name}_color")
    geom = ElementTree.SubElement(body, "geom", name=name, type="mesh", mesh=name, material=f"{part.name}_look")
    geom.attrib.update({"contype": "0", "conaffinity": "0", "group": "2", "mass": "0"})
    for index, corners in enumerate(part.pieces):
        name = f"{part.name}_piece_{index}"
        ElementTree.SubElement(asset, "mesh", name=name, vertex=numbers((corners - part.origin).reshape(-1)))
        ElementTree.SubElement(
            body, "geom", name=name, type="mesh", mesh=name, group="3", friction=repr(float(friction)), condim="3"
        )


def write_obj(file: Path, vertices: np.ndarray, faces: np.ndarray, uv: np.ndarray | None) -> None:
    with file.open("w") as out:
        out.writelines(f"v {numbers(vertex)}\n" for vertex in vertices)
        if uv is not None:
            out.writelines(f"vt {numbers(place)}\n" for place in uv)
        for face in faces + 1:
            out.write(
                "f " + " ".join(f"{corner}/{corner}" if uv is not None else f"{corner}" for corner in face) + "\n"
            )


def numbers(values: Sequence[float] | np.ndarray) -> str:
    return " ".join(f"{float(value):.9g}" for value in values)
