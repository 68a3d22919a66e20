"""Tests submissions to a leaderboard, served by the program `scorer`, whose path is in FIATLUX_TEST_SCORER."""

import contextlib
import http.client
import http.server
import os
import pathlib
import subprocess
import threading
import urllib.parse
from collections.abc import Iterator

import fiatlux
import pytest
from fiatlux import _native
from fiatlux.submission import is_leftover

SCORER = os.environ.get("FIATLUX_TEST_SCORER", "")
RUN = os.environ.get("FIATLUX_TEST_RUN", "")


def admin(folder: pathlib.Path, *args: str) -> str:
    done = subprocess.run([SCORER, "admin", "--folder", folder, *args], capture_output=True, text=True, check=True)
    return done.stdout.strip()


@contextlib.contextmanager
def board(folder: pathlib.Path) -> Iterator[tuple[str, str]]:
    """A leaderboard that is served: its address, and a token of an account."""
    admin(folder, "init")
    admin(folder, "account", "lab")
    token = admin(folder, "token", "lab")
    command = [SCORER, "serve", "--folder", str(folder), "--http", "127.0.0.1:0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as service:
        try:
            assert service.stdout is not None
            yield service.stdout.readline().split()[-1].rstrip("/"), token
        finally:
            service.terminate()


@contextlib.contextmanager
def proxied(url: str, prefix: str) -> Iterator[tuple[str, list[str]]]:
    """A proxy that has the service below a path, which it takes off; the requests that it saw. Other paths are not found."""
    target = urllib.parse.urlsplit(url)
    seen: list[str] = []

    class Proxy(http.server.BaseHTTPRequestHandler):
        def forward(self) -> None:
            seen.append(f"{self.command} {self.path}")
            if not self.path.startswith(f"{prefix}/"):
                self.send_error(404)
                return
            assert target.hostname is not None
            behind = http.client.HTTPConnection(target.hostname, target.port)
            headers = {name: value for name, value in self.headers.items() if name.lower() != "connection"}
            body = self.rfile.read(int(self.headers.get("Content-Length", 0)))
            behind.request(self.command, self.path.removeprefix(prefix), body, headers)
            answer = behind.getresponse()
            content = answer.read()
            behind.close()
            self.send_response(answer.status)
            self.send_header("Content-Length", str(len(content)))
            self.end_headers()
            self.wfile.write(content)

        do_GET = do_POST = do_PUT = forward

        def log_message(self, *_: object) -> None: ...

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Proxy) as proxy:
        threading.Thread(target=proxy.serve_forever, daemon=True).start()
        try:
            yield f"http://127.0.0.1:{proxy.server_port}{prefix}", seen
        finally:
            proxy.shutdown()


needs_board = pytest.mark.skipif(not (SCORER and RUN), reason="needs the program scorer and a recorded episode")


@needs_board
def test_a_submission_arrives_once(tmp_path: pathlib.Path) -> None:
    with board(tmp_path / "board") as (url, token):
        with pytest.raises(fiatlux.SubmissionError, match="token"):
            fiatlux.submit(RUN, url, token[:-1] + ("0" if token[-1] != "0" else "1"))
        with pytest.raises(fiatlux.SubmissionError, match="link"):
            fiatlux.submit(RUN, url, token, link="javascript:alert(1)")
        told = []
        sent = fiatlux.submit(RUN, url, token, licence="Apache-2.0", progress=lambda *at: told.append(at))
        # It waits for a sim-server, which this service does not have.
        assert sent["state"] in ("received", "graded") and sent["reason"] == "", sent
        assert told[-1][0] == told[-1][1] > 0
        # The same once more is the same submission.
        again = fiatlux.submit(RUN, url, token, licence="Apache-2.0")
        assert again["id"] == sent["id"]


@needs_board
@pytest.mark.parametrize("end", ["", "/"])
def test_a_board_below_a_path_takes_a_submission(tmp_path: pathlib.Path, end: str) -> None:
    with board(tmp_path / "board") as (url, token), proxied(url, "/bench/boards") as (below, seen):
        sent = fiatlux.submit(RUN, below + end, token)
        assert sent["state"] in ("received", "graded") and sent["reason"] == "", sent
        assert {"POST", "PUT"} <= {request.split()[0] for request in seen}
        assert all(" /bench/boards/api/v1/submissions" in request for request in seen), seen
        assert fiatlux.submit(RUN, url, token)["id"] == sent["id"]


def test_a_folder_without_bags_is_refused(tmp_path: pathlib.Path) -> None:
    with pytest.raises(ValueError, match="no bag"):
        fiatlux.submit(tmp_path, "http://127.0.0.1:1", "fiatlux_0_0")
    with pytest.raises(ValueError, match="there is no folder .*nix; name the folder of a run"):
        fiatlux.submit(tmp_path / "nix", "http://127.0.0.1:1", "fiatlux_0_0")
    notes = tmp_path / "notes.txt"
    notes.write_text("not a bag")
    with pytest.raises(ValueError, match="there is no bag in .*notes.txt"):
        fiatlux.submit(notes, "http://127.0.0.1:1", "fiatlux_0_0")
    (tmp_path / "a.mcap").write_bytes(b"")
    for address in ("127.0.0.1:1", "http://h/?a=1", "http://h/#a", "http://me@h", "ftp://h/boards"):
        with pytest.raises(ValueError, match="not the address"):
            fiatlux.submit(tmp_path, address, "fiatlux_0_0", policy="zero")


@pytest.mark.parametrize(
    "name", ["a.mcap", "._a.mcap", "$I7.mcap", "#recycle", "@eaDir", "~$a", "lost+found", "__MACOSX", "lost"]
)
def test_leftovers_are_those_of_the_package(name):
    assert is_leftover(name) == _native.is_leftover(name)
