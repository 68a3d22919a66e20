"""The table of feasibility, as text, JSON and a page with pictures."""

from __future__ import annotations

import base64
import html
import io
import json
import math
from pathlib import Path
from typing import Any

import numpy as np

from .. import _native
from .articulation import check_name
from .build import MANIFEST
from .error import AssetError
from .files import read_text
from .verify import ASSERTIONS, Expected, validators, verify

#: Rows of the table: the trials' name, its words in the paper, and the numbers that the paper has for its own objects.
ROWS = (
    ("structure", "USD structure", "6/6"),
    ("basic_physics", "Basic physics", "18/18"),
    ("bulb_drop", "Bulb drop", "14/16"),
    ("bulb_socket", "Bulb-socket interaction (standardized)", "16/32"),
    ("ladder_load", "Ladder load and push", "16/16"),
    ("scene_fit", "Scene fit", "12/18"),
    ("joint_motion", "Articulated joint motion", "0/2"),
)
MAX_MANIFEST_BYTES = 1 << 20
#: Sides of a picture, pixels.
PICTURE = 320
#: Linear colours of the convex pieces, in turn.
PIECES = (
    (0.10, 0.30, 0.60), (0.75, 0.30, 0.05), (0.10, 0.45, 0.20), (0.55, 0.10, 0.25),
    (0.70, 0.55, 0.08), (0.30, 0.18, 0.55), (0.08, 0.45, 0.50), (0.50, 0.35, 0.22),
)  # fmt: skip
#: Units of measures by the end of their names.
UNITS = (("_rad_s", "rad/s"), ("_m_s", "m/s"), ("_rad", "rad"), ("_m", "m"), ("_s", "s"), ("_n", "N"))
STYLE = """
:root { --page: #f5f6f8; --card: #fff; --ink: #18212c; --soft: #566272; --line: #dfe3e9; --bad: #b8322a; --ok: #2b7a5d; color-scheme: light dark; }
@media (prefers-color-scheme: dark) {
  :root { --page: #0f1318; --card: #171d25; --ink: #e6eaf0; --soft: #9aa6b5; --line: #2b3440; --bad: #f0766c; --ok: #4fb38c; }
}
body { margin: 0; background: var(--page); color: var(--ink); font: 15px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, Arial, sans-serif; }
main { max-width: 1136px; margin: 0 auto; padding: 32px 24px 64px; }
h2 { font-size: 19px; margin: 40px 0 10px; }
.objects { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(320px, 100%), 1fr)); gap: 14px; }
figure { margin: 0; background: var(--card); border: 1px solid var(--line); border-radius: 10px; overflow: hidden; }
figure div { display: grid; grid-template-columns: 1fr 1fr; gap: 1px; }
img { display: block; width: 100%; height: auto; }
figcaption { padding: 10px 14px 12px; font-size: 14px; }
figcaption span { display: block; color: var(--soft); font-size: 13px; }
.scroll { overflow-x: auto; background: var(--card); border: 1px solid var(--line); border-radius: 10px; padding: 6px 14px; }
table { border-collapse: collapse; width: 100%; font-size: 13px; font-variant-numeric: tabular-nums; }
th, td { padding: 6px 8px; border-bottom: 1px solid var(--line); text-align: left; vertical-align: top; }
th { color: var(--soft); font-weight: 600; }
tbody tr:last-child td { border-bottom: 0; }
.ok { color: var(--ok); } .bad { color: var(--bad); font-weight: 600; }
"""


def manifest_of(folder: Path) -> dict[str, Any]:
    """The manifest of an object's folder.

    Raises:
        AssetError: It is missing, or is not that of an object.
    """
    remedy = "write one with `build`"
    try:
        manifest = json.loads(read_text(folder / MANIFEST, MAX_MANIFEST_BYTES))
    except (AssetError, ValueError, RecursionError) as error:
        raise AssetError(f"{folder}: it is not an object's folder; {remedy}") from error
    counts = [manifest.get(name) for name in ("links", "joints")] if isinstance(manifest, dict) else [None]
    if not all(isinstance(count, int) for count in counts):
        raise AssetError(f"{folder}: {MANIFEST} is not that of an object; {remedy}")
    check_name(manifest.get("name"), f"{folder}: name")
    return manifest


def structure(folder: Path) -> dict[str, Any]:
    """The 27 assertions on an object that was built here, with what its manifest leads to expect."""
    manifest = manifest_of(folder)
    joints = manifest["joints"] + (1 if manifest.get("fixed") else 0)
    expected = Expected("convexHull", manifest["links"], joints)
    file = folder / f"{manifest['name']}.usda"
    rows = verify(file, expected)
    found = validators(file)
    return {
        "object": manifest["name"],
        "passed": not found and all(row.status != "fail" for row in rows),
        "assertions": [
            {"number": row.number, "name": row.name, "status": row.status, "findings": row.findings} for row in rows
        ],
        "validators": found,
    }


