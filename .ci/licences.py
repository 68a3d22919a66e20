#!/usr/bin/env python3
"""Checks what the lock file brings in against `deny.toml`: licences, banned crates, and where crates come from.

A part of what `cargo deny check licenses bans sources` does, over `cargo metadata` and with nothing to install. A rule of
`deny.toml` that is not applied here is refused, so that none is lost in silence. Licence texts are not compared.
"""

import json
import re
import subprocess
import sys
import tomllib
from pathlib import Path

REGISTRY = "registry+https://github.com/rust-lang/crates.io-index"
# Rules that are applied here, and rules of cargo-deny alone: it warns, or compares texts and asks for advisories.
APPLIED = {
    "licenses": {"allow", "exceptions"},
    "bans": {"deny", "wildcards", "allow-wildcard-paths"},
    "sources": {"unknown-registry", "unknown-git"},
}
LEFT = {
    "graph": {"all-features"},
    "licenses": {"unused-allowed-license", "confidence-threshold"},
    "bans": {"multiple-versions"},
    "advisories": {"yanked"},
}


def is_allowed(expression, allowed):
    """True if an SPDX expression can be met with the allowed licences; `WITH` belongs to its licence, `/` is an old `OR`.

    Raises ValueError for what is not an expression.
    """
    words = re.findall(r"[()]|[^\s()]+", expression.replace("/", " OR "))

    def take():
        return words.pop(0) if words else ""

    def single():
        word = take()
        if word == "(":
            met = either()
            if take() != ")":
                raise ValueError(expression)
            return met
        if not word or word in (")", "AND", "OR", "WITH"):
            raise ValueError(expression)
        if words and words[0] == "WITH":
            word += f" {take()} {take()}"
        return word in allowed

    def both():
        met = single()
        while words and words[0] == "AND":
            take()
            met &= single()
        return met

    def either():
        met = both()
        while words and words[0] == "OR":
            take()
            met |= both()
        return met

    met = either()
    if words:
        raise ValueError(expression)
    return met


def unapplied(rules):
    """Rules of a `deny.toml` that neither this nor a warning of cargo-deny stands for."""
    for section, keys in rules.items():
        for key in keys:
            if key not in APPLIED.get(section, set()) | LEFT.get(section, set()):
                yield f"deny.toml: {section}.{key} is not applied: add it to .ci/licences.py"
    for section, key in (("sources", "unknown-registry"), ("sources", "unknown-git"), ("bans", "wildcards")):
        if rules[section][key] != "deny":
            yield f"deny.toml: {section}.{key} must be \"deny\""


def faults(rules, packages):
    """Violations of the rules by the packages of `cargo metadata`, one line each."""
    licenses = rules["licenses"]
    exceptions = {entry["crate"]: entry["allow"] for entry in licenses.get("exceptions", [])}
    banned = {entry["crate"]: entry["reason"] for entry in rules["bans"]["deny"]}
    for package in packages:
        name = f"{package['name']} {package['version']}"
        expression = package["license"]
        allowed = {*licenses["allow"], *exceptions.get(package["name"], [])}
        try:
            if not is_allowed(expression or "", allowed):
                yield f"{name}: licence {expression} is not allowed"
        except ValueError:
            yield f"{name}: licence {expression!r} is not an SPDX expression"
        if package["name"] in banned:
            yield f"{name}: banned: {banned[package['name']]}"
        if package["source"] not in (None, REGISTRY):
            yield f"{name}: source {package['source']} is not crates.io"
        if package["source"] is None:
            for dependency in package["dependencies"]:
                if dependency["req"] == "*" and dependency.get("path") is None:
                    yield f"{name}: {dependency['name']} = \"*\" accepts every version"


def main():
    rules = tomllib.loads(Path("deny.toml").read_text())
    command = ["cargo", "metadata", "--format-version", "1", "--locked", "--all-features"]
    metadata = json.loads(subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout)
    found = [*unapplied(rules), *faults(rules, metadata["packages"])]
    if found:
        sys.exit("\n".join(found))
    print(f"{len(metadata['packages'])} packages")


if __name__ == "__main__":
    main()
