"""Tests the client against a server in a process of its own.

`FIATLUX_TEST_SERVER` names the program `sim-server`.
"""

import os
import pathlib
import re
import socket
import subprocess
import sys

import fiatlux
import numpy as np
import pytest

SERVER = os.environ.get("FIATLUX_TEST_SERVER", "")
pytestmark = pytest.mark.skipif(not SERVER, reason="FIATLUX_TEST_SERVER is not set")


class Waver:
    def reset(self, info):
        self.rng = np.random.default_rng(info["seed"])

    def __call__(self, observation):
        return self.rng.uniform(-0.1, 0.1, 53)


class Server:
    def __init__(self, folder: pathlib.Path, port: int, *flags: str) -> None:
        self.endpoint = f"tcp/127.0.0.1:{port}"
        command = [SERVER, "-l", self.endpoint, "--name", "lab", "--record", str(folder), *flags]
        self.log = folder.with_suffix(".log")
        with self.log.open("w") as log:
            self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, text=True)
        # It prints a line when it can be reached.
        assert self.process.stdout is not None and self.process.stdout.readline()

    def kill(self) -> None:
        self.process.kill()
        self.process.wait()
        assert self.process.stdout is not None
        self.process.stdout.close()


def free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


@pytest.fixture
def server(tmp_path):
    server = Server(tmp_path / "bags", free_port())
    yield server
    server.kill()


def test_an_episode_is_the_one_of_this_process(server):
    plain = fiatlux.evaluate(Waver, ["S05"], [3])
    client = fiatlux.Client(server.endpoint)
    assert repr(client) == f"<fiatlux.Client of {server.endpoint}>"
    end = client.run(Waver, "S05", seed=3)
    # A session tells what the judge says that ended it.
    for name, theirs in (("end", "strict_end"), ("steps", "strict_steps"), ("success", "strict_success")):
        assert end[name] == plain.episodes[0][theirs], name
    assert end["state_digest"] == plain.episodes[0]["state_digest"]
    with pytest.raises(fiatlux.FiatluxError, match="server 'west' was not found"):
        client.run(Waver, "S05", server="west")
    with pytest.raises(RuntimeError, match="out of memory"):
        client.run(fail, "S05")


def fail(observation):
    raise RuntimeError("out of memory")


def test_a_run_goes_on_after_its_server_was_killed(server, tmp_path):
    """The run is stopped in its second episode, its server is killed, and another server takes over its folder."""
    tasks, seeds, begun = ["S05"], [0, 1, 2], []

    class Stopped(Waver):
        def reset(self, info):
            super().reset(info)
            begun.append(info["seed"])
            if begun == [0, 1]:
                raise KeyboardInterrupt

    settings = {"run_file": tmp_path / "RUN.toml", "parallel": 1, "name": "waver"}
    with pytest.raises(KeyboardInterrupt):
        fiatlux.Client(server.endpoint).evaluate(Stopped, tasks, seeds, **settings)
    server.kill()
    again = Server(tmp_path / "bags", free_port())
    try:
        told = []
        run = fiatlux.Client(again.endpoint).evaluate(Stopped, tasks, seeds, progress=told.append, **settings)
    finally:
        again.kill()
    assert begun == [0, 1, 1, 2] and run["finished"] and told[-1]["done"] == 3
    plain = fiatlux.evaluate(Waver, tasks, seeds)
    assert [one["state_digest"] for one in run["episodes"]] == [one["state_digest"] for one in plain.episodes]
    assert all(one["fate"] == "played" for one in run["episodes"])


def test_a_finished_run_is_said_and_is_of_one_policy(server, tmp_path):
    client, settings = fiatlux.Client(server.endpoint), {"run_file": tmp_path / "RUN.toml", "protocol": "published"}
    run = client.evaluate(Waver, ["S05"], [0], **settings)
    assert run["finished"] and run["protocol"] == "published"
    with pytest.warns(UserWarning, match=f"RUN.toml: the run {run['run']} was finished already, so nothing was played"):
        again = client.evaluate(Waver, ["S05"], [0], **settings)
    assert again["episodes"] == run["episodes"]

    class Other(Waver):
        def __call__(self, observation):
            return np.zeros(53)

    with pytest.raises(ValueError, match="differs in the policy's code or weights"):
        client.evaluate(Other, ["S05"], [0], name="Waver", **settings)
    with pytest.raises(ValueError, match="differs in the policy's version"):
        client.evaluate(Waver, ["S05"], [0], version="2", **settings)


def test_the_page_s_client_runs_where_the_wheel_is_installed(server, tmp_path):
    protoc = pytest.importorskip("grpc_tools.protoc", reason="docs/client.requirements.txt is not installed")
    pytest.importorskip("zenoh")
    root = pathlib.Path(__file__).resolve().parents[2]
    protos = [f"fiatlux/v3/{name}.proto" for name in ("session", "observation", "room")]
    assert protoc.main(["protoc", f"-I{root / 'proto/proto'}", f"--python_out={tmp_path}", *protos]) == 0
    command = [sys.executable, root / "docs/client.py", server.endpoint, "lab", "S07"]
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0 and re.search(r"after \d+ steps, digest [0-9a-f]{64}", done.stdout), done.stderr


def test_a_server_with_tokens_and_a_key(tmp_path):
    """Whoever has the token plays; the others are told why they do not."""
    secret = "5a" * 32
    (tmp_path / "tokens").write_text(f"lab {secret} 4\n")
    (tmp_path / "token").write_text(f"lab:{secret}\n")
    for name in ("tokens", "token"):
        (tmp_path / name).chmod(0o600)
    server = Server(tmp_path / "bags", free_port(), "--tokens", str(tmp_path / "tokens"))
    try:
        with pytest.raises(fiatlux.FiatluxError, match="holders of its tokens"):
            fiatlux.Client(server.endpoint).run(Waver, "S05")
        end = fiatlux.Client(server.endpoint, token=tmp_path / "token").run(Waver, "S05", seed=3)
        assert end["state_digest"] == fiatlux.evaluate(Waver, ["S05"], [3]).episodes[0]["state_digest"]
        with pytest.raises(ValueError, match="server_key"):
            fiatlux.Client(server.endpoint, server_key="ed25519:nonsense")
        (key,) = re.findall(r"key=(ed25519:\S+)", server.log.read_text())
        other = "ed25519:yw0QaUn4rWIyHtNYnSGFUA5OOIk6PQMxzhif3g+3+jc="
        with pytest.raises(fiatlux.FiatluxError, match="handshake"):
            fiatlux.Client(server.endpoint, token=tmp_path / "token", server_key=other).run(Waver, "S05")
        again = fiatlux.Client(server.endpoint, token=tmp_path / "token", server_key=key).run(Waver, "S05", seed=3)
        assert again["state_digest"] == end["state_digest"]
    finally:
        server.kill()