def try_objects(folders: list[Path]) -> list[dict[str, Any]]:
    """All trials of some objects, in the engine of this package."""
    for folder in folders:
        manifest_of(folder)
    try:
        return json.loads(_native.asset_trials([str(folder) for folder in folders]))
    except ValueError as error:
        raise AssetError(str(error)) from error


def report(folders: list[Path]) -> dict[str, Any]:
    """Structure and trials of some objects, and their counts by row of the table."""
    structures = [structure(folder) for folder in folders]
    trials = try_objects(folders)
    counts = {"structure": [sum(one["passed"] for one in structures), len(structures)]}
    for name, _, _ in ROWS[1:]:
        of = [trial["passed"] for trial in trials if trial["check"] == name]
        counts[name] = [sum(of), len(of)]
    objects = [manifest_of(folder) for folder in folders]
    return {
        "assertions": len(ASSERTIONS),
        "counts": counts,
        "objects": objects,
        "structure": structures,
        "trials": trials,
    }


def text(result: dict[str, Any]) -> str:
    """The table, and what failed."""
    lines = [f"{'check':<42} {'passed':>8} {'paper':>8}", "-" * 60]
    for name, words, paper in ROWS:
        passed, tried = result["counts"][name]
        lines.append(f"{words:<42} {f'{passed}/{tried}' if tried else '-':>8} {paper:>8}")
    lines.append(
        "The paper's numbers are of other objects, in Isaac Sim; its heights, forces and bounds are not published."
    )
    failed = [
        f"{row['name']}: {finding}"
        for one in result["structure"]
        for row in one["assertions"]
        if row["status"] == "fail"
        for finding in row["findings"]
    ]
    failed += [finding for one in result["structure"] for finding in one["validators"]]
    failed += [
        f"{trial['check']}, {' + '.join(trial['objects'])}, {trial['case']}: {trial['reason']}"
        for trial in result["trials"]
        if not trial["passed"]
    ]
    if failed:
        lines += ["", "failed:", *(f"  {line}" for line in failed)]
    return "\n".join(lines) + "\n"


def page(result: dict[str, Any], folders: list[Path]) -> str:
    """A page that loads nothing from elsewhere."""
    rows = "".join(
        f"<tr><td>{html.escape(words)}</td><td>{f'{passed} of {tried}' if tried else '-'}</td><td>{paper.replace('/', ' of ')}</td></tr>"
        for name, words, paper in ROWS
        for passed, tried in [result["counts"][name]]
    )
    cards = "".join(card(one, folder) for one, folder in zip(result["objects"], folders))
    trials = "".join(
        f"<tr><td>{html.escape(trial['check'].replace('_', ' '))}</td>"
        f"<td>{html.escape(' + '.join(trial['objects']))}</td><td>{html.escape(trial['case'])}</td>"
        f"<td>{html.escape(', '.join(measure(name, value) for name, value in trial['measures'] if value is not None))}</td>"
        f"<td class={'ok' if trial['passed'] else 'bad'}>{html.escape(trial['reason']) or 'passed'}</td></tr>"
        for trial in result["trials"]
    )
    return (
        '<!doctype html><html lang="en"><meta charset="utf-8"><meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>Feasibility of objects</title><style>{STYLE}</style><main>"
        f'<h1>Feasibility of objects</h1><div class="objects">{cards}</div>'
        '<h2>Checks</h2><div class="scroll" tabindex="0" role="region" aria-label="Checks"><table>'
        f"<thead><tr><th>check<th>passed<th>paper</tr></thead><tbody>{rows}</tbody></table></div>"
        "<p>The paper's numbers are of other objects, in Isaac Sim; its heights, forces and bounds are not published.</p>"
        '<h2>Trials</h2><div class="scroll" tabindex="0" role="region" aria-label="Trials"><table>'
        f"<thead><tr><th>check<th>objects<th>case<th>measured<th>result</tr></thead><tbody>{trials}</tbody></table></div></main></html>"
    )


