"""Runs the programs inside the package's library, as the commands that a wheel installs."""

import importlib.util
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import fiatlux
import pytest
from fiatlux import _native

PROGRAMS = ("fiatlux", "sim-server", "recorder", "policy-client", "scorer")

pytestmark = pytest.mark.skipif(
    not hasattr(_native, "run_program"), reason="the library has no programs: maturin build --features programs"
)


@pytest.fixture(scope="module")
def commands(tmp_path_factory):
    """A folder with the scripts that `wheel.sh` makes."""
    folder = tmp_path_factory.mktemp("bin")
    source = Path(fiatlux.__file__).with_name("_program.py").read_text()
    for name in PROGRAMS:
        (folder / name).write_text(f"#!{sys.executable}\n{source}")
        (folder / name).chmod(0o755)
    return folder


def run(command, *arguments, **options):
    return subprocess.run([command, *arguments], capture_output=True, text=True, timeout=120, **options)


def test_the_launcher_is_a_module():
    said = run(sys.executable, "-m", "fiatlux", "--version")
    assert (said.returncode, said.stdout) == (0, f"fiatlux {fiatlux.__version__}\n")


@pytest.mark.parametrize("name", PROGRAMS)
def test_each_goes_by_its_name(commands, name):
    said = run(commands / name, "--version")
    assert (said.returncode, said.stdout) == (0, f"{name} {fiatlux.__version__}\n"), said.stderr
    usage = run(commands / name, "--help").stdout
    assert f"Usage: {name} " in usage and "Example" in usage
    wrong = run(commands / name, "--no-such-flag")
    assert wrong.returncode == 2 and wrong.stdout == "" and "--no-such-flag" in wrong.stderr


def test_they_load_neither_the_package_nor_numpy(commands):
    said = run(sys.executable, "-X", "importtime", commands / "scorer", "--version").stderr
    assert "signal" in said and "numpy" not in said and "gymnasium" not in said


def test_results_errors_and_names_of_any_bytes(commands, tmp_path):
    # Not every name of a file is text.
    folder = os.fsencode(tmp_path) + b"/run-\xff"
    played = run(
        commands / "fiatlux", "evaluate", "--policy", "zero", "--tasks", "S05", "--seeds", "1000", "--out", folder
    )
    assert played.returncode == 0 and "S05" in played.stdout, played.stderr
    assert run(commands / "scorer", "grade", folder).returncode == 0
    missing = run(commands / "scorer", "grade", tmp_path / "nothing")
    assert missing.returncode == 1 and missing.stdout == "" and missing.stderr.startswith("error: ")
    with open("/dev/full", "w") as full:
        lost = subprocess.run([commands / "fiatlux", "tasks"], stdout=full, stderr=subprocess.PIPE, timeout=120)
    assert lost.returncode == 1 and b"stdout" in lost.stderr


@pytest.mark.parametrize("closed", ["<&-", ">&-", "2>&-", "<&- >&- 2>&-"])
def test_nothing_is_printed_into_a_file(commands, tmp_path, closed):
    command = f"exec {commands / 'fiatlux'} evaluate --policy zero --tasks S08 --seeds 1000 --out run {closed}"
    assert subprocess.run(["bash", "-c", command], cwd=tmp_path, timeout=120).returncode == 0
    assert json.loads((tmp_path / "run" / "results.json").read_text())["episodes"]
    [bag] = fiatlux.Bag.below(tmp_path / "run")
    assert bag.is_whole and run(commands / "scorer", "grade", tmp_path / "run").returncode == 0


def test_settings_files_are_read(commands, tmp_path):
    file = tmp_path / "server.toml"
    file.write_text("workers = -1\n")
    refused = run(commands / "sim-server", "--settings", file)
    assert refused.returncode == 2 and "server.toml" in refused.stderr


@pytest.mark.parametrize("sent, code", [(signal.SIGINT, 0), (signal.SIGTERM, 0), (signal.SIGKILL, -signal.SIGKILL)])
def test_signals_end_a_server(commands, sent, code):
    server = subprocess.Popen(
        [commands / "sim-server", "-l", "tcp/127.0.0.1:0", "--name", f"signals-{sent}"],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    assert server.stdout is not None
    assert b"listening" in server.stdout.readline()
    server.send_signal(sent)
    assert server.wait(60) == code
    server.stdout.close()


def test_ctrl_c_ends_an_evaluation_and_the_same_command_continues(commands, tmp_path):
    command = [
        commands / "fiatlux",
        "evaluate",
        "--policy",
        "stand",
        "--tasks",
        "S05",
        "--seeds",
        "1000..1003",
        "--out",
        tmp_path / "run",
    ]
    playing = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    began = time.monotonic()
    while not list(tmp_path.rglob("*.mcap*")):
        assert playing.poll() is None and time.monotonic() - began < 60
        time.sleep(0.05)
    playing.send_signal(signal.SIGINT)
    assert playing.wait(60) == 3
    played = lambda: len(json.loads((tmp_path / "run" / "results.json").read_text())["episodes"])  # noqa: E731
    assert not (tmp_path / "run" / "results.json").exists() or played() < 4
    assert run(*command).returncode == 0 and played() == 4


def test_a_name_of_its_own_is_the_launcher(commands, tmp_path):
    copy = tmp_path / "fx"
    copy.write_bytes((commands / "fiatlux").read_bytes())
    copy.chmod(0o755)
    assert run(copy, "--version").stdout == f"fiatlux {fiatlux.__version__}\n"


def test_a_library_without_programs_says_what_to_install(commands, tmp_path):
    (tmp_path / "fiatlux").mkdir()
    (tmp_path / "fiatlux" / "__init__.py").write_text("")
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    refused = run(commands / "scorer", "--version", env=environment)
    assert refused.returncode == 1 and "python/wheel.sh" in refused.stderr
    assert importlib.util.find_spec("fiatlux") is not None
