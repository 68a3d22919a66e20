"""The table of feasibility, as text, JSON and a page with pictures."""

from __future__ import annotations

import html
import json
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
#: Triangles of a picture; of larger surfaces the pieces are drawn.
MAX_DRAWN = 4000


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
        f"<tr><td>{html.escape(words)}</td><td>{result['counts'][name][0]}/{result['counts'][name][1]}</td><td>{paper}</td></tr>"
        for name, words, paper in ROWS
    )
    cards = "".join(
        f"<figure>{picture(folder)}<figcaption>{html.escape(one['name'])}: {one['mass_kg']:.4g} kg, "
        f"{' x '.join(f'{side:.3g}' for side in one['size_m'])} m, {sum(one['pieces'])} pieces</figcaption></figure>"
        for one, folder in zip(result["objects"], folders)
    )
    trials = "".join(
        f"<tr class={'ok' if trial['passed'] else 'bad'}><td>{html.escape(trial['check'])}</td>"
        f"<td>{html.escape(' + '.join(trial['objects']))}</td><td>{html.escape(trial['case'])}</td>"
        f"<td>{html.escape(', '.join(f'{name} {value:.4g}' for name, value in trial['measures'] if value is not None))}</td>"
        f"<td>{html.escape(trial['reason']) or 'passed'}</td></tr>"
        for trial in result["trials"]
    )
    style = (
        "body{font:15px sans-serif;max-width:70rem;margin:2rem auto;padding:0 1rem}table{border-collapse:collapse}"
        "td,th{padding:.2rem .7rem;border-bottom:1px solid #ddd;text-align:left}figure{display:inline-block;margin:.5rem}"
        "figcaption{font-size:.85rem}.bad{background:#fde8e8}"
    )
    return (
        f"<!doctype html><meta charset=utf-8><title>Feasibility of objects</title><style>{style}</style>"
        f"<h1>Feasibility of objects</h1>{cards}"
        f"<h2>Checks</h2><table><tr><th>check<th>passed<th>paper</tr>{rows}</table>"
        "<p>The paper's numbers are of other objects, in Isaac Sim; its heights, forces and bounds are not published.</p>"
        f"<h2>Trials</h2><table><tr><th>check<th>objects<th>case<th>measured<th>result</tr>{trials}</table>"
    )


def picture(folder: Path, size: int = 240) -> str:
    """An object from the front right, above, as SVG: its drawn surfaces, or its pieces where those have too many triangles."""
    from pxr import Usd, UsdGeom, UsdPhysics

    stage = Usd.Stage.Open(str(folder / f"{manifest_of(folder)['name']}.usda"))
    cache = UsdGeom.XformCache()
    drawn: dict[bool, list[np.ndarray]] = {True: [], False: []}
    for prim in stage.Traverse():
        if not prim.IsA(UsdGeom.Mesh):
            continue
        mesh = UsdGeom.Mesh(prim)
        world = np.array(cache.GetLocalToWorldTransform(prim))
        points = np.array(mesh.GetPointsAttr().Get()) @ world[:3, :3] + world[3, :3]
        faces = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
        drawn[prim.HasAPI(UsdPhysics.CollisionAPI)].append(points[faces])
    is_small = sum(len(corners) for corners in drawn[False]) <= MAX_DRAWN
    corners = np.concatenate(drawn[not is_small])
    yaw, pitch = np.radians(35.0), np.radians(25.0)
    right = np.array([np.cos(yaw), np.sin(yaw), 0.0])
    ahead = np.array([-np.sin(yaw) * np.cos(pitch), np.cos(yaw) * np.cos(pitch), -np.sin(pitch)])
    up = np.cross(right, ahead)
    flat = np.stack([corners @ right, -(corners @ up)], axis=-1)
    low, high = flat.min(axis=(0, 1)), flat.max(axis=(0, 1))
    flat = (flat - (low + high) / 2.0) * (0.9 * size / (high - low).max()) + size / 2.0
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    light = np.array([0.3, -0.5, 0.8]) / np.linalg.norm([0.3, -0.5, 0.8])
    shade = (60 + 150 * np.clip(0.35 + 0.65 * (normals @ light), 0.0, 1.0)).astype(int)
    order = [at for at in np.argsort(-(corners @ ahead).mean(axis=1)) if normals[at] @ ahead < 0.0]
    polygons = "".join(
        f"<path d='M{' '.join(f'{x:.1f} {y:.1f}' for x, y in flat[at])}z' fill='rgb({shade[at]},{shade[at]},{shade[at] + 8})'/>"
        for at in order
    )
    return f"<svg width={size} height={size} viewBox='0 0 {size} {size}'>{polygons}</svg>"


def write_report(folders: list[Path], out: Path) -> dict[str, Any]:
    """Writes `report.txt`, `report.json` and `report.html` into a folder."""
    result = report(folders)
    out.mkdir(parents=True, exist_ok=True)
    (out / "report.txt").write_text(text(result))
    (out / "report.json").write_text(json.dumps(result, indent=1) + "\n")
    (out / "report.html").write_text(page(result, folders))
    return result
