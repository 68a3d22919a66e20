"""Meshes from files: read, checked, and brought into our axes."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from .error import AssetError, needs
from .files import read_bytes
from .formats import HEADS, READERS, Parsed
from .formats.parsed import MAX_FILE_BYTES, Material

try:
    import trimesh
except ImportError as error:
    raise needs(error) from error

#: Formats that are read, and the axis that points up in them where the caller does not say.
FORMATS = {".glb": "y", ".gltf": "y", ".obj": "z", ".ply": "z", ".stl": "z"}
#: Metres in a unit of a file.
UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}
#: Largest extents of an object in the room, m.
SIZES = (0.01, 10.0)


@dataclass
class Look:
    """Metallic-roughness look: factors, and images (PIL) by channel."""

    color: tuple[float, float, float] = (0.72, 0.72, 0.72)
    metallic: float = 0.0
    roughness: float = 0.6
    #: ``color``, ``metallic_roughness`` (roughness in green, metallic in blue) and ``normal``.
    images: dict[str, Any] = field(default_factory=dict)
    #: Parts of the file's look that were left out, by name.
    not_read: list[str] = field(default_factory=list)


@dataclass
class Surface:
    """A closed surface of triangles, z up.

    ``vertices`` is (n, 3) in m, ``faces`` (m, 3), counter-clockwise seen from outside; ``uv`` is (n, 2) with v upwards, or None.
    """

    vertices: np.ndarray
    faces: np.ndarray
    uv: np.ndarray | None
    look: Look

    @property
    def extents(self) -> np.ndarray:
        return np.ptp(self.vertices, axis=0)

    def solid(self) -> trimesh.Trimesh:
        """Its geometry alone, with the seams of the texture joined."""
        mesh = trimesh.Trimesh(self.vertices, self.faces, process=False)
        mesh.merge_vertices(merge_tex=True, merge_norm=True, digits_vertex=9)
        return mesh

    def moved(self, factor: float | np.ndarray, shift: np.ndarray) -> Surface:
        """Scaled, by one factor or one for each axis, then shifted. A factor below 0 mirrors it, and turns its faces again."""
        faces = self.faces[:, ::-1] if np.prod(np.broadcast_to(factor, 3)) < 0.0 else self.faces
        return Surface(self.vertices * factor + shift, faces, self.uv, self.look)


def sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def parse(path: Path) -> Parsed:
    """The triangles of a mesh file, in its own axes and units.

    Raises:
        AssetError: It is of another format, too large, wrong, or has something that is not read.
    """
    suffix = path.suffix.lower()
    if suffix not in FORMATS:
        raise AssetError(f"{path}: '{suffix}' is not a known format; use {', '.join(FORMATS)}")
    check_head = HEADS.get(suffix)
    content = read_bytes(path, MAX_FILE_BYTES, None if check_head is None else partial(check_head, path))
    return READERS[suffix](path, content)


def read(path: Path, up: str | None = None, repair: bool = False) -> Surface:
    """Reads a mesh in the units of its file.

    Args:
        path: GLB, glTF, OBJ, PLY or STL.
        up: ``y`` or ``z``; by default y for glTF and z for the others.
        repair: Close small holes and turn faces outwards instead of refusing the mesh.

    Raises:
        AssetError: The file is not a closed surface of at most 1,000,000 triangles.
    """
    parsed = parse(path)
    mesh = joined(parsed, str(path))
    surface = Surface(
        np.asarray(mesh.vertices, float), np.asarray(mesh.faces, int), texture_coordinates(mesh), look(mesh)
    )
    surface.look.not_read = sorted(parsed.not_read)
    if (up or FORMATS[path.suffix.lower()]) == "y":
        surface.vertices = surface.vertices[:, [0, 2, 1]] * [1.0, -1.0, 1.0]
    return checked(surface, str(path), repair)


def checked(surface: Surface, name: str, repair: bool = False) -> Surface:
    """A surface without unused vertices and degenerate faces; refuses what encloses no volume."""
    if not np.isfinite(surface.vertices).all():
        at = int(np.flatnonzero(~np.isfinite(surface.vertices).all(axis=1))[0])
        raise AssetError(f"{name}: vertex {at} is NaN or infinite; export the mesh again")
    if surface.faces.min() < 0 or surface.faces.max() >= len(surface.vertices):
        raise AssetError(f"{name}: a face names vertex {surface.faces.max()} of {len(surface.vertices)}")
    if not surface.extents.max() > 0.0:
        raise AssetError(f"{name}: all of its vertices are at one point")
    corners = surface.vertices[surface.faces] / surface.extents.max()
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    surface.faces = surface.faces[areas > 1e-14]
    if len(surface.faces) < 4:
        raise AssetError(f"{name}: {len(surface.faces)} faces have an area; a closed surface has at least 4")
    solid = surface.solid()
    open_edges, turned_edges = boundary(solid.faces)
    if repair and (open_edges or turned_edges or not solid.volume > 0.0):
        trimesh.repair.fill_holes(solid)
        trimesh.repair.fix_normals(solid, multibody=True)
        # New faces have no place in the texture.
        surface = Surface(np.asarray(solid.vertices), np.asarray(solid.faces), None, surface.look)
        surface.look.images.clear()
        open_edges, turned_edges = boundary(solid.faces)
    if open_edges:
        raise AssetError(
            f"{name}: the surface is open at {open_edges} edges; close it, or use --repair, which fills small holes"
        )
    if turned_edges:
        raise AssetError(
            f"{name}: some of its faces are inverted ({turned_edges} edges have two faces of one sense); turn their normals"
            " outwards, or use --repair"
        )
    if not solid.volume > 0.0:
        raise AssetError(f"{name}: its faces point inwards (volume {solid.volume:.3g}); invert them, or use --repair")
    used, inverse = np.unique(surface.faces, return_inverse=True)
    uv = None if surface.uv is None else surface.uv[used]
    return Surface(surface.vertices[used], inverse.reshape(-1, 3), uv, surface.look)


def boundary(faces: np.ndarray) -> tuple[int, int]:
    """Edges with an odd number of faces, and other ones whose faces do not run along them in both senses alike.

    Without either the surface encloses a volume. Shells may touch along an edge.
    """
    directed = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    edges, at = np.unique(np.sort(directed, axis=1), axis=0, return_inverse=True)
    count = np.bincount(at.reshape(-1), minlength=len(edges))
    sense = np.bincount(at.reshape(-1), np.sign(directed[:, 1] - directed[:, 0]), minlength=len(edges))
    is_open = count % 2 == 1
    return int(is_open.sum()), int((~is_open & (sense != 0)).sum())


def in_meters(surface: Surface, name: str, units: str, size: float | None) -> Surface:
    """Scales to metres by the unit of the file, or to a largest extent in m."""
    if units not in UNITS:
        raise AssetError(f"units: '{units}' is not known; use {', '.join(UNITS)}")
    largest = float(surface.extents.max())
    if size is not None and not (np.isfinite(size) and SIZES[0] <= size <= SIZES[1]):
        raise AssetError(f"size: {size} m; the largest extent must be {SIZES[0]} to {SIZES[1]} m")
    factor = UNITS[units] if size is None else size / largest
    if not SIZES[0] <= largest * factor <= SIZES[1]:
        guess = next((unit for unit, metres in UNITS.items() if SIZES[0] <= largest * metres <= SIZES[1]), None)
        remedy = f"is it in {guess}? use --units {guess} or --size" if guess else "use --size"
        raise AssetError(
            f"{name}: its largest extent is {largest * factor:.6g} m, outside {SIZES[0]} to {SIZES[1]}; {remedy}"
        )
    return surface.moved(factor, np.zeros(3))


def texture_coordinates(mesh: trimesh.Trimesh) -> np.ndarray | None:
    uv = getattr(mesh.visual, "uv", None)
    if uv is None or len(uv) != len(mesh.vertices) or not np.isfinite(uv).all():
        return None
    return np.asarray(uv, float)


def look(mesh: trimesh.Trimesh) -> Look:
    """The look of trimesh's material; the usual one where there is none."""
    material = getattr(mesh.visual, "material", None)
    if material is None:
        return Look()
    if not isinstance(material, trimesh.visual.material.PBRMaterial):
        image = getattr(material, "image", None)
        # Every material without a texture has a grey one.
        if image is None or image.size[0] * image.size[1] < 4:
            return Look(color=rgb(getattr(material, "diffuse", [184, 184, 184])))
        return Look(color=(1.0, 1.0, 1.0), images={"color": image})
    named = {
        "color": material.baseColorTexture,
        "metallic_roughness": material.metallicRoughnessTexture,
        "normal": material.normalTexture,
    }
    images = {channel: image for channel, image in named.items() if image is not None}
    factor = material.baseColorFactor
    if factor is not None:
        color = rgb(factor)
    else:
        color = (1.0, 1.0, 1.0) if "color" in images else Look().color
    metallic = 0.0 if material.metallicFactor is None else float(material.metallicFactor)
    roughness = 0.6 if material.roughnessFactor is None else float(material.roughnessFactor)
    return Look(color, metallic, roughness, images)


