"""Six objects whose meshes are made here: the sources of the feasibility table and of the tests."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .error import needs
from .object import Settings

try:
    import trimesh
    from PIL import Image
except ImportError as error:
    raise needs(error) from error

#: Outline of the bulb, height and radius, m: that of the room's stock bulb, from its cap's bottom on.
BULB = (
    (0.0, 0.00759),
    (0.00957, 0.02026),
    (0.0381, 0.02196),
    (0.0485, 0.0244),
    (0.0746, 0.02558),
    (0.0874, 0.03025),
    (0.1006, 0.03652),
    (0.116, 0.03956),
    (0.1212, 0.03922),
    (0.1314, 0.03653),
    (0.1456, 0.0264),
    (0.1564, 0.0),
)


def write_sources(folder: Path) -> list[tuple[Path, Settings]]:
    """Writes the meshes, in units and axes of their own, and returns each source with its settings."""
    folder.mkdir(parents=True, exist_ok=True)
    bulb = lathe(np.array(BULB), 48)
    bulb.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2.0, [1.0, 0.0, 0.0]))
    bulb.export(folder / "bulb.glb")
    export_stl(socket(), folder / "socket.stl", 1000.0)
    textured(crate()).export(folder / "crate.glb")
    ladder().export(folder / "ladder.obj")
    bench().export(folder / "bench.ply")
    box, lid = chest()
    box.export(folder / "chest_box.obj")
    lid.export(folder / "chest_lid.obj")
    (folder / "chest.toml").write_text(
        """# A box and its lid, which turns by 110 degrees about the upper back edge.
parts = [{ name = "box", mesh = "chest_box.obj", density = 600.0 }, { name = "lid", mesh = "chest_lid.obj", density = 600.0 }]

[[joints]]
name = "hinge"
kind = "revolute"
parent = "box"
child = "lid"
anchor = [0.0, 0.15, 0.202]
axis = [-1.0, 0.0, 0.0]
lower = 0.0
upper = 1.92
"""
    )
    return [
        (folder / "bulb.glb", Settings("bulb", "bulb", size=0.1564, mass=0.035)),
        (folder / "socket.stl", Settings("socket", "fixture", units="mm", mass=0.4, fixed=True)),
        (folder / "crate.glb", Settings("crate", "crate", size=0.6, mass=1.5)),
        (folder / "ladder.obj", Settings("ladder", "ladder", size=1.18, mass=10.9)),
        (folder / "bench.ply", Settings("bench", "bench", size=2.4, density=450.0)),
        (folder / "chest.toml", Settings("chest", size=0.4, friction=(0.8, 0.7))),
    ]


def lathe(outline: np.ndarray, sections: int) -> trimesh.Trimesh:
    """A closed body of revolution about z; the first point's disc closes it below, the last point is its tip."""
    angles = np.linspace(0.0, 2.0 * np.pi, sections, endpoint=False)
    rings = [
        np.column_stack([radius * np.cos(angles), radius * np.sin(angles), np.full(sections, height)])
        for height, radius in outline[:-1]
    ]
    vertices = np.vstack([*rings, [[0.0, 0.0, outline[0, 0]], [0.0, 0.0, outline[-1, 0]]]])
    bottom, tip = len(vertices) - 2, len(vertices) - 1
    at, last = np.arange(sections), (len(rings) - 1) * sections
    after = (at + 1) % sections
    faces = [
        np.column_stack([np.full(sections, bottom), after, at]),
        np.column_stack([last + at, last + after, np.full(sections, tip)]),
    ]
    for ring in range(len(rings) - 1):
        low, high = ring * sections, (ring + 1) * sections
        faces.append(np.column_stack([low + at, low + after, high + after]))
        faces.append(np.column_stack([low + at, high + after, high + at]))
    return trimesh.Trimesh(vertices, np.vstack(faces), process=False)


def box(low: tuple[float, float, float], high: tuple[float, float, float]) -> trimesh.Trimesh:
    return trimesh.creation.box(bounds=[low, high])


def bar(start: tuple[float, float, float], end: tuple[float, float, float], radius: float) -> trimesh.Trimesh:
    return trimesh.creation.cylinder(radius=radius, segment=[start, end], sections=16)


