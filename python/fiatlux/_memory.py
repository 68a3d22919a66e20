"""Memory that this process may still take: by the control groups of a container or a cluster's job, and by the machine.

The kernel grants memory beyond such a limit and ends the process when it is used, so that nothing can be caught then.
"""

import mmap
from pathlib import Path


def available(root: Path = Path("/")) -> tuple[int, str] | None:
    """Bytes, and the file whose limit it is; None where nothing says so, as on macOS.

    Args:
        root: Where ``proc`` and ``sys`` are.
    """
    found = [_of_group(folder, *names) for folder, names in _groups(root)]
    found += [_of_machine(root), _of_process(root)]
    return min((left for left in found if left is not None), default=None)


_V1 = ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file")
_V2 = ("memory.max", "memory.current", "inactive_file")


def _groups(root: Path) -> list[tuple[Path, tuple[str, str, str]]]:
    """Folders of the groups that this process is in, up to the outermost, and the names of their files."""
    try:
        lines = (root / "proc/self/cgroup").read_text().splitlines()
    except OSError:
        return []
    groups = []
    for line in lines:
        _, controllers, path = line.split(":", 2)
        for kind, names, mounts in (("", _V2, ("", "unified")), ("memory", _V1, ("memory",))):
            if kind in controllers.split(","):
                for mount in mounts:
                    top = root / "sys/fs/cgroup" / mount
                    # Inside of a container the path may be that of the machine: then its own group is the top.
                    inner = top / path.strip("/")
                    groups += [(folder, names) for folder in (inner, *inner.parents) if folder.is_relative_to(top)]
    return groups


def _of_group(folder: Path, limit: str, usage: str, cache: str) -> tuple[int, str] | None:
    try:
        text, used = ((folder / name).read_text().strip() for name in (limit, usage))
        stat = dict(line.split(" ", 1) for line in (folder / "memory.stat").read_text().splitlines())
        # Without a limit v2 has a word, v1 the largest number of pages.
        most = 1 << 60 if text == "max" else int(text)
        return None if most >= 1 << 60 else (most - int(used) + int(stat.get(cache, 0)), str(folder / limit))
    except (OSError, ValueError):
        return None


def _of_machine(root: Path) -> tuple[int, str] | None:
    try:
        lines = (root / "proc/meminfo").read_text().splitlines()
    except OSError:
        return None
    fields = {name: rest.split() for name, _, rest in (line.partition(":") for line in lines)}
    sizes = [int(fields[name][0]) << 10 for name in ("MemAvailable", "SwapFree") if fields.get(name)]
    return (sum(sizes), "/proc/meminfo") if fields.get("MemAvailable") else None


def _of_process(root: Path) -> tuple[int, str] | None:
    """The bytes that ``ulimit -v`` leaves, which batch systems set."""
    try:
        [limit] = [
            line.split() for line in (root / "proc/self/limits").read_text().splitlines() if "address space" in line
        ]
        pages = int((root / "proc/self/statm").read_text().split()[0])
        return None if limit[3] == "unlimited" else (int(limit[3]) - pages * mmap.PAGESIZE, "ulimit -v")
    except (OSError, ValueError, IndexError):
        return None


_SMALL = 64 << 20
"""Bytes for which nobody is asked."""


def check_memory(needed: int, refusal: str) -> None:
    """Raises MemoryError, with a refusal that names the argument, where so many bytes are sure to end the process."""
    left = available() if needed > _SMALL else None
    if left is not None and needed > left[0]:
        raise MemoryError(
            f"{refusal}: they take more than {needed / 2**30:.1f} GiB, and {left[0] / 2**30:.1f} GiB are left by {left[1]}; use fewer, "
            "or raise the limit"
        )
