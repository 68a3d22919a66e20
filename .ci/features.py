#!/usr/bin/env python3
"""Fails where two builds would compile the same crate with other features, and so compile it twice, or where a build grows.

Each entry is a build that follows another one in the same target folder. Both are asked for their unit graphs, which name
every compilation, so nothing is compiled here. Cargo calls the option unstable; it prints JSON and changes no build.
"""

import json
import os
import subprocess
import sys

# An entry, and the build before it in whose target folder it should find what it shares with it.
ENTRIES = {
    "launcher": ["build", "--release"],
    "programs": ["build", "--release", "--workspace", "--bins"],
    "wheel": ["build", "--release", "--manifest-path", "python/Cargo.toml", "--lib", "--features", "programs"],
    "benchmarks": ["build", "--release", "--package", "fiatlux-bench"],
    "example of a policy": ["build", "--release", "--package", "policy-client", "--example", "wave"],
    "tests": ["test", "--workspace"],
    "programs of tests": ["build", "--workspace", "--bins", "--features", "network,rapier"],
    "wheel of tests": ["build", "--manifest-path", "python/Cargo.toml", "--lib", "--features", "programs"],
    "lints": ["check", "--workspace", "--all-targets", "--features", "fiatlux-unify/dds"],
    "lints of DDS": [
        *["check", "--package", "sim-server", "--package", "policy-client", "--package", "fiatlux-unify"],
        *["--features", "sim-server/unitree,policy-client/unitree,fiatlux-unify/dds"],
    ],
    "documentation": ["doc", "--workspace", "--no-deps", "--features", "fiatlux-unify/dds"],
}
PAIRS = [
    ("launcher", "programs"),
    ("wheel", "programs"),
    ("benchmarks", "programs"),
    ("example of a policy", "programs"),
    ("programs of tests", "tests"),
    ("wheel of tests", "tests"),
    ("lints of DDS", "lints"),
    ("documentation", "lints"),
]
# A first build takes four minutes, and all programs as long again, at 329 and 667 compilations. Times differ between machines;
# these numbers do not.
MAX_COMPILATIONS = {"launcher": 346, "programs": 706}
# Compiled for a wheel with programs anew, in seconds: the launcher's library, whose own first build has no other programs in it. For
# DDS, what speaks it.
TWICE = {
    "wheel": ("fiatlux#",),
    "wheel of tests": ("fiatlux#",),
    "lints of DDS": ("policy-client#", "sim-server#", "unitree#"),
}
# Two unlike builds have fewer crates in common than this: then the comparison says nothing.
FEWEST_IN_COMMON = 100


def units(arguments):
    """Features of each compilation, by package, target, mode and profile: a build script's crates differ from a program's."""
    command = ["cargo", *arguments, "--locked", "--unit-graph", "-Z", "unstable-options"]
    environment = {**os.environ, "RUSTC_BOOTSTRAP": "1"}
    graph = json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE, env=environment).stdout)
    found = {}
    for unit in graph["units"]:
        profile = {name: value for name, value in unit["profile"].items() if name != "name"}
        target = (unit["target"]["name"], unit["target"]["kind"][0], unit["mode"])
        key = (unit["pkg_id"], target, json.dumps(profile, sort_keys=True))
        found.setdefault(key, set()).add(frozenset(unit["features"]))
    return found


def differences(entry, reference):
    """Lines that name each crate of an entry whose features the reference does not have, and the number compared."""
    common = entry.keys() & reference.keys()
    lines = set()
    for key in common:
        known = min(reference[key], key=sorted)
        for features in entry[key] - reference[key]:
            name = key[0].rpartition("/")[2]
            lines.add(f"{name}: without {sorted(known - features)}, with {sorted(features - known)}")
    return sorted(lines), len(common)


def main():
    graphs = {name: units(arguments) for name, arguments in ENTRIES.items()}
    failed = False
    for entry, reference in PAIRS:
        lines, common = differences(graphs[entry], graphs[reference])
        lines = [line for line in lines if not line.startswith(TWICE.get(entry, ()))]
        print(f"{entry} and {reference}: {common} compilations in common, {len(lines)} crates with other features")
        for line in lines:
            print(f"  {line}")
        failed |= bool(lines) or common < FEWEST_IN_COMMON
    for entry, most in MAX_COMPILATIONS.items():
        print(f"{entry}: {len(graphs[entry])} compilations, {most} at most")
        if len(graphs[entry]) > most:
            sys.exit(f"{entry}: leave dependencies out or behind a feature; if it is worth the minutes, raise MAX_COMPILATIONS")
    if failed:
        sys.exit("the crates above are compiled twice: ask for the same features of them in crates/unify/Cargo.toml")


if __name__ == "__main__":
    main()
