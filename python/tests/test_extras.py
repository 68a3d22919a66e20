"""Where packages of an extra are missing, every module that needs them says which extra to install."""

import subprocess
import sys

import pytest

EXTRAS = {
    "train": ["torch", "rsl_rl", "tensordict", "safetensors", "stable_baselines3"],
    "ray": ["ray"],
    "lerobot": ["lerobot", "zmq", "msgpack", "torchvision"],
    "assets": ["trimesh", "pxr", "scipy", "coacd", "networkx", "PIL", "mujoco"],
}

# Imports one module after the other where no package of an extra can be imported, and prints what each says.
PROBE = """
import importlib, pkgutil, sys
sys.modules.update(dict.fromkeys(sys.argv[1:]))
import fiatlux
for found in sorted(pkgutil.walk_packages(fiatlux.__path__, "fiatlux.", onerror=lambda name: None), key=lambda one: one.name):
    # These start programs.
    if found.name.endswith(("__main__", "._program")):
        continue
    try:
        importlib.import_module(found.name)
    except Exception as error:
        print(found.name, type(error).__name__, error, sep="|")
"""


@pytest.fixture(scope="module")
def said():
    blocked = [package for packages in EXTRAS.values() for package in packages]
    run = subprocess.run([sys.executable, "-c", PROBE, *blocked], capture_output=True, text=True, check=True)
    return {name: (kind, words) for name, kind, words in (line.split("|", 2) for line in run.stdout.splitlines())}


def test_every_module_that_needs_an_extra_says_which(said):
    for module, (kind, words) in said.items():
        extra = next((extra for extra in EXTRAS if f"needs its extra {extra}, but " in words), None)
        assert kind == "ImportError" and extra, f"{module}: {kind}: {words}"
        assert f'pip install "fiatlux[{extra}] @ file://' in words, words
    for module, extra in (
        ("fiatlux.train", "train"),
        ("fiatlux.dagger", "train"),
        ("fiatlux.rsl_rl", "train"),
        ("fiatlux.stable_baselines3", "train"),
        ("fiatlux.ray", "ray"),
        ("fiatlux.assets.build", "assets"),
        ("fiatlux.assets.objects", "assets"),
        ("fiatlux.assets.normalized", "assets"),
        ("fiatlux.assets.pieces", "assets"),
        ("fiatlux.assets.room", "assets"),
        ("fiatlux.assets.unread", "assets"),
        ("fiatlux.assets.verify", "assets"),
    ):
        assert f"extra {extra}" in said[module][1], module


@pytest.mark.parametrize(
    ("command", "extra", "code"),
    [
        (["fiatlux.train", "--help"], "train", 1),
        (["fiatlux.dagger", "--help"], "train", 1),
        (["fiatlux.lerobot", "--check"], "lerobot", 1),
        (["fiatlux.assets", "examples", "six"], "assets", 1),
    ],
)
def test_commands_say_it_too(command, extra, code, tmp_path):
    blocked = [package for packages in EXTRAS.values() for package in packages]
    start = f"import sys, runpy; sys.modules.update(dict.fromkeys({blocked})); sys.argv = {command!r}; "
    start += "runpy.run_module(sys.argv[0], run_name='__main__', alter_sys=True)"
    run = subprocess.run([sys.executable, "-c", start], capture_output=True, text=True, cwd=tmp_path)
    assert run.returncode == code and f"needs its extra {extra}, but" in run.stderr, run.stderr