def card(one: dict[str, Any], folder: Path) -> str:
    """An object's pictures, measures and textures."""
    drawn, pieces, textures = pictures(folder)
    name = html.escape(one["name"])
    scale, unit = (1.0, "m") if max(one["size_m"]) >= 1.0 else (1000.0, "mm")
    size = " x ".join(f"{scale * side:.3g}" for side in one["size_m"])
    count = sum(one["pieces"])
    return (
        f'<figure><div><img src="{drawn}" width="{PICTURE}" height="{PICTURE}" alt="{name}, as it looks">'
        f'<img src="{pieces}" width="{PICTURE}" height="{PICTURE}" alt="{name}, as its convex pieces"></div>'
        f"<figcaption>{name}<span>{quantity(one['mass_kg'], 'kg')}, {size} {unit}</span>"
        f"<span>{count} convex piece{'' if count == 1 else 's'}; {html.escape(', '.join(textures)) or 'no texture'}</span></figcaption></figure>"
    )


def measure(name: str, value: float) -> str:
    """A measure of a trial in words, with its unit."""
    end, unit = next(((end, unit) for end, unit in UNITS if name.endswith(end)), ("", ""))
    return f"{name.removesuffix(end).replace('_', ' ')} {quantity(value, unit)}"


def quantity(value: float, unit: str) -> str:
    """A number with its unit: short lengths in mm, small masses in g, and nothing finer than a thousandth of the unit."""
    if unit == "m" and abs(value) < 0.1:
        value, unit = 1000.0 * value, "mm"
    elif unit == "kg" and abs(value) < 1.0:
        value, unit = 1000.0 * value, "g"
    if 0.0 < abs(value) < 0.001:
        return f"below 0.001 {unit}".rstrip()
    digits = max(2 - math.floor(math.log10(abs(value))), 0) if value else 0
    return f"{value:.{min(digits, 3)}f} {unit}".rstrip()


def pictures(folder: Path) -> tuple[str, str, list[str]]:
    """An object as it looks, and as its convex pieces, from the front right, above, as addresses of data; and its textures."""
    from PIL import Image
    from pxr import Usd, UsdGeom, UsdPhysics

    stage = Usd.Stage.Open(str(folder / f"{manifest_of(folder)['name']}.usda"))
    cache = UsdGeom.XformCache()
    drawn: list[Any] = []
    pieces: list[Any] = []
    textures: list[str] = []
    for prim in stage.Traverse():
        if not prim.IsA(UsdGeom.Mesh):
            continue
        mesh = UsdGeom.Mesh(prim)
        world = np.array(cache.GetLocalToWorldTransform(prim))
        points = (np.array(mesh.GetPointsAttr().Get()) @ world[:3, :3] + world[3, :3]).astype(np.float32)
        faces = np.array(mesh.GetFaceVertexIndicesAttr().Get(), np.uint32).reshape(-1, 3)
        if prim.HasAPI(UsdPhysics.CollisionAPI):
            pieces.append((points, faces, PIECES[len(pieces) % len(PIECES)], None))
            continue
        colour, file = look_of(prim)
        texture = None
        if file is not None:
            coordinates = UsdGeom.PrimvarsAPI(prim).GetPrimvar("st").Get()
            with Image.open(folder / file) as image:
                texture = (np.array(coordinates, np.float32), np.asarray(image.convert("RGB")))
                textures.append(f"{Path(file).name}, {image.width} x {image.height}")
        drawn.append((points, faces, colour, texture))
    return picture(drawn), picture(pieces), textures


def look_of(prim: Any) -> tuple[tuple[float, float, float], str | None]:
    """Linear colour of a mesh that `build` wrote, and the file of its texture."""
    from pxr import UsdShade

    material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()
    shader = material.ComputeSurfaceSource()[0] if material else None
    if not shader:
        return (0.5, 0.5, 0.5), None
    given = shader.GetInput("diffuseColor")
    source = given.GetConnectedSources()[0]
    if not source:
        return tuple(given.Get()), None
    texture = UsdShade.Shader(source[0].source)
    red, green, blue, _ = texture.GetInput("scale").Get()
    return (red, green, blue), texture.GetInput("file").Get().path


def picture(parts: list[Any]) -> str:
    """A picture by our renderer, as an address of data."""
    from PIL import Image

    image = Image.frombytes("RGB", (PICTURE, PICTURE), _native.asset_picture(parts, PICTURE, PICTURE))
    file = io.BytesIO()
    image.save(file, "JPEG", quality=88)
    return "data:image/jpeg;base64," + base64.b64encode(file.getvalue()).decode()


def write_report(folders: list[Path], out: Path) -> dict[str, Any]:
    """Writes `report.txt`, `report.json` and `report.html` into a folder."""
    result = report(folders)
    out.mkdir(parents=True, exist_ok=True)
    (out / "report.txt").write_text(text(result))
    (out / "report.json").write_text(json.dumps(result, indent=1) + "\n")
    (out / "report.html").write_text(page(result, folders))
    return result
