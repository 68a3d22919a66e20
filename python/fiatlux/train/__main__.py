"""Command line of :mod:`fiatlux.train`."""

import argparse
import dataclasses
import sys
from pathlib import Path

from .settings import Settings


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m fiatlux.train", description="Trains controllers.")
    commands = parser.add_subparsers(dest="command", required=True)
    walk = commands.add_parser("walk", help="train the whole-body controller by PPO")
    walk.add_argument("--out", type=Path, required=True, help="folder for checkpoints, learning curve and TensorBoard events")
    walk.add_argument("--resume", action="store_true", help="continue from the last checkpoint in --out")
    walk.add_argument("--minutes", type=float, help="stop at the first checkpoint after this many minutes")
    walk.add_argument("--device", help="PyTorch device of the networks (default: the GPU if there is one, otherwise the CPU)")
    walk.add_argument("--threads", type=int, help="number of threads for the worlds (default: one for each core)")
    for field in dataclasses.fields(Settings):
        is_list = isinstance(field.default, tuple)
        kind = type(field.default[0] if field.default else "") if is_list else type(field.default)
        many = {"nargs": "+"} if is_list else {}
        help_text = f"{field.metadata['help']} (default: {field.default})"
        walk.add_argument(f"--{field.name.replace('_', '-')}", type=kind, default=None, help=help_text, **many)
    evaluate = commands.add_parser("evaluate", help="test a checkpoint's deterministic policy")
    evaluate.add_argument("checkpoint", type=Path)
    evaluate.add_argument("--episodes", type=int, default=1000)
    evaluate.add_argument("--tests", nargs="+", help="names of tests (default: all)")
    evaluate.add_argument("--threads", type=int)
    evaluate.add_argument("--device", default="cpu")
    export = commands.add_parser("export", help="write a checkpoint as one file that includes its contract")
    export.add_argument("checkpoint", type=Path)
    export.add_argument("file", type=Path, help="the .safetensors file to write")
    export.add_argument("--hardware", default="", help="hardware it was trained on, for the contract")
    arguments = parser.parse_args()

    if arguments.command == "walk":
        from .walk import train

        given = {field.name: getattr(arguments, field.name) for field in dataclasses.fields(Settings)}
        given = {name: tuple(value) if isinstance(value, list) else value for name, value in given.items() if value is not None}
        return train(arguments.out, given, arguments.resume, arguments.minutes, arguments.device, arguments.threads)
    if arguments.command == "evaluate":
        from .evaluation import main as evaluate_checkpoint

        return evaluate_checkpoint(
            arguments.checkpoint, arguments.episodes, arguments.tests, arguments.threads, arguments.device
        )
    from .export import export as write

    write(arguments.checkpoint, arguments.file, arguments.hardware)
    return 0


if __name__ == "__main__":
    sys.exit(main())
