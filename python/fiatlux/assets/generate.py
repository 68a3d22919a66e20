"""Meshes from pictures by the user's own command or server: nothing of a model is part of this package."""

from __future__ import annotations

import hashlib
import json
import shlex
import subprocess
import time
import urllib.error
import urllib.request
from base64 import b64encode
from pathlib import Path
from typing import Any

from .build import in_folder
from .error import AssetError
from .files import read_bytes
from .formats.parsed import MAX_FILE_BYTES
from .mesh import FORMATS, parse

#: Largest picture, bytes.
MAX_IMAGE_BYTES = 64 << 20
IMAGES = {b"\x89PNG": "png", b"\xff\xd8\xff": "jpeg", b"RIFF": "webp"}


def generate(
    image: str | Path,
    out: str | Path,
    command: str | None = None,
    server: str | None = None,
    seed: int = 1234,
    timeout: float = 1800.0,
    force: bool = False,
) -> dict[str, Any]:
    """Runs a generator on a picture and keeps the mesh that it leaves.

    A command is a template: ``{image}``, ``{out_dir}`` and ``{seed}`` are replaced, after it was split as a shell does; no shell
    runs it. It must end with code 0 and leave exactly one mesh (GLB, OBJ, PLY or STL) in ``{out_dir}``. A server gets
    ``POST URL`` with JSON ``{"image": base64, "seed": n, "texture": true}`` and answers with the bytes of a GLB, as the
    ``/generate`` of Hunyuan3D-2.1's ``api_server.py`` does.

    Args:
        image: PNG, JPEG or WebP.
        out: Folder to write: the mesh, ``generate.log``, and ``manifest.json`` with how it was made.
        command: Template of a command.
        server: URL of a server. Either this or ``command`` is given.
        seed: For the generator.
        timeout: Longest time, s.
        force: Replace the folder.

    Raises:
        AssetError: The picture, the command, the server or what it left is refused.
    """
    image = Path(image)
    if (command is None) == (server is None):
        raise AssetError("generate: give either a command or a server")
    content = read_bytes(image, MAX_IMAGE_BYTES)
    if not any(content.startswith(magic) for magic in IMAGES):
        raise AssetError(f"{image}: it is no picture; use {', '.join(IMAGES.values())}")

    def fill(folder: Path) -> dict[str, Any]:
        started = time.monotonic()
        if command is not None:
            log = by_command(command, image, folder, seed, timeout)
        else:
            log = by_server(str(server), content, folder, seed, timeout)
        (folder / "generate.log").write_text(log)
        meshes = sorted(path for path in folder.rglob("*") if path.suffix.lower() in FORMATS)
        if len(meshes) != 1:
            found = ", ".join(path.name for path in meshes) or "none"
            raise AssetError(f"generate: there must be one mesh in {{out_dir}}; found {found}")
        (mesh,) = meshes
        if mesh.is_symlink() or not mesh.resolve().is_relative_to(folder.resolve()):
            raise AssetError(f"generate: {mesh.name} is a link; leave a file")
        manifest = {
            "image": {"name": image.name, "sha256": hashlib.sha256(content).hexdigest()},
            "generator": command if command is not None else server,
            "seed": seed,
            "seconds": round(time.monotonic() - started, 3),
            "mesh": mesh.relative_to(folder).as_posix(),
            "triangles": sum(len(chunk.faces) for chunk in parse(mesh).chunks),
            "sha256": hashlib.sha256(mesh.read_bytes()).hexdigest(),
        }
        (folder / "manifest.json").write_text(json.dumps(manifest, indent=1) + "\n")
        return manifest

    return in_folder(Path(out), force, fill)


