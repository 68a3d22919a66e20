"""Writes an object's folder: USD, MJCF, our own data, and a manifest."""

from __future__ import annotations

import hashlib
import json
import shutil
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

from . import mjcf, room, usd
from .error import AssetError
from .object import Object, Settings, calibrate

MANIFEST = "manifest.json"
OBJECT = "object.toml"


def build(source: str | Path, out: str | Path, settings: Settings, force: bool = False) -> dict[str, Any]:
    """Builds the folder of an object from a mesh, or from the TOML or URDF of its parts.

    The folder has `NAME.usda`, `NAME.xml` with `meshes/`, `textures/`, `object.toml` and `manifest.json`. It appears whole or not
    at all.

    Args:
        source: Mesh file, or a TOML or URDF of parts and joints.
        out: Folder to write.
        settings: What the object is calibrated by.
        force: Replace the folder where it is an object's already.

    Returns:
        The manifest.

    Raises:
        AssetError: The source or a setting is refused.
    """
    thing = calibrate(Path(source), settings)
    return in_folder(Path(out), force, lambda folder: write(thing, folder))


def write(thing: Object, folder: Path) -> dict[str, Any]:
    text = room.to_toml(thing)
    (folder / OBJECT).write_text(text)
    usd.write(thing, folder / f"{thing.name}.usda")
    mjcf.write(thing, folder / f"{thing.name}.xml")
    low, high = thing.bounds
    manifest = {
        "name": thing.name,
        "role": thing.role,
        "fixed": thing.fixed,
        "links": len(thing.parts),
        "joints": len(thing.joints),
        "mass_kg": thing.mass,
        "size_m": (high - low).tolist(),
        **thing.source,
        "digest": hashlib.sha256(text.encode()).hexdigest(),
        "files": digests(folder),
    }
    (folder / MANIFEST).write_text(json.dumps(manifest, indent=1) + "\n")
    return manifest


def digests(folder: Path) -> dict[str, str]:
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path.name != MANIFEST)
    return {path.relative_to(folder).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def in_folder(out: Path, force: bool, fill: Callable[[Path], dict[str, Any]]) -> dict[str, Any]:
    """Fills a new folder next to `out`, then gives it that name."""
    if out.exists() and not (force and (out / MANIFEST).is_file()):
        hint = (
            "use --force to replace it"
            if (out / MANIFEST).is_file()
            else "it is not an object's folder; name another one"
        )
        raise AssetError(f"{out}: it exists; {hint}")
    out.parent.mkdir(parents=True, exist_ok=True)
    part = Path(tempfile.mkdtemp(prefix=f".{out.name}.", dir=out.parent))
    try:
        part.chmod(0o755)
        result = fill(part)
        if out.exists():
            shutil.rmtree(out)
        part.rename(out)
        return result
    finally:
        shutil.rmtree(part, ignore_errors=True)