def join(parts: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    return trimesh.util.concatenate(parts)


def socket() -> trimesh.Trimesh:
    """A round housing, and a collar of four blocks around its bore, which opens upwards."""
    outer, bore = 0.034, 0.0202
    return join(
        [
            lathe(np.array([[0.0, 0.06], [0.03, 0.07], [0.037, 0.06], [0.0371, 0.0]]), 32),
            box((-outer, -outer, 0.0371), (-bore, outer, 0.07)),
            box((bore, -outer, 0.0371), (outer, outer, 0.07)),
            box((-bore, -outer, 0.0371), (bore, -bore, 0.07)),
            box((-bore, bore, 0.0371), (bore, outer, 0.07)),
        ]
    )


def crate() -> trimesh.Trimesh:
    """One surface: an open box with walls of 15 mm and a floor of 12 mm, 0.6 x 0.4 x 0.17 m."""
    outer, inner = np.array([0.3, 0.2]), np.array([0.285, 0.185])
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    rings = [(outer, 0.0), (outer, 0.17), (inner, 0.17), (inner, 0.012)]
    vertices = np.vstack([np.column_stack([corners * half, np.full(4, height)]) for half, height in rings])
    faces = [[0, 2, 1], [0, 3, 2], [12, 13, 14], [12, 14, 15]]
    for ring in range(3):
        for k in range(4):
            a, b = 4 * ring + k, 4 * ring + (k + 1) % 4
            faces += [[a, b, b + 4], [a, b + 4, a + 4]]
    return trimesh.Trimesh(vertices, faces, process=False)


def textured(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """With a seam at every edge, a chequered colour, and roughness; y up, as glTF asks for."""
    vertices = mesh.vertices[mesh.faces].reshape(-1, 3)
    uv = np.tile([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]], (len(mesh.faces), 1))
    squares = np.indices((64, 64)).sum(axis=0) // 8 % 2
    color = Image.fromarray((120 + 60 * squares[..., None] * np.array([1.0, 0.8, 0.5])).astype(np.uint8))
    rough = np.zeros((64, 64, 3), np.uint8)
    rough[..., 1] = 180
    material = trimesh.visual.material.PBRMaterial(
        baseColorTexture=color, metallicRoughnessTexture=Image.fromarray(rough), metallicFactor=1.0, roughnessFactor=1.0
    )
    visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    made = trimesh.Trimesh(vertices, np.arange(len(vertices)).reshape(-1, 3), visual=visual, process=False)
    made.apply_transform(trimesh.transformations.rotation_matrix(-np.pi / 2.0, [1.0, 0.0, 0.0]))
    return made


def ladder() -> trimesh.Trimesh:
    """Two rails, two legs, four treads and a platform, 1.2 m high: bars and boxes that touch."""
    parts = []
    for x in (-0.27, 0.27):
        parts.append(bar((x, -0.45, 0.016), (x, -0.11, 1.15), 0.016))
        parts.append(bar((x, 0.45, 0.016), (x, 0.26, 1.15), 0.016))
    for top in (0.235, 0.47, 0.71, 0.94):
        y = -0.45 + 0.34 * (top - 0.03) / 1.134
        parts.append(box((-0.25, y - 0.045, top - 0.025), (0.25, y + 0.045, top)))
    parts.append(box((-0.29, -0.13, 1.151), (0.29, 0.28, 1.18)))
    return join(parts)


def bench() -> trimesh.Trimesh:
    """A top on four legs with two beams, 2.4 x 0.76 x 0.99 m."""
    parts = [box((-1.2, -0.38, 0.95), (1.2, 0.38, 0.99))]
    for x in (-1.14, 1.08):
        for y in (-0.34, 0.28):
            parts.append(box((x, y, 0.0), (x + 0.06, y + 0.06, 0.95)))
        parts.append(box((x, -0.28, 0.25), (x + 0.06, 0.28, 0.31)))
    return join(parts)


def chest() -> tuple[trimesh.Trimesh, trimesh.Trimesh]:
    """An open box of five boards, and its lid 2 mm above it."""
    walls = [
        box((-0.2, -0.15, 0.0), (0.2, 0.15, 0.012)),
        box((-0.2, -0.15, 0.012), (-0.188, 0.15, 0.2)),
        box((0.188, -0.15, 0.012), (0.2, 0.15, 0.2)),
        box((-0.188, -0.15, 0.012), (0.188, -0.138, 0.2)),
        box((-0.188, 0.138, 0.012), (0.188, 0.15, 0.2)),
    ]
    return join(walls), box((-0.2, -0.15, 0.202), (0.2, 0.15, 0.216))


def export_stl(mesh: trimesh.Trimesh, file: Path, factor: float) -> None:
    scaled = mesh.copy()
    scaled.apply_scale(factor)
    scaled.export(file)
