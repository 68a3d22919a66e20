#!/usr/bin/env python3
"""Fails where a picture of the head camera takes more instructions than it did. Needs Linux, a processor with AVX2 and valgrind.

    python3 .ci/instructions.py [PROGRAM]

PROGRAM is the example `count_frames` of a development build, which is made where none is named. Times depend on the machine and its
load; counts of a build by the pinned compiler do not. A gain is entered below.
"""

import os
import re
import subprocess
import sys
import tempfile

# Millions of instructions of a picture, the mean of six starts, in a development build with AVX2.
MILLIONS = {(64, 64): 4.72, (128, 128): 9.67, (256, 256): 27.3, (640, 480): 105.1}
# More by this share fails.
TOLERANCE = 0.05
# A count below this share is no gain: the drawing function was not found, or it calls another one that the pattern names, which ends the count.
FEWEST = 0.5
STARTS = 6


def count(program: str, size: tuple[int, int]) -> float:
    with tempfile.TemporaryDirectory() as folder:
        valgrind = ["valgrind", "--tool=callgrind", f"--callgrind-out-file={folder}/out", "--collect-atstart=no"]
        command = [*valgrind, "--toggle-collect=*Renderer::render_to*", program, *map(str, size)]
        said = subprocess.run(command, check=True, capture_output=True, text=True).stderr
    found = re.search(r"Collected : (\d+)", said)
    if found is None or found[1] == "0":
        sys.exit(f"valgrind counted nothing:\n{said}")
    return int(found[1]) / STARTS / 1e6


def built() -> str:
    build = ["cargo", "build", "--locked", "-p", "fiatlux-render", "--example", "count_frames"]
    # Counts depend on how a crate is cut into units.
    subprocess.run(build, check=True, env={**os.environ, "CARGO_INCREMENTAL": "0"})
    target = subprocess.run(["cargo", "metadata", "--format-version=1", "--no-deps"], check=True, capture_output=True)
    folder = re.search(r'"target_directory":"([^"]+)"', target.stdout.decode())[1]
    return f"{folder}/debug/examples/count_frames"


def main() -> None:
    program = sys.argv[1] if len(sys.argv) > 1 else built()
    failed = False
    for size, expected in MILLIONS.items():
        found = count(program, size)
        name = f"{size[0]}x{size[1]}"
        print(f"{name}: {found:.2f} million instructions a picture, expected {expected}")
        if found < FEWEST * expected:
            sys.exit("too few for a picture: --toggle-collect must name the function that draws, and none that it calls")
        failed |= found > expected * (1 + TOLERANCE)
    if failed:
        sys.exit("a picture takes more instructions than it did: find out why, or enter the new count with its reason")


if __name__ == "__main__":
    main()
