"""Fuzzes the readers of mesh files (glTF, PLY, STL, OBJ) with changed files: nothing but `AssetError` may come of one.

No coverage steers it: seeds of each format are changed by bytes, by numbers and, for glTF, in the tree of its document. A file that takes
more than 10 s or more than 1 GiB is a fault like any other exception; it is kept, and the program ends with 1.
"""

from __future__ import annotations

import argparse
import base64
import json
import random
import resource
import signal
import struct
import sys
import time
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
# The package itself needs its compiled part, its readers do not.
PACKAGE = types.ModuleType("fiatlux")
PACKAGE.__path__ = [str(ROOT / "python" / "fiatlux")]
sys.modules.setdefault("fiatlux", PACKAGE)

from fiatlux.assets.error import AssetError  # noqa: E402
from fiatlux.assets.formats import HEADS, READERS  # noqa: E402

MAX_SECONDS = 10
MAX_BYTES = 1 << 30
#: A limit counts what the interpreter and its libraries have mapped already.
HEAD = 1 << 16

NUMBERS = [
    "0",
    "-1",
    "1e999",
    "nan",
    "4294967295",
    "4294967296",
    "18446744073709551615",
    "-2147483649",
    "0.5",
    "99999999999999999999",
]
WORDS = [
    "0",
    "-1",
    "1",
    "2",
    "255",
    "65536",
    "2147483648",
    "4294967295",
    "1e308",
    "0.5",
    "true",
    "null",
    '""',
    '"a"',
    "[]",
    "{}",
]
WORDS += ["[0, 0, 0, 0, 0, 0, 0, 0, 0]", '{"a": 0}', "9223372036854775808", "NaN", "-Infinity"]


