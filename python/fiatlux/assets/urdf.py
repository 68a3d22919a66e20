"""Parts and joints from a URDF such as SimArt writes: one mesh for each link, in frames that are not turned."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ElementTree
from pathlib import Path
from typing import Any

import numpy as np

from . import mesh
from .error import AssetError
from .files import read_text
from .linkage import MAX_BYTES, Articulation, Inertial, Joint, PartSource, check_density, check_name, inside

Element = ElementTree.Element

#: Elements and attributes that are read, by element; an element in `MANY` may be repeated.
ELEMENTS: dict[str, tuple[set[str], set[str]]] = {
    "robot": ({"link", "joint", "material"}, {"name", "version"}),
    "link": ({"inertial", "visual", "collision"}, {"name"}),
    "inertial": ({"origin", "mass", "inertia"}, set()),
    "visual": ({"origin", "geometry", "material"}, {"name"}),
    "collision": ({"origin", "geometry"}, {"name"}),
    "geometry": ({"mesh"}, set()),
    "mesh": (set(), {"filename", "scale"}),
    "material": ({"color"}, {"name"}),
    "color": (set(), {"rgba"}),
    "origin": (set(), {"xyz", "rpy"}),
    "mass": (set(), {"value"}),
    "inertia": (set(), {"ixx", "ixy", "ixz", "iyy", "iyz", "izz"}),
    "joint": ({"origin", "parent", "child", "axis", "limit", "dynamics"}, {"name", "type"}),
    "parent": (set(), {"link"}),
    "child": (set(), {"link"}),
    "axis": (set(), {"xyz"}),
    # Effort and velocity are of a drive, and these joints have none.
    "limit": (set(), {"lower", "upper", "effort", "velocity"}),
    "dynamics": (set(), {"damping", "friction"}),
}
MANY = {("robot", "link"), ("robot", "joint"), ("robot", "material")}
TYPES = {"revolute": "revolute", "continuous": "revolute", "prismatic": "prismatic", "fixed": "fixed"}


def read(path: Path) -> Articulation:
    """Reads links and joints, and the densities of the JSON next to it.

    Raises:
        AssetError: Something is missing or wrong, or has an element or attribute that is not read.
    """
    try:
        root = ElementTree.fromstring(read_text(path, MAX_BYTES))
    except AssetError:
        raise
    except (ElementTree.ParseError, ValueError) as error:
        raise AssetError(f"{path}: {error}") from error
    if root.tag != "robot":
        raise AssetError(f"{path}: it is a '{root.tag}' and not a 'robot'")
    return Reader(path, root).read()


class Reader:
    def __init__(self, path: Path, root: Element) -> None:
        self.path, self.root = path, root
        self.captions = captions_of(path.with_suffix(".json"))
        self.colors: dict[str, tuple[float, float, float]] = {}
        #: From a link to the one above it, and to the origin of its joint.
        self.above: dict[str, tuple[str, np.ndarray]] = {}

    def error(self, what: str, problem: str) -> AssetError:
        return AssetError(f"{self.path}: {what}{': ' if what else ''}{problem}")

    def read(self) -> Articulation:
        self.known(self.root, "")
        version = self.root.get("version", "1.0")
        if version != "1.0":
            raise self.error("", f"version {version} is not read; only 1.0 is")
        self.define_materials()
        joints = [self.joint(element) for element in self.root.findall("joint")]
        for joint in joints:
            joint.anchor = self.origin_of(joint.child)
        parts = [self.part(element) for element in self.root.findall("link")]
        parts.sort(key=lambda part: part.name in self.above)
        ups = {mesh.FORMATS.get(part.mesh.suffix.lower()) for part in parts}
        if len(ups) > 1:
            files = ", ".join(part.mesh.name for part in parts)
            raise self.error("", f"its meshes ({files}) have different axes up; export all of them in one format")
        return Articulation(parts, joints)

    def define_materials(self) -> None:
        """Finds the colours by name; visuals name those of others too."""
        own = self.root.findall("material")
        for element in [*own, *self.root.findall("link/visual/material")]:
            name = element.get("name")
            color = self.color(element, f"material '{name}'")
            # Exporters give every part a material without a name.
            if not name or color is None:
                continue
            if name in self.colors and (element in own or self.colors[name] != color):
                raise self.error(f"material '{name}'", "there are two of that name; give each its own")
            self.colors[name] = color

    def known(self, element: Element, what: str) -> None:
        """Refuses elements and attributes that are not read, at any depth."""
        children, attributes = ELEMENTS[element.tag]
        for name in element.attrib:
            if name not in attributes:
                raise self.error(what, f"attribute '{name}' of '{element.tag}' is not read; remove it")
        counts: dict[str, int] = {}
        for child in element:
            tag = str(child.tag)
            if tag not in children:
                short = tag.rpartition("}")[2]
                hint = "expand the xacro" if "xacro" in tag else self.remedy(short)
                raise self.error(what, f"'{short}' in '{element.tag}' is not read; {hint}")
            counts[tag] = counts.get(tag, 0) + 1
            if counts[tag] > 1 and (element.tag, tag) not in MANY:
                raise self.error(
                    what, f"it has {len(element.findall(tag))} of '{tag}'; only one is read: make one of them"
                )
            inner = f"{tag} '{child.get('name')}'" if element.tag == "robot" else what
            self.known(child, inner)

    @staticmethod
    def remedy(name: str) -> str:
        if name in ("box", "cylinder", "sphere", "capsule"):
            return "export it as a mesh"
        if name == "mimic":
            return "joints move on their own; remove it"
        return "remove it"

    def numbers(self, element: Element | None, name: str, usual: str, what: str, count: int = 3) -> np.ndarray:
        text = usual if element is None else element.get(name, usual)
        try:
            values = np.array([float(value) for value in text.split()])
        except ValueError as error:
            raise self.error(what, f"{name}: a number cannot be read: {error}") from error
        if values.shape != (count,) or not np.isfinite(values).all():
            raise self.error(what, f"{name} '{text}' must be {count} finite numbers")
        return values

    def number(self, element: Element | None, name: str, usual: str, what: str) -> float:
        return float(self.numbers(element, name, usual, what, 1)[0])

    def origin(self, element: Element, what: str) -> np.ndarray:
        origin = element.find("origin")
        if np.abs(self.numbers(origin, "rpy", "0 0 0", what)).max() > 1e-9:
            raise self.error(what, "its frame is turned; write the parts in one frame, with rpy 0 0 0")
        return self.numbers(origin, "xyz", "0 0 0", what)

    def joint(self, element: Element) -> Joint:
        name = check_name(element.get("name"), f"{self.path}: joint")
        what, kind = f"joint '{name}'", str(element.get("type"))
        if kind not in TYPES:
            raise self.error(what, f"type '{kind}' is not read; use {', '.join(TYPES)}")
        parent, child = (self.attribute(element.find(side), "link", f"{what} {side}") for side in ("parent", "child"))
        offset, axis, limit = self.origin(element, what), element.find("axis"), element.find("limit")
        lower, upper = -np.inf, np.inf
        if limit is not None:
            for side in ("effort", "velocity"):
                self.number(limit, side, "0", what)
            if kind == "continuous" and {"lower", "upper"} & set(limit.attrib):
                raise self.error(what, "a continuous joint has no lower and upper; make it revolute")
            if kind != "continuous":
                lower, upper = (self.number(limit, side, "0", what) for side in ("lower", "upper"))
        elif kind in ("revolute", "prismatic"):
            raise self.error(what, f"a {kind} joint needs a limit; give one, or make it continuous")
        for side in ("damping", "friction"):
            value = self.number(element.find("dynamics"), side, "0", what)
            if value != 0.0:
                raise self.error(what, f"its {side} {value:g} is not read; joints turn freely: remove it")
        if child in self.above:
            raise self.error(what, f"link '{child}' is the child of two joints")
        self.above[child] = (parent, offset)
        direction = self.numbers(axis, "xyz", "1 0 0", what)
        return Joint(name, TYPES[kind], parent, child, offset, direction, lower, upper)

    def origin_of(self, link: str) -> np.ndarray:
        """Of a link's frame in that of the root."""
        at, total = link, np.zeros(3)
        for _ in range(len(self.above) + 1):
            if at not in self.above:
                return total
            at, offset = self.above[at]
            total = total + offset
        raise self.error("", f"the joints around link '{link}' form a loop")

    def part(self, element: Element) -> PartSource:
        name = check_name(element.get("name"), f"{self.path}: link")
        what = f"link '{name}'"
        visual, collision = element.find("visual"), element.find("collision")
        if visual is None:
            raise self.error(what, "it has no visual mesh")
        file, scale, offset = self.shape(visual, what)
        if collision is not None:
            other, other_scale, other_offset = self.shape(collision, what)
            if file != other or not np.allclose([scale, offset], [other_scale, other_offset], atol=1e-9):
                raise self.error(
                    what, "its collision is another shape than its visual; pieces are made from the visual: remove it"
                )
        caption = self.captions.get(name.removeprefix("l_"), {})
        density = caption.get("density") if isinstance(caption, dict) else None
        # Small numbers are g/cm^3.
        if isinstance(density, int | float) and 0.05 <= density <= 25.0:
            density = 1000.0 * density
        density = check_density(density, f"{self.path.with_suffix('.json')}: {name}")
        material = visual.find("material")
        color = None if material is None else self.color(material, what)
        if material is not None and color is None:
            named = self.attribute(material, "name", f"{what} material")
            if named not in self.colors:
                raise self.error(what, f"its material '{named}' is not defined; give it a color")
            color = self.colors[named]
        at = self.origin_of(name)
        inertial = self.inertial(element.find("inertial"), at, what)
        if inertial is not None and density is not None:
            raise self.error(what, "its inertial and the density in the JSON exclude each other; give one of them")
        return PartSource(name, file, density, at + offset, scale, color, inertial)

    def shape(self, element: Element, what: str) -> tuple[Path, np.ndarray, np.ndarray]:
        """The mesh of a visual or collision, its scale, and its origin in the link's frame."""
        shape = element.find("geometry/mesh")
        if shape is None:
            raise self.error(what, f"its {element.tag} has no mesh")
        name = self.attribute(shape, "filename", what)
        if "://" in name:
            raise self.error(what, f"'{name}' is a URL; name a file in the folder of the URDF")
        scale = self.numbers(shape, "scale", "1 1 1", what)
        if (scale == 0.0).any():
            raise self.error(what, f"scale '{shape.get('scale')}' flattens it")
        return inside(self.path.parent, name, f"{self.path}: {what}"), scale, self.origin(element, what)

    def color(self, element: Element, what: str) -> tuple[float, float, float] | None:
        color = element.find("color")
        if color is None:
            return None
        red, green, blue, alpha = self.numbers(color, "rgba", "", what, 4).tolist()
        if not all(0.0 <= value <= 1.0 for value in (red, green, blue)) or alpha != 1.0:
            raise self.error(what, f"colour '{color.get('rgba')}': numbers from 0 to 1 and an alpha of 1 are read")
        return red, green, blue

    def inertial(self, element: Element | None, at: np.ndarray, what: str) -> Inertial | None:
        if element is None:
            return None
        mass = self.number(element.find("mass"), "value", "", what)
        tensor = element.find("inertia")
        xx, yy, zz, xy, xz, yz = (
            self.number(tensor, f"i{of}", "", what) for of in ("xx", "yy", "zz", "xy", "xz", "yz")
        )
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        moments = np.linalg.eigvalsh(inertia)
        if not mass > 0.0 or not moments[0] > 0.0 or moments[2] > moments[:2].sum() * (1.0 + 1e-6):
            raise self.error(what, f"its inertial (mass {mass:g} kg, moments {moments}) is of no body")
        return Inertial(mass, at + self.origin(element, what), inertia)

    def attribute(self, element: Element | None, name: str, what: str) -> str:
        value = None if element is None else element.get(name)
        if value is None:
            raise self.error(what, f"it names no {name}")
        return value


def captions_of(beside: Path) -> dict[str, Any]:
    """The parts in SimArt's JSON: their densities are read, the rest is text for people."""
    if not beside.exists():
        return {}
    try:
        captions = json.loads(read_text(beside, MAX_BYTES))["output"]["parts_captions"]
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise AssetError(f"{beside}: it has no output.parts_captions: {error!r}") from error
    if not isinstance(captions, dict):
        raise AssetError(f"{beside}: output.parts_captions must be a table")
    return captions
