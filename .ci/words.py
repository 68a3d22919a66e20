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


def main() -> int:
    faults = []
    for path in subprocess.run(["git", "ls-files", "*.rs", "*.py"], capture_output=True, text=True, check=True).stdout.split():
        for number, line in enumerate(Path(path).read_text().splitlines(), 1):
            if ASKS.search(line):
                faults.append(f"{path}:{number}: asks instead of saying the thing: {line.strip()}")
            if LIMIT.search(line):
                faults.append(f"{path}:{number}: a limit is named MAX_ or MIN_: {line.strip()}")
    book = sum(words(page.read_text()) for folder in ("docs", "docs/python") for page in Path(folder).glob("*.md"))
    if book > MAX_BOOK:
        faults.append(f"the book has {book} words, more than {MAX_BOOK}: measurements belong in docs/notes/")
    # Comments mark rates.
    readme = re.sub(r"<!--[^>]*-->", "", Path("README.md").read_text())
    if words(readme) > MAX_README:
        faults.append(f"README.md has {words(readme)} words, more than {MAX_README}")
    # Title and picture do not count.
    before = [line for line in readme.split("\n```", 1)[0].splitlines() if not line.startswith(("!", "#"))]
    if words(" ".join(before)) > MAX_BEFORE_COMMAND:
        faults.append(f"README.md has {words(' '.join(before))} words before its first command, more than {MAX_BEFORE_COMMAND}")
    print(*faults, sep="\n", file=sys.stderr, end="\n" if faults else "")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
