"""Work in parts, each of them done by a process and kept in a folder of its own."""

import json
import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path

import torch

from .._native import available_threads
from .lessons import Columns

WORLDS = 32
"""Worlds of a part: the same on every machine, so that a run repeats."""


@dataclass(frozen=True)
class Part:
    """A part of the work."""

    folder: Path
    make: Callable[..., tuple[Columns, dict[str, int]]]
    """Makes what is kept, and counts, with a number of ``threads``; another process can call it."""

    @property
    def is_done(self) -> bool:
        """True if it is there whole."""
        return (self.folder / "done").exists()

    def do(self, threads: int) -> float:
        """Makes and keeps it. Returns the time that this took, s."""
        began = time.monotonic()
        made, counts = self.make(threads=threads)
        made.save(self.folder)
        part_file = self.folder / "done.part"
        part_file.write_text(json.dumps(counts))
        os.replace(part_file, self.folder / "done")
        return time.monotonic() - began

    def counts(self) -> dict[str, int]:
        """Numbers that were counted, by name."""
        return dict(json.loads((self.folder / "done").read_text()))


def rooms_of_parts(first: int, worlds: int) -> list[range]:
    """The rooms of each part of a task's worlds."""
    end = first + worlds
    return [range(begin, min(begin + WORLDS, end)) for begin in range(first, end, WORLDS)]


def do_all(parts: Sequence[Part], cores: int | None) -> None:
    """Does what is not there yet, a process for each of the cores.

    Raises:
        SystemExit: A process was ended from outside.
    """
    due, cores = [part for part in parts if not part.is_done], cores or available_threads()
    if cores == 1 or len(due) < 2:
        for part in due:
            part.do(cores)
        return
    count, began = min(cores, len(due)), time.monotonic()
    pool = ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), _begin)
    try:
        work = {pool.submit(part.do, cores // count): part for part in due}
        for done, future in enumerate(as_completed(work), 1):
            took, now = future.result(), time.monotonic() - began
            print(f"  {work[future].folder.name}: {took:.0f} s; {done} of {len(due)} parts, {now:.0f} s", flush=True)
    except BrokenProcessPool as error:
        raise SystemExit(
            "a process was ended from outside, perhaps for want of memory; take fewer --threads"
        ) from error
    except BaseException:
        # What others have begun is lost with them, and is done again by the next call.
        pool.shutdown(wait=False, cancel_futures=True)
        for child in multiprocessing.active_children():
            child.terminate()
        raise
    pool.shutdown()


def _begin() -> None:
    """Sets a process up: it leaves Ctrl-C to its parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    torch.set_num_threads(1)


def total(parts: Sequence[Part]) -> dict[str, int]:
    """Sums of what was counted."""
    counts = [part.counts() for part in parts]
    return {name: sum(each[name] for each in counts) for name in counts[0]}
