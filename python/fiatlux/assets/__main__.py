"""The stages as commands."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

from .error import AssetError
from .files import read_text

MAX_MJCF_BYTES = 1 << 26
EXAMPLES = """examples:
  python -m fiatlux.assets build crate.glb --out crate --role crate --size 0.6 --mass 1.5
  python -m fiatlux.assets verify crate
  python -m fiatlux.assets report crate bulb socket --out report
  fiatlux evaluate --policy zero --tasks S06 --asset crate=crate
  python -m fiatlux.assets examples six       six objects through all stages
"""


def main(arguments: list[str] | None = None) -> int:
    parsed = parser().parse_args(arguments)
    try:
        return int(parsed.run(parsed) or 0)
    except (AssetError, ImportError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1


def parser() -> argparse.ArgumentParser:
    top = argparse.ArgumentParser(
        "python -m fiatlux.assets",
        description=__doc__,
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = top.add_subparsers(required=True, metavar="STAGE")

    def add(name: str, run: Any, words: str, out: bool = True) -> argparse.ArgumentParser:
        command = commands.add_parser(name, help=words, description=words)
        command.set_defaults(run=run)
        if out:
            command.add_argument("--out", type=Path, required=True, help="folder to write")
            command.add_argument("--force", action="store_true", help="replace the folder, if a stage wrote it")
        return command

    generate = add("generate", run_generate, "a mesh from a picture, by your own command or server")
    generate.add_argument("image", type=Path)
    generate.add_argument("--command", help="template with {image}, {out_dir} and {seed}")
    generate.add_argument("--server", help="address of a server, such as http://127.0.0.1:8081/generate")
    generate.add_argument("--seed", type=int, default=1234)
    generate.add_argument("--timeout", type=float, default=1800.0, help="s")

    articulate = add("articulate", run_articulate, "parts and joints of a mesh, by your own command")
    articulate.add_argument("mesh", type=Path)
    articulate.add_argument(
        "--command", required=True, help="template with {mesh} and {out_dir}; leaves a URDF or TOML"
    )
    articulate.add_argument("--timeout", type=float, default=1800.0, help="s")

    build = add(
        "build", run_build, "an object from a mesh, or from the TOML or URDF of its parts: USD, MJCF, object.toml"
    )
    build.add_argument("source", type=Path)
    build.add_argument("--name", help="default: the source's")
    build.add_argument("--role", default="none", help="none, crate, bulb, ladder, bench or fixture")
    build.add_argument("--size", type=float, help="largest extent, m")
    build.add_argument("--units", default="m", help="of the mesh, without --size: m, cm, mm or in")
    build.add_argument("--up", choices=["y", "z"], help="default: y for glTF, z for other formats")
    build.add_argument("--mass", type=float, help="kg")
    build.add_argument("--density", type=float, help="kg/m^3, in place of --mass")
    build.add_argument("--friction", type=float, nargs=2, default=(1.2, 1.0), metavar=("STATIC", "DYNAMIC"))
    build.add_argument("--fixed", action="store_true", help="join it to the world")
    build.add_argument("--threshold", type=float, default=0.03, help="concavity that convex pieces leave")
    build.add_argument("--seed", type=int, default=0, help="of the convex decomposition")
    build.add_argument("--repair", action="store_true", help="fill small holes and turn faces outwards")

    verify = add(
        "verify", run_verify, "27 assertions on a USD stage or an object's folder, and usd-core's validators", out=False
    )
    verify.add_argument("asset", type=Path, nargs="?")
    verify.add_argument("--list", action="store_true", help="print the assertions, one a line")
    verify.add_argument("--json", action="store_true")
    verify.add_argument("--approximation", choices=["convexHull", "convexDecomposition", "none"])
    verify.add_argument("--bodies", type=int)
    verify.add_argument("--joints", type=int)
    verify.add_argument("--size", type=float, nargs=2, default=(0.01, 10.0), metavar=("MIN", "MAX"))

    tried = add("try", run_try, "feasibility trials in our engine", out=False)
    tried.add_argument("objects", type=Path, nargs="+")
    tried.add_argument("--json", action="store_true")

    report = commands.add_parser("report", help="assertions and trials as a table: text, JSON and HTML")
    report.set_defaults(run=run_report)
    report.add_argument("objects", type=Path, nargs="+")
    report.add_argument("--out", type=Path, required=True)

    scene = add("scene", run_scene, "a scene of the benchmark as USD")
    scene.add_argument(
        "--mjcf", type=Path, help="what sim-server export wrote, in place of --task and --seed; - for stdin"
    )
    scene.add_argument("--task", default="S01")
    scene.add_argument("--seed", type=int, default=0)

    examples = commands.add_parser("examples", help="six objects, made here, through all stages, with a report")
    examples.set_defaults(run=run_examples)
    examples.add_argument("out", type=Path)
    return top


def run_generate(given: argparse.Namespace) -> None:
    from .generate import generate

    done = generate(given.image, given.out, given.command, given.server, given.seed, given.timeout, given.force)
    print(f"{given.out}: {done['mesh']}, {done['triangles']} triangles, {done['seconds']} s")


def run_articulate(given: argparse.Namespace) -> None:
    from .generate import articulate

    done = articulate(given.mesh, given.out, given.command, given.timeout, given.force)
    print(f"{given.out}: {done['source']} with {len(done['parts'])} parts and {len(done['joints'])} joints")


def run_build(given: argparse.Namespace) -> None:
    from .build import build
    from .object import Settings

    settings = Settings(
        given.name or given.source.stem,
        given.role,
        given.size,
        given.units,
        given.up,
        given.mass,
        given.density,
        tuple(given.friction),
        given.fixed,
        given.threshold,
        given.seed,
        given.repair,
    )
    show(given.out, build(given.source, given.out, settings, given.force))


def show(out: Path, done: dict[str, Any]) -> None:
    size = " x ".join(f"{side:.3g}" for side in done["size_m"])
    pieces = sum(done["pieces"])
    print(
        f"{out}: {size} m, {done['mass_kg']:.4g} kg, {done['links']} links, {pieces} pieces, digest {done['digest'][:12]}"
    )
    if done["not_read"]:
        print(f"{out}: not read, of the look alone: {', '.join(done['not_read'])}", file=sys.stderr)


def run_verify(given: argparse.Namespace) -> int:
    from . import report, verify

    if given.list:
        for number, assertion in enumerate(verify.ASSERTIONS, start=1):
            level = "warning" if assertion in verify.WARNINGS else "error"
            print(f"{number:2} {assertion.__name__:<20} {level:<8} {assertion.__doc__}")
        return 0
    if given.asset is None:
        raise AssetError("verify: name a USD file or an object's folder, or use --list")
    if given.asset.is_dir():
        result = report.structure(given.asset)
    else:
        expected = verify.Expected(given.approximation, given.bodies, given.joints, tuple(given.size))
        rows = verify.verify(given.asset, expected)
        result = {
            "passed": all(row.status != "fail" for row in rows),
            "assertions": [vars(row) for row in rows],
            "validators": verify.validators(given.asset),
        }
        result["passed"] = result["passed"] and not result["validators"]
    if given.json:
        print(json.dumps(result, indent=1))
        return 0 if result["passed"] else 1
    for row in result["assertions"]:
        print(f"{row['number']:2} {row['name']:<20} {row['status']}")
        for finding in row["findings"]:
            print(f"   {finding}")
    for finding in result["validators"]:
        print(f"usd-core: {finding}")
    print("passed" if result["passed"] else "failed")
    return 0 if result["passed"] else 1


def run_try(given: argparse.Namespace) -> int:
    from .report import try_objects

    trials = try_objects(given.objects)
    if given.json:
        print(json.dumps(trials, indent=1))
    else:
        for trial in trials:
            outcome = "passed" if trial["passed"] else f"failed: {trial['reason']}"
            print(f"{trial['check']:<14} {' + '.join(trial['objects']):<24} {trial['case']:<48} {outcome}")
    return 0 if all(trial["passed"] for trial in trials) else 1


def run_report(given: argparse.Namespace) -> None:
    from .report import text, write_report

    print(text(write_report(given.objects, given.out)), end="")


def run_scene(given: argparse.Namespace) -> None:
    from .scene import write_scene

    if given.mjcf is not None:
        try:
            model = sys.stdin.read() if str(given.mjcf) == "-" else read_text(given.mjcf, MAX_MJCF_BYTES)
        except UnicodeDecodeError as error:
            raise AssetError(f"{given.mjcf}: {error}") from error
    else:
        from fiatlux import Env

        env = Env(given.task)
        env.reset(seed=given.seed)
        model = env.to_mjcf()
    done = write_scene(model, given.out, given.force)
    print(f"{given.out}/scene.usda: " + ", ".join(f"{value:.6g} {name}" for name, value in done.items()))


def run_examples(given: argparse.Namespace) -> int:
    from .build import build
    from .objects import write_sources
    from .report import text, write_report

    if given.out.exists():
        raise AssetError(f"{given.out}: it exists; name another folder")
    folders = []
    for source, settings in write_sources(given.out / "sources"):
        folders.append(given.out / settings.name)
        show(folders[-1], build(source, folders[-1], settings))
    result = write_report(folders, given.out / "report")
    print(text(result), end="")
    return 0 if result["counts"]["structure"][0] == len(folders) else 1


if __name__ == "__main__":
    sys.exit(main())
