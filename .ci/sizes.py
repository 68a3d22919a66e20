#!/usr/bin/env python3
"""Fails where a file of Rust has more than 500 lines, or a function outside tests more than 100: look for the second idea in it.

Functions of tests may be longer: many are lists of cases.
"""

import re
import subprocess
import sys
from pathlib import Path

import hands

MAX_FILE = 500
MAX_FUNCTION = 100
# Each may keep what it has, and no more: lines of the file, and of its longest function.
LARGER = {
    # Motion whose numbers are being searched.
    "crates/policies/src/ladder.rs": (700, 125),
    "crates/policies/src/see/reckoning.rs": (700, 100),
    # One loop against a robot's clock.
    "crates/unitree/src/deployment.rs": (MAX_FILE, 131),
}
FUNCTION = re.compile(r"(\s*)(?:pub(?:\([^)]*\))? )?(?:const )?(?:async )?(?:unsafe )?(?:extern \"C\" )?fn (\w+)")


def functions(text):
    """Name, first line and number of lines of each function, as `cargo fmt` lays it out: its end has its beginning's indent."""
    lines = text.splitlines()
    for start, line in enumerate(lines):
        if not (found := FUNCTION.match(line)):
            continue
        signature = next(index for index in range(start, len(lines)) if lines[index].endswith(("{", ";", "}")))
        # Without it: one of a trait, or of one line.
        if lines[signature].endswith("{"):
            end = lines.index(f"{found[1]}}}", signature)
            yield found[2], start + 1, end - start + 1


def faults(path, text):
    most, longest = LARGER.get(path, (MAX_FILE, MAX_FUNCTION))
    if (length := len(text.splitlines())) > most:
        yield f"{path}: {length} lines, at most {most}"
    if hands.TESTS.fullmatch(path):
        return
    for name, line, length in functions(hands.without_own_tests(text)):
        if length > longest:
            yield f"{path}:{line}: {name} has {length} lines, at most {longest}"


def main():
    listed = subprocess.run(["git", "ls-files", "-z", "*.rs"], check=True, stdout=subprocess.PIPE, text=True).stdout
    files = [path for path in listed.split("\0")[:-1] if Path(path).is_file()]
    found = [fault for path in files for fault in faults(path, Path(path).read_text())]
    print(f"{len(files)} files of Rust: {len(found)} files and functions that are too long")
    if found:
        sys.exit("\n".join(found))


if __name__ == "__main__":
    main()
