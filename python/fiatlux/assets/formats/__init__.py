"""Readers of mesh files: each reads what docs/assets.md lists, and refuses or names the rest."""

from __future__ import annotations

from . import gltf, obj, ply, stl
from .parsed import Chunk, Parsed

__all__ = ["HEADS", "READERS", "Chunk", "Parsed"]

#: By the end of a file's name.
READERS = {".glb": gltf.read, ".gltf": gltf.read, ".obj": obj.read, ".ply": ply.read, ".stl": stl.read}
#: Refusals by the first bytes of a file, before it is read.
HEADS = {".ply": ply.check_head, ".stl": stl.check_head}
