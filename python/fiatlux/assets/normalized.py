"""Meshes centred at the origin, with a largest extent of 1, y up: what articulators read."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from .mesh import Surface, trimesh


def export(surface: Surface, file: Path) -> None:
    low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    vertices = (surface.vertices - (low + high) / 2.0) / (high - low).max()
    vertices = vertices[:, [0, 2, 1]] * np.array([1.0, 1.0, -1.0])
    visual = None
    if surface.uv is not None and "color" in surface.look.images:
        material = trimesh.visual.material.PBRMaterial(baseColorTexture=surface.look.images["color"])
        visual = trimesh.visual.TextureVisuals(uv=surface.uv, material=material)
    trimesh.Trimesh(vertices, surface.faces, visual=visual, process=False).export(file)
