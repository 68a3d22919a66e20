"""Progress of long work: a line on the terminal, with the time that is left."""

import shutil
import sys
import time


class Line:
    """A line on stderr that is written over, and nothing where stderr is not a terminal. Leaving the context clears it."""

    def __init__(self) -> None:
        self._begun = time.monotonic()

    def __enter__(self) -> "Line":
        return self

    def __exit__(self, *_: object) -> None:
        self.show("")

    def seconds_left(self, done: float, total: float) -> float:
        """Seconds until all is done, at the rate so far; infinite before anything is."""
        return (time.monotonic() - self._begun) * (total - done) / done if done > 0 else float("inf")

    def show(self, text: str) -> None:
        """Replaces the line; what does not fit into the terminal's width is cut."""
        if sys.stderr.isatty():
            print(f"\r\033[K{text[: shutil.get_terminal_size().columns - 1]}", end="", file=sys.stderr, flush=True)


def duration(seconds: float) -> str:
    """A rough duration in words."""
    if seconds == float("inf"):
        return "unknown time"
    minutes = round(max(seconds, 0.0) / 60)
    if minutes < 1:
        return "less than 1 min"
    return f"{minutes} min" if minutes < 60 else f"{minutes // 60} h {minutes % 60:02} min"
