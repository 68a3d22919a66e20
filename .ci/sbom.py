#!/usr/bin/env python3
"""Writes what a release is made of, as CycloneDX 1.6: .ci/sbom.py [--features LIST] [--target TRIPLE] PACKAGE >sbom.cdx.json

Every crate that the package links or that runs while it is built, with version, licence, source and the registry's checksum, and which
one needs which. The same commit gives the same bytes.
"""

import argparse
import json
import subprocess
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def cargo(*arguments: str) -> dict:
    told = subprocess.run(["cargo", "metadata", "--locked", "--format-version", "1", *arguments], cwd=ROOT, check=True, stdout=subprocess.PIPE)
    return json.loads(told.stdout)


def reached(metadata: dict, root: str) -> dict[str, list[str]]:
    """Dependencies of every package that a build of `root` needs; those of tests alone are left out."""
    nodes = {node["id"]: node for node in metadata["resolve"]["nodes"]}
    found: dict[str, list[str]] = {}
    ahead = [root]
    while ahead:
        package = ahead.pop()
        if package in found:
            continue
        needed = [
            dependency["pkg"]
            for dependency in nodes[package]["deps"]
            if any(kind["kind"] != "dev" for kind in dependency["dep_kinds"])
        ]
        found[package] = sorted(needed)
        ahead += needed
    return found


def component(package: dict, checksums: dict[tuple[str, str], str]) -> dict:
    name, version = package["name"], package["version"]
    entry = {"type": "library", "bom-ref": f"{name}@{version}", "name": name, "version": version}
    if package["source"]:
        entry["purl"] = f"pkg:cargo/{name}@{version}"
    if checksum := checksums.get((name, version)):
        entry["hashes"] = [{"alg": "SHA-256", "content": checksum}]
    if licence := package.get("license"):
        # An older way to write OR.
        entry["licenses"] = [{"expression": licence.replace("/", " OR ")}]
    return entry


def bill(metadata: dict, lock: dict, name: str) -> dict:
    packages = {package["id"]: package for package in metadata["packages"]}
    checksums = {(entry["name"], entry["version"]): entry["checksum"] for entry in lock["package"] if "checksum" in entry}
    [root] = [package["id"] for package in packages.values() if package["name"] == name and package["source"] is None]
    needs = reached(metadata, root)
    parts = {identity: component(packages[identity], checksums) for identity in needs}
    main = {**parts.pop(root), "type": "application"}
    reference = {identity: f"{packages[identity]['name']}@{packages[identity]['version']}" for identity in needs}
    return {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {"component": main},
        "components": sorted(parts.values(), key=lambda part: part["bom-ref"]),
        "dependencies": sorted(
            ({"ref": reference[of], "dependsOn": sorted({reference[need] for need in needed})} for of, needed in needs.items()),
            key=lambda entry: entry["ref"],
        ),
    }


def main() -> None:
    arguments = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments.add_argument("--features", default="")
    arguments.add_argument("--target", help="leave out what only other platforms need")
    arguments.add_argument("package")
    given = arguments.parse_args()
    features = ["--features", given.features] if given.features else []
    features += ["--filter-platform", given.target] if given.target else []
    lock = tomllib.loads((ROOT / "Cargo.lock").read_text())
    print(json.dumps(bill(cargo(*features), lock, given.package), indent=1))


if __name__ == "__main__":
    main()
