"""Files of the user: regular ones, up to a limit."""

from __future__ import annotations

import os
import stat
from collections.abc import Callable
from pathlib import Path
from urllib.parse import unquote

from .error import AssetError


def read_bytes(path: Path, limit: int, check_head: Callable[[bytes, int], None] | None = None) -> bytes:
    """The content of a regular file of at most `limit` bytes.

    `check_head` gets its first 64 KiB and its size before the rest is read.

    A device, a pipe or a socket is refused before a byte of it is read, whatever links lead to it.

    Raises:
        AssetError: It is missing, of another kind, or larger.
    """
    try:
        # A pipe without a writer would keep a blocking open waiting.
        number = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_CLOEXEC", 0))
        with open(number, "rb") as file:
            if not stat.S_ISREG(os.fstat(number).st_mode):
                raise AssetError(f"{path}: it is not a regular file; name a file")
            content = b""
            if check_head is not None:
                content = file.read(1 << 16)
                check_head(content, os.fstat(number).st_size)
            content += file.read(limit + 1)
    except FileNotFoundError as error:
        raise AssetError(f"{path}: there is no such file") from error
    except AssetError:
        raise
    except (OSError, ValueError) as error:
        raise AssetError(f"{path}: cannot be read: {error}") from error
    if len(content) > limit:
        raise AssetError(f"{path}: more than {limit} bytes; that is the limit")
    return content


def read_text(path: Path, limit: int) -> str:
    """The text of a regular file of at most `limit` bytes of UTF-8."""
    try:
        return read_bytes(path, limit).decode()
    except UnicodeDecodeError as error:
        raise AssetError(f"{path}: it is not UTF-8: {error}") from error


def named_by(path: Path, name: str) -> Path:
    """A file that another one names, which must lie in its folder."""
    plain = unquote(name).replace("\\", "/")
    if ":" in plain or not (path.parent / plain).resolve().is_relative_to(path.parent.resolve()):
        raise AssetError(f"{path}: it names '{name}', which lies outside of its folder; put the file in there")
    return path.parent / plain