def rgb(values: Any) -> tuple[float, float, float]:
    """A colour of bytes, or of numbers from 0 to 1."""
    numbers = np.asarray(values)[:3]
    red, green, blue = (
        (numbers / 255.0 if numbers.dtype == np.uint8 or numbers.max() > 1 else numbers).astype(float).tolist()
    )
    return red, green, blue


def joined(parsed: Parsed, name: str) -> Any:
    """One mesh of all chunks. Different materials are packed into one image."""
    meshes = []
    is_textured = any(chunk.uv is not None for chunk in parsed.chunks)
    for chunk in parsed.chunks:
        if not len(chunk.faces):
            continue
        visual = None
        uv = np.zeros((len(chunk.vertices), 2)) if chunk.uv is None and is_textured else chunk.uv
        if chunk.material is not None or uv is not None:
            visual = trimesh.visual.TextureVisuals(uv=uv, material=material_of(chunk.material))
        meshes.append(trimesh.Trimesh(chunk.vertices, chunk.faces, visual=visual, process=False))
    if not meshes:
        raise AssetError(f"{name}: it has no triangles")
    if len(meshes) > 1 and not is_textured and len({repr(chunk.material) for chunk in parsed.chunks}) > 1:
        # Packed images need coordinates.
        for mesh in meshes:
            material = getattr(mesh.visual, "material", material_of(None))
            mesh.visual = trimesh.visual.TextureVisuals(uv=np.zeros((len(mesh.vertices), 2)), material=material)
    return meshes[0] if len(meshes) == 1 else trimesh.util.concatenate(meshes)


def material_of(material: Material | None) -> Any:
    material = material or Material(Look().color, Look().metallic, Look().roughness)
    return trimesh.visual.material.PBRMaterial(
        baseColorFactor=None if material.color is None else [*material.color, 1.0],
        metallicFactor=material.metallic,
        roughnessFactor=material.roughness,
        baseColorTexture=material.images.get("color"),
        metallicRoughnessTexture=material.images.get("metallic_roughness"),
        normalTexture=material.images.get("normal"),
    )
