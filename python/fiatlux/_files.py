"""Files that a caller names."""

from os import PathLike
from pathlib import Path


def regular(path: str | PathLike[str]) -> Path:
    """The path of a file that can be read to its end. Opening a pipe would wait for somebody to write to it.

    Raises:
        FileNotFoundError: It does not exist.
        ValueError: It is a folder, a pipe, a device or a socket.
    """
    path = Path(path)
    if not path.exists():
        raise FileNotFoundError(f"{path} does not exist")
    if not path.is_file():
        raise ValueError(f"{path} is not a regular file; name a file")
    return path
