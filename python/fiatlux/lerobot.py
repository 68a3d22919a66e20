"""Makes a LeRobot data set of bags: ``python -m fiatlux.lerobot BAGS --out DIR``."""

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from . import dataset


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    parser = argparse.ArgumentParser(
        prog="python -m fiatlux.lerobot",
        description="Makes a LeRobot data set of bags. A call that was stopped goes on.",
    )
    parser.add_argument("bags", nargs="*", type=Path, help="bags, or one folder of them")
    parser.add_argument("--out", type=Path, help="folder of the data set, which must not exist or be empty")
    parser.add_argument("--repo-id", default="fiatlux/bags", help="name of the data set [default: %(default)s]")
    parser.add_argument(
        "--fps", type=int, default=50, help="frames a second: 50 divided by a whole number [default: 50]"
    )
    parser.add_argument(
        "--vcodec", default="libsvtav1", help="video codec, or none for single pictures [default: %(default)s]"
    )
    parser.add_argument(
        "--action",
        choices=["joints", "command"],
        default="joints",
        help="actions of joints, or commands [default: joints]",
    )
    parser.add_argument("--check", action="store_true", help="only say whether what is needed is installed")
    given = parser.parse_args(arguments)
    try:
        if given.check:
            dataset.writer()
            return 0
        if not given.bags or given.out is None:
            parser.error("name bags, and a folder with --out")
        folder = dataset.export_lerobot(
            given.bags[0] if len(given.bags) == 1 else given.bags,
            given.out,
            repo_id=given.repo_id,
            fps=given.fps,
            vcodec=None if given.vcodec == "none" else given.vcodec,
            action=given.action,
        )
    except (ImportError, OSError, ValueError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print("stopped; the same command goes on from here", file=sys.stderr)
        return 3
    print(folder)
    return 0


if __name__ == "__main__":
    sys.exit(main())
