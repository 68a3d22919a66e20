#!/usr/bin/env python3
"""Fails where a number of the room stands as a literal outside its home, the scene: a copy stays behind when the room changes.

A number counts with at least three significant digits and four decimal places, a list of numbers with an entry of three digits:
shorter ones stand for much else. Angles of the grasp's fingers count, whole degrees do not. Rust takes the numbers from
`fiatlux_room`.
"""

import math
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import hands

HOME = "crates/world/scene.toml"
# Data and code of other things that have such a number by themselves.
OTHERS = re.compile(
    rf"{hands.ROBOTS}/.*|(.*/)?weights/.*|crates/world/src/object/built/.*|crates/render/src/visuals/g1\.rs|crates/rules/manifest\.toml|.*\.lock"
    # Objects of their own, made for the table of feasibility.
    r"|python/fiatlux/assets/objects\.py"
)
CODE = (".rs", ".py", ".toml", ".js", ".ts")
NUMBER = r"-?\d[\d_]*(?:\.[\d_]*)?(?:e-?\d+)?"
LITERAL = re.compile(rf"(?<![\w.]){NUMBER}(?![\w.])")
LIST = re.compile(rf"[\[(]\s*({NUMBER}(?:\s*,\s*{NUMBER})+)\s*,?\s*[\])]")


def digits(number):
    """Significant digits and decimal places."""
    mantissa = f"{abs(number):.10g}"
    whole, _, part = mantissa.partition(".")
    return len((whole + part).lstrip("0")), len(part)


def is_degrees(number):
    return abs(number) > 0 and math.isclose(math.degrees(number), round(math.degrees(number)), abs_tol=1e-9)


def named(values, path=()):
    """Numbers and lists of numbers of a table, with their names."""
    for name, value in values.items():
        here = (*path, name)
        if here[:2] == ("start", "carry") and here[2:3] not in [(), ("grip",)]:
            continue
        if isinstance(value, dict):
            yield from named(value, here)
        elif isinstance(value, list) and value and isinstance(value[0], list):
            for index, entry in enumerate(value):
                yield from named({f"{name}[{index}]": entry}, path)
        elif isinstance(value, list) and all(isinstance(entry, float | int) for entry in value):
            if max((digits(entry)[0] for entry in value), default=0) >= 3 and len(value) > 1:
                yield ".".join(here), tuple(map(float, value))
            yield from ((".".join(here), float(entry)) for entry in value if counts(entry))
        elif isinstance(value, float) and counts(value):
            yield ".".join(here), value


def counts(number):
    significant, places = digits(number)
    return significant >= 3 and places >= 4 and not is_degrees(number)


def read(literal):
    return float(literal.replace("_", ""))


def faults(numbers, path, text):
    """Each line of a file that has a number of the room: its path, its number, the literal and the number's name."""
    is_free = path == HOME or OTHERS.fullmatch(path) or hands.TESTS.fullmatch(path)
    if is_free or not path.endswith(CODE):
        return
    comment = "#" if path.endswith((".py", ".toml")) else "//"
    for number, line in enumerate(hands.without_own_tests(text).splitlines(), 1):
        code = line.partition(comment)[0]
        lists = [(found[0], tuple(map(read, found[1].split(",")))) for found in LIST.finditer(code)]
        for literal, value in [*lists, *((found[0], read(found[0])) for found in LITERAL.finditer(code))]:
            if name := numbers.get(value):
                yield f"{path}:{number}: {literal} is {name}"


def main():
    scene = tomllib.loads(Path(HOME).read_text())
    numbers = {value: name for name, value in reversed(list(named(scene)))}
    if not numbers:
        sys.exit(f"{HOME} has no numbers: correct .ci/room.py")
    listed = subprocess.run(["git", "ls-files", "-z"], check=True, stdout=subprocess.PIPE, text=True).stdout
    found = []
    for path in listed.split("\0")[:-1]:
        try:
            found += faults(numbers, path, Path(path).read_text())
        except (UnicodeDecodeError, FileNotFoundError, IsADirectoryError):
            continue
    print(f"{len(numbers)} numbers of the room: {len(found)} literals outside {HOME}")
    if found:
        sys.exit("\n".join([*found, "take them from fiatlux_room, or from what the session tells"]))


if __name__ == "__main__":
    main()
