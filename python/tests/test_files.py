"""A pipe that nobody writes to keeps no reader waiting."""

import os
import signal

import fiatlux
import pytest
from fiatlux import baseline, submission


@pytest.fixture
def pipe(tmp_path):
    os.mkfifo(tmp_path / "pipe.mcap")

    def late(*_):
        raise TimeoutError("a reader waits")

    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(30)
    yield tmp_path / "pipe.mcap"
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


@pytest.mark.parametrize(
    "read",
    [
        fiatlux.Bag,
        fiatlux.WholeBody,
        baseline.format_of,
        lambda path: baseline.Network(path, "form", "command"),
        lambda path: submission._files(path),
        lambda path: submission._files(path.parent),
        lambda path: fiatlux.Env("S05", sensors=["features"], weights=str(path)),
        lambda path: fiatlux.evaluate(lambda observation: None, tasks=["S05"], seeds=[0], out=path),
        lambda path: fiatlux.label(path),
    ],
)
def test_no_reader_waits_for_a_writer(pipe, read):
    with pytest.raises((ValueError, OSError, fiatlux.FiatluxError)) as caught:
        read(pipe)
    assert not isinstance(caught.value, TimeoutError) and "pipe.mcap" in str(caught.value)