def run_template(command: str, values: dict[str, str], timeout: float, what: str) -> str:
    """Runs a command after replacing its placeholders; returns what it printed.

    Raises:
        AssetError: It names no placeholder, cannot be started, fails, or takes too long.
    """
    try:
        words = shlex.split(command)
    except ValueError as error:
        raise AssetError(f"{what}: the command cannot be split: {error}") from error
    missing = [f"{{{name}}}" for name in values if name != "seed" and not any(f"{{{name}}}" in word for word in words)]
    if missing:
        raise AssetError(f"{what}: the command has no {missing[0]}; it is replaced by the path")
    for name, value in values.items():
        words = [word.replace(f"{{{name}}}", value) for word in words]
    try:
        done = subprocess.run(words, capture_output=True, text=True, timeout=timeout, check=False, errors="replace")
    except subprocess.TimeoutExpired as error:
        raise AssetError(f"{what}: the command took more than {timeout:g} s; raise --timeout") from error
    except OSError as error:
        raise AssetError(f"{what}: cannot start '{words[0]}': {error}") from error
    log = done.stdout + done.stderr
    if done.returncode != 0:
        last = log.strip().splitlines()[-1:] or ["it printed nothing"]
        raise AssetError(f"{what}: the command ended with code {done.returncode}: {last[0]}")
    return log


def by_command(command: str, image: Path, folder: Path, seed: int, timeout: float) -> str:
    values = {"image": str(image.resolve()), "out_dir": str(folder.resolve()), "seed": str(seed)}
    return run_template(command, values, timeout, "generate")


def by_server(server: str, content: bytes, folder: Path, seed: int, timeout: float) -> str:
    if not server.startswith(("http://", "https://")):
        raise AssetError(f"generate: '{server}' is no address; use http://HOST:PORT/generate")
    body = json.dumps({"image": b64encode(content).decode(), "seed": seed, "texture": True}).encode()
    request = urllib.request.Request(server, data=body, headers={"Content-Type": "application/json"})
    try:
        with urllib.request.urlopen(request, timeout=timeout) as answer:
            mesh = answer.read(MAX_FILE_BYTES + 1)
    except (urllib.error.URLError, OSError) as error:
        raise AssetError(f"generate: the server {server} did not answer: {error}") from error
    if mesh[:4] != b"glTF":
        raise AssetError(f"generate: the server answered with {len(mesh)} bytes that are no GLB")
    if len(mesh) > MAX_FILE_BYTES:
        raise AssetError(f"generate: the server answered with more than {MAX_FILE_BYTES} bytes")
    (folder / "mesh.glb").write_bytes(mesh)
    return f"{server}: {len(mesh)} bytes\n"


def articulate(
    mesh: str | Path, out: str | Path, command: str, timeout: float = 1800.0, force: bool = False
) -> dict[str, Any]:
    """Runs the user's articulator, such as SimArt, on a mesh: ``{mesh}`` and ``{out_dir}`` of the template are replaced. It must
    leave one URDF, or one TOML of parts and joints, and their meshes.

    The mesh is handed over as GLB, y up, centred, with a largest extent of 1, which is what SimArt reads.

    Raises:
        AssetError: The mesh, the command or what it left is refused.
    """
    from . import articulation
    from .mesh import read
    from .normalized import export

    surface = read(Path(mesh))

    def fill(folder: Path) -> dict[str, Any]:
        source = folder / "normalized.glb"
        export(surface, source)
        values = {"mesh": str(source.resolve()), "out_dir": str(folder.resolve())}
        (folder / "articulate.log").write_text(run_template(command, values, timeout, "articulate"))
        found = sorted(path for path in folder.rglob("*") if path.suffix in (".urdf", ".toml"))
        if len(found) != 1:
            names = ", ".join(path.name for path in found) or "none"
            raise AssetError(f"articulate: there must be one URDF or TOML in {{out_dir}}; found {names}")
        read_back = articulation.read(found[0])
        manifest = {
            "articulator": command,
            "source": found[0].relative_to(folder).as_posix(),
            "parts": [part.name for part in read_back.parts],
            "joints": [joint.name for joint in read_back.joints],
        }
        (folder / "manifest.json").write_text(json.dumps(manifest, indent=1) + "\n")
        return manifest

    return in_folder(Path(out), force, fill)
