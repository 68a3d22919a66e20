"""Tests that the scripts of `benchmarks/` run, in short forms. Those that compare with MuJoCo are skipped without it.

`FIATLUX_TEST_RUN` names a folder of bags, `FIATLUX_PROGRAMS` one with built programs and, below it, `examples`.
"""

import importlib.util
import json
import os
import pathlib
import subprocess
import sys

import pytest

SCRIPTS = pathlib.Path(__file__).resolve().parents[1] / "benchmarks"
RUN, PROGRAMS = (
    os.environ.get(name) and os.path.abspath(os.environ[name]) for name in ("FIATLUX_TEST_RUN", "FIATLUX_PROGRAMS")
)
DRIVE = PROGRAMS and f"{PROGRAMS}/examples/drive"
CURVE = SCRIPTS.parents[1] / "crates/wbc/weights/curve.csv"
SHORT = {
    "curves.py": [str(CURVE), os.devnull, "reward a second=reward"],
    "vector.py": ["--worlds", "4", "--threads", "1", "--steps", "1", "--rounds", "1"],
    "pictures.py": ["--worlds", "2", "--rounds", "1", "--many", "2"],
    "labels.py": ["--tasks", "S07", "--worlds", "2", "--steps", "2"],
    "stand_and_reach.py": ["--episodes", "1", "--reaches", "1"],
    "motors.py": [RUN],
    "mujoco_rollout.py": ["--worlds", "8", "--threads", "1", "--steps", "1", "--rounds", "1"],
    "walk_in_mujoco.py": ["--episodes", "1"],
    "policy_in_mujoco.py": [
        "hands",
        "--tasks",
        "S08",
        "S11",
        "--rooms",
        "1",
        "--steps",
        "100",
        "--impratio",
        "100",
        "--program",
        DRIVE,
    ],
    "warp_pictures.py": ["--worlds", "2", "--size", "32", "32", "--frames", "1"],
}


def test_every_script_is_tried():
    assert {path.name for path in SCRIPTS.glob("*.py")} == SHORT.keys()


@pytest.mark.parametrize("name", SHORT)
def test_it_runs(name, tmp_path):
    if name == "warp_pictures.py" and importlib.util.find_spec("mujoco_warp") is None:
        pytest.skip("mujoco_warp is not installed")
    if "mujoco" in name and importlib.util.find_spec("mujoco") is None and "FIATLUX_EXTRAS" not in os.environ:
        pytest.skip("the extra mujoco is not installed")
    if name == "pictures.py" and not os.path.exists("/proc/self/status"):
        pytest.skip("memory is read from Linux's /proc")
    if None in SHORT[name]:
        pytest.skip("FIATLUX_TEST_RUN or FIATLUX_PROGRAMS is not set")
    command = [sys.executable, SCRIPTS / name, *SHORT[name], "--json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert isinstance(json.loads(done.stdout), dict)
