"""Tests submissions to a leaderboard, served by the program `scorer`, whose path is in FIATLUX_TEST_SCORER."""

import os
import pathlib
import subprocess

import fiatlux
import pytest
from fiatlux import _native
from fiatlux.submission import is_leftover

SCORER = os.environ.get("FIATLUX_TEST_SCORER", "")
RUN = os.environ.get("FIATLUX_TEST_RUN", "")


def admin(folder: pathlib.Path, *args: str) -> str:
    done = subprocess.run([SCORER, "admin", "--folder", folder, *args], capture_output=True, text=True, check=True)
    return done.stdout.strip()


@pytest.mark.skipif(not (SCORER and RUN), reason="needs the program scorer and a recorded episode")
def test_a_submission_arrives_once(tmp_path: pathlib.Path) -> None:
    folder = tmp_path / "board"
    admin(folder, "init")
    admin(folder, "account", "lab")
    token = admin(folder, "token", "lab")
    command = [SCORER, "serve", "--folder", str(folder), "--http", "127.0.0.1:0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as service:
        try:
            assert service.stdout is not None
            url = service.stdout.readline().split()[-1].rstrip("/")
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
        finally:
            service.terminate()


def test_a_folder_without_bags_is_refused(tmp_path: pathlib.Path) -> None:
    with pytest.raises(ValueError, match="no bag"):
        fiatlux.submit(tmp_path, "http://127.0.0.1:1", "fiatlux_0_0")
    with pytest.raises(ValueError, match="there is no folder .*nix; name the folder of a run"):
        fiatlux.submit(tmp_path / "nix", "http://127.0.0.1:1", "fiatlux_0_0")
    notes = tmp_path / "notes.txt"
    notes.write_text("not a bag")
    with pytest.raises(ValueError, match="there is no bag in .*notes.txt"):
        fiatlux.submit(notes, "http://127.0.0.1:1", "fiatlux_0_0")
    with pytest.raises(ValueError, match="not the address"):
        (tmp_path / "a.mcap").write_bytes(b"")
        fiatlux.submit(tmp_path, "127.0.0.1:1", "fiatlux_0_0", policy="zero")


@pytest.mark.parametrize(
    "name", ["a.mcap", "._a.mcap", "$I7.mcap", "#recycle", "@eaDir", "~$a", "lost+found", "__MACOSX", "lost"]
)
def test_leftovers_are_those_of_the_package(name):
    assert is_leftover(name) == _native.is_leftover(name)
