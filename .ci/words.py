#!/usr/bin/env python3
"""Fails where a comment asks instead of saying the thing, where a limit is not named MAX_ or MIN_, and where the book or the README
outgrows its number of words."""

import re
import subprocess
import sys
from pathlib import Path

ASKS = re.compile(r'^ *(//[/!]|""") ?(What|Whether|How) ')
LIMIT = re.compile(r"\b(MOST|LEAST)_[A-Z_]+\b")
MAX_BOOK, MAX_README, MAX_BEFORE_COMMAND = 40_000, 1_100, 60


def words(text: str) -> int:
    return len(text.split())


def faults(path: str, text: str) -> list[str]:
    """Faults of a file of code."""
    found = []
    for number, line in enumerate(text.splitlines(), 1):
        if ASKS.search(line):
            found.append(f"{path}:{number}: asks instead of saying the thing: {line.strip()}")
        if LIMIT.search(line):
            found.append(f"{path}:{number}: a limit is named MAX_ or MIN_: {line.strip()}")
    return found


def readme_faults(text: str) -> list[str]:
    """Faults of a README: comments mark rates and do not count, nor do title and picture before the first command."""
    text = re.sub(r"<!--[^>]*-->", "", text)
    before = " ".join(line for line in text.split("\n```", 1)[0].splitlines() if not line.startswith(("!", "#")))
    counted = [(words(text), MAX_README, ""), (words(before), MAX_BEFORE_COMMAND, " before its first command")]
    return [f"README.md has {count} words{where}, more than {most}" for count, most, where in counted if count > most]


def main() -> int:
    listed = subprocess.run(["git", "ls-files", "-z", "*.rs", "*.py"], capture_output=True, text=True, check=True).stdout
    paths = [path for path in listed.split("\0") if path and Path(path).is_file()]
    found = [fault for path in paths for fault in faults(path, Path(path).read_text())]
    book = sum(words(page.read_text()) for folder in ("docs", "docs/python") for page in Path(folder).glob("*.md"))
    if book > MAX_BOOK:
        found.append(f"the book has {book} words, more than {MAX_BOOK}: measurements belong in docs/notes/")
    found += readme_faults(Path("README.md").read_text())
    print(*found, sep="\n", file=sys.stderr, end="\n" if found else "")
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
