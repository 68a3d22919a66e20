#!/usr/bin/env python3
"""Fails where something that has one home in the code is made a second time: a copy stays behind when the first one changes.

Each home is told by what only it needs to call. Tests and the crate that defines the call are left out.
"""

import re
import subprocess
import sys
from pathlib import Path

import hands

# What it is, what only its home calls, and the files that may.
HOMES = [
    (
        "an episode as its robot lives it: delay, noise, the whole-body controller",
        r"\bNoiseSeed::of\(|(?<!::)\bdelay_steps\(|\bnoise_scale\(|\bWholeBody::take_over\(",
        r"crates/play/.*|crates/(sensing|world)/.*|python/src/settings\.rs",
    ),
    (
        "a server with its recorder in one process",
        r"\bRecorder::start\(",
        r"crates/server/src/(local|server/shell)\.rs|sim-server/src/recorder\.rs",
    ),
    (
        "an arm that reaches",
        r"\bInverseKinematics::new\(",
        # The right arm of `hands` keeps clear of a room. Plans of the ladder move the whole body, and Python asks by itself.
        r"crates/skills/src/reach\.rs|crates/policies/src/hands/arm\.rs|crates/kinematics/.*|crates/climb/.*|python/src/kinematics\.rs",
    ),
    (
        "fingers: whose they are by their names, and how hard they press",
        r'"thumb", *"index"|\[\["L_", *"left_"\]|\bbulb_grasp\(\)|\btorque \w*/ .*stiffness',
        r"crates/skills/src/grip\.rs|crates/robot/.*|crates/world/.*|crates/mjcf/src/grasp\.rs|crates/policies/src/hands/side\.rs",
    ),
    (
        "a walk to a place: its gain, its slew, the turn that is left",
        r"\bfn (steps_to|wrapped|slew\w*)\(|\bstruct Slew\b|\bconst GAIN: f64\b",
        # Text is wrapped, too.
        r"crates/skills/src/(walker|path)\.rs|crates/grading/src/tables/text\.rs",
    ),
    (
        "how often a skill tries again, and what then",
        r"\bstruct Retries\b|\bconst MAX_(BLOCKS|LOOKS|DOUBLINGS|RETRIES)\b",
        r"crates/policies/src/hands/retries\.rs",
    ),
    (
        "the phases of a skill, their clock and their log",
        r"\bphase: Phase\b|\bfn is_over\(&self\) -> bool;",
        # Sessions and takes have phases of their own: protocols, not skills.
        r"crates/skills/src/phases\.rs|crates/(session|teleop)/src/.*",
    ),
    (
        "the rays of a LiDAR's scan",
        r"\bconst (LIDAR_)?(ROWS: usize = 32|COLUMNS: usize = 180|RAYS: usize)\b",
        r"crates/robot/src/lidar\.rs",
    ),
    (
        "the joints of the robot's body",
        r"\bconst \w+: usize = (29|15)\b",
        r"crates/robot/src/groups\.rs",
    ),
    (
        "opening a file that others name, which may be a pipe or never end",
        r"(?<!fiatlux_files::)\bFile::open\(|\bfs::read(_to_string)?\(|\bfrom_pem_file\(",
        # Files that a program made itself, folders that are synced, and what the system says of the machine. In Python, `File` is a bag.
        r"crates/files/.*|crates/bag/src/(thin|run/writer)\.rs|crates/server/src/server/runs/(attempt|siblings)\.rs"
        r"|crates/leaderboard/src/(jobs/server|pages/episode|store/blobs)\.rs|crates/replay/src/answers\.rs|crates/tls/src/certificate\.rs"
        r"|crates/cli/src/settings\.rs|bench/src/(camera|machine)\.rs|fiatlux/src/demonstrate_command/lerobot\.rs|python/src/bag\.rs|(.*/)?build\.rs|.*/examples/.*",
    ),
    (
        "writing to stdout or stderr, whose reader may have left or whose disk may be full",
        r"\be?print(ln)?!|\bdbg!|\bio::std(out|err)\(",
        r"crates/cli/.*|(.*/)?build\.rs|.*/(examples|benches)/.*",
    ),
]


def faults(path, text):
    """Each line of a file that makes what has its home elsewhere."""
    if not path.endswith(".rs") or hands.TESTS.fullmatch(path):
        return
    for number, line in enumerate(hands.without_own_tests(text).splitlines(), 1):
        code = line.partition("//")[0]
        for what, call, home in HOMES:
            if (found := re.search(call, code)) and not re.fullmatch(home, path):
                yield f"{path}:{number}: {found[0].strip()} is {what}"


def main():
    listed = subprocess.run(["git", "ls-files", "-z"], check=True, stdout=subprocess.PIPE, text=True).stdout
    files = {
        path: Path(path).read_text()
        for path in listed.split("\0")[:-1]
        if path.endswith(".rs") and Path(path).is_file()
    }
    for what, call, home in HOMES:
        if not any(re.fullmatch(home, path) and re.search(call, text) for path, text in files.items()):
            sys.exit(f"nothing calls {call} for {what}: correct .ci/homes.py")
    found = [fault for path, text in files.items() for fault in faults(path, text)]
    print(f"{len(HOMES)} homes: {len(found)} calls outside of them")
    if found:
        sys.exit("\n".join([*found, "use what is there, or say in .ci/homes.py why it has two"]))


if __name__ == "__main__":
    main()
