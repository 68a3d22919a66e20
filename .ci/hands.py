#!/usr/bin/env python3
"""Fails where a file names a robot's hands: only data, weights, tests and prose may, so that a robot is added by its data alone.

The names are those of the robots' files. Tests inside a file of code are left out.
"""

import re
import subprocess
import sys
from pathlib import Path

import circles

ROBOTS = "crates/robot/robots"
# Numbers and names of the robots, of their hands, and of skills, models and controllers made for them.
DATA = re.compile(
    rf"{ROBOTS}/.*|crates/rules/pins/.*\.in|crates/bridge/(hands|mappings)/.*|crates/policies/src/hands/.*\.toml"
    r"|crates/teleop/src/grip\.toml|crates/unitree/src/hands\.toml|crates/render/src/robot_meshes/aliases\.txt"
    # Names that type checkers read; a test compares them with the robots' files.
    r"|python/fiatlux/_robots\.py"
)
WEIGHTS = re.compile(r"(.*/)?weights/.*")
TESTS = re.compile(r"(.*/)?tests/.*|.*[/_]tests\.rs|\.ci/.*")
PROSE = re.compile(r".*\.md|mkdocs\.yml|docs/figures\.toml|NOTICE|cspell\.yaml|typos\.toml")
# A module of tests that stands in the file itself.
OWN_TESTS = re.compile(r"#\[cfg\(test\)\]\s*(?:#\[[^\]]*\]\s*)*(?:pub(?:\([^)]*\))?\s+)?mod\s+\w+\s*\{")


def hands(texts):
    """Names of the hands in robots' files. A robot made from another one has no fingers, or hands of that one's name with something after it."""
    whole = (text for text in texts if not re.search(r"^base = ", text, re.MULTILINE))
    return sorted(name for text in whole for name in re.findall(r'^hand = "(\w+)"$', text, re.MULTILINE))


def is_free(path):
    """True if a file may name hands."""
    return any(kind.fullmatch(path) for kind in (DATA, WEIGHTS, TESTS, PROSE))


def without_own_tests(text):
    while found := OWN_TESTS.search(text):
        # Lines stay where they are.
        end = circles.end_of_block(text, found.start())
        text = text[: found.start()] + "\n" * text.count("\n", found.start(), end) + text[end:]
    return text


def faults(names, path, text):
    """Each line of a file that names hands: its path, its number and the name."""
    if is_free(path):
        return
    word = re.compile("|".join(map(re.escape, names)), re.IGNORECASE)
    if word.search(path):
        yield f"{path}: its name says {word.search(path)[0]}"
    for number, line in enumerate(without_own_tests(text).splitlines(), 1):
        if found := word.search(line):
            yield f"{path}:{number}: {found[0]}"


def main():
    names = hands(file.read_text() for file in sorted(Path(ROBOTS).glob("*.toml")))
    if not names:
        sys.exit(f"no robot of {ROBOTS} has hands: correct .ci/hands.py")
    listed = subprocess.run(["git", "ls-files", "-z"], check=True, stdout=subprocess.PIPE, text=True).stdout
    found = []
    for path in listed.split("\0")[:-1]:
        try:
            found += faults(names, path, Path(path).read_text())
        except (UnicodeDecodeError, FileNotFoundError, IsADirectoryError):
            continue
    print(f"{', '.join(names)}: {len(found)} lines name them outside data, weights, tests and prose")
    if found:
        sys.exit("\n".join([*found, "move what they say into the robot's data, or say it without the name"]))


if __name__ == "__main__":
    main()