def document(uri: str | None) -> dict[str, Any]:
    """A glTF document of one triangle, in a file of its own or in the bytes behind it."""
    buffer: dict[str, Any] = {"byteLength": 42} if uri is None else {"byteLength": 42, "uri": uri}
    return {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [
            {"mesh": 0, "children": [1], "rotation": [0, 0, 0, 1]},
            {"mesh": 0, "translation": [0, 0.1, 0], "scale": [1, 1, 1]},
        ],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0, "mode": 4}]}],
        "materials": [{"pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.5, 0.5, 1], "metallicFactor": 0}}],
        "accessors": [
            {
                "bufferView": 0,
                "componentType": 5126,
                "count": 3,
                "type": "VEC3",
                "min": [0, 0, 0],
                "max": [0.1, 0.1, 0],
            },
            {"bufferView": 1, "componentType": 5123, "count": 3, "type": "SCALAR"},
        ],
        "bufferViews": [
            {"buffer": 0, "byteLength": 36},
            {"buffer": 0, "byteOffset": 36, "byteLength": 6},
        ],
        "buffers": [buffer],
    }


CORNERS = (0.0, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 0.1, 0.0)
BUFFER = struct.pack("<9f3H", *CORNERS, 0, 1, 2)


def glb(tree: Any) -> bytes:
    text = json.dumps(tree).encode()
    text += b" " * (-len(text) % 4)
    data = BUFFER + bytes(-len(BUFFER) % 4)
    body = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
    return struct.pack("<4sII", b"glTF", 2, 12 + len(body)) + body


def ply(form: str) -> bytes:
    head = (
        f"ply\nformat {form} 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    ).encode()
    if form == "ascii":
        return head + b"0 0 0\n0.1 0 0\n0 0.1 0\n3 0 1 2\n"
    order = "<" if "little" in form else ">"
    return head + struct.pack(f"{order}9f", *CORNERS) + struct.pack(f"{order}B3i", 3, 0, 1, 2)


STL = b"solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 0.1 0 0\nvertex 0 0.1 0\nendloop\nendfacet\nendsolid a\n"
OBJ = b"o a\nv 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nv 0 0 0.1\nvn 0 0 1\nvt 0 0\nf 1/1/1 2/1/1 3/1/1\nf -4 -2 -1\nf 1 2 3 4\n"
URI = "data:application/octet-stream;base64," + base64.b64encode(BUFFER).decode()
SEEDS = [
    (".glb", glb(document(None))),
    (".gltf", json.dumps(document(URI)).encode()),
    (".ply", ply("ascii")),
    (".ply", ply("binary_little_endian")),
    (".ply", ply("binary_big_endian")),
    (".stl", STL),
    (".stl", bytes(80) + struct.pack("<I12fH", 1, 0, 0, 1, *CORNERS, 0)),
    (".obj", OBJ),
]


def places(tree: Any, into: list[tuple[Any, Any]]) -> None:
    """All places of a tree, as a container and its key."""
    for key in tree if isinstance(tree, dict) else range(len(tree)) if isinstance(tree, list) else ():
        into.append((tree, key))
        places(tree[key], into)


def changed_tree(rng: random.Random, uri: str | None) -> Any:
    tree = document(uri)
    for _ in range(rng.randint(1, 4)):
        found: list[tuple[Any, Any]] = []
        places(tree, found)
        if not found:
            break
        container, key = rng.choice(found)
        other, of = rng.choice(found)
        match rng.randrange(4):
            case 0:
                container[key] = json.loads(rng.choice(WORDS))
            case 1:
                # A copy, since what holds itself is no document.
                container[key] = json.loads(json.dumps(other[of]))
            case 2:
                del container[key]
            case _ if isinstance(container, list) and len(container) < 200:
                container.extend(json.loads(json.dumps(container)) * rng.choice([1, 3, 100]))
            case _ if isinstance(container, dict):
                container[rng.choice(["sparse", "extensions", "extras", "skin", "matrix", "targets"])] = json.loads(
                    rng.choice(WORDS)
                )
    return tree


def changed_bytes(rng: random.Random, content: bytes) -> bytes:
    data = bytearray(content)
    for _ in range(rng.choice([1, 1, 2, 4, 8])):
        at = rng.randrange(len(data) + 1)
        length = rng.choice([1, 2, 4, 16, 64])
        match rng.randrange(6):
            case 0:
                data[at : at + 1] = bytes([rng.randrange(256)])
            case 1:
                del data[at : at + length]
            case 2:
                data[at:at] = data[at : at + length] * rng.choice([1, 2, 50])
            case 3:
                data[at : at + 4] = rng.choice([0, 1, 2**31 - 1, 2**31, 2**32 - 1]).to_bytes(4, "little")
            case 4:
                numbers = [start for start, byte in enumerate(data) if 48 <= byte < 58]
                if numbers:
                    start = rng.choice(numbers)
                    data[start : start + 1] = rng.choice(NUMBERS).encode()
            case _:
                data[at:at] = rng.choice([b"\n", b" ", b"\0", b"\xff", b"[" * 5000, b"{", b'"', b"-", b"end_header\n"])
    return bytes(data)


def sample(rng: random.Random) -> tuple[str, bytes]:
    ending, content = rng.choice(SEEDS)
    if ending == ".glb" and rng.random() < 0.7:
        content = glb(changed_tree(rng, None))
    elif ending == ".gltf" and rng.random() < 0.7:
        content = json.dumps(changed_tree(rng, URI)).encode()
    return ending, changed_bytes(rng, content) if rng.random() < 0.6 else content


def read(path: Path, ending: str, content: bytes) -> bool:
    """As the intake does; true if it is a mesh."""
    check: Callable[[Path, bytes, int], None] | None = HEADS.get(ending)
    try:
        if check is not None:
            check(path, content[:HEAD], len(content))
        READERS[ending](path, content)
    except AssetError:
        return False
    return True


def too_slow(*_: Any) -> None:
    raise TimeoutError(f"more than {MAX_SECONDS} s")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60, help="time of the run")
    parser.add_argument(
        "--out", type=Path, default=ROOT / "target" / "fuzz" / "intake", help="folder of a file at fault"
    )
    parser.add_argument("--seed", type=int, default=None, help="seed of the changes [default: drawn]")
    args = parser.parse_args()
    seed = random.SystemRandom().randrange(2**32) if args.seed is None else args.seed
    rng = random.Random(seed)
    mapped = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (mapped + MAX_BYTES, resource.RLIM_INFINITY))
    signal.signal(signal.SIGALRM, too_slow)
    # Numbers beyond all bounds are what this is about.
    np.seterr(all="ignore")
    path = args.out / "a.mesh"
    for ending, content in SEEDS:
        assert read(path, ending, content), f"the seed {ending} is a mesh"
    count = meshes = 0
    until = time.monotonic() + args.seconds
    while time.monotonic() < until:
        ending, content = sample(rng)
        signal.alarm(MAX_SECONDS)
        try:
            meshes += read(path, ending, content)
        except BaseException:
            signal.alarm(0)
            args.out.mkdir(parents=True, exist_ok=True)
            kept = args.out / f"fault{ending}"
            kept.write_bytes(content)
            print(f"intake: seed {seed}, file {count}: {kept} is at fault", file=sys.stderr)
            raise
        signal.alarm(0)
        count += 1
    print(f"intake: seed {seed}, {count} files, {meshes} of them meshes, no fault")
    return 0


if __name__ == "__main__":
    sys.exit(main())
