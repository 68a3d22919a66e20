"""Command line of :mod:`fiatlux.train`."""

import argparse
import dataclasses
import math
import sys
from pathlib import Path
from typing import Any

from .settings import KINDS, SCENES, Settings

EXAMPLES = """examples:
  python -m fiatlux.train walk --out runs/walk --minutes 30
  python -m fiatlux.train walk --out runs/walk --resume
  python -m fiatlux.train evaluate runs/walk/last.pt --episodes 100
  python -m fiatlux.train export runs/walk/last.pt mine.safetensors
  fiatlux evaluate --policy wbc:mine.safetensors,vx=0.4 --tasks S07
  python -m fiatlux.train climb --out runs/climb --minutes 30
  python -m fiatlux.train ppo --task climb --out runs/ppo
  python -m fiatlux.train evaluate runs/ppo/last.pt --episodes 100
  python -m fiatlux.train hand --out runs/hand --demonstrations demonstrations --minutes 5

exit codes: 0 done, 1 the training broke down, 2 wrong arguments or files, 3 stopped by Ctrl-C; --resume goes on"""

WALK = """On two cores, 100 M samples take half a day. Smaller networks and segments show something within minutes:
--worlds 512 --segment 10 --hidden 256 128 64 --critic 256 128 64

log: samples in millions; steps/s; seconds to begin the worlds anew; share of time spent simulating; difficulty; reward a second;
falls in 1,000 steps of a world; mean size of an update (kl); learning rate; mean standard deviation of an action; time left. After
a test, also: share of worlds without a fall; errors of velocity (m/s), turning (rad/s), height (m) and torso (rad); the score by
which best.pt is chosen.

Ctrl-C ends the run after the iteration it is in, with a checkpoint; once more ends it at once, and the last checkpoint stands."""

PPO = """The published benchmark's baseline: 53 joint targets from proprioception, contact forces and the last action; the critic also sees
exact poses. The settings are those of the reference implementation. For a first look within minutes:
--task climb --worlds 64 --rooms 4 --segment 5 --samples 100000

log: as of walk, with successes in 1,000 steps of a world. After a test of 64 episodes of 20 s in rooms that training has not seen:
share of successes; mean gate progress; share of falls; mean length (s) and reward of an episode; the score by which best.pt is
chosen, success + gate progress + reward / 1,000.

Ctrl-C ends the run after the iteration it is in, with a checkpoint; once more ends it at once, and the last checkpoint stands."""

CLIMB = """The policy corrects the plan of the ladder at legs and waist (docs/training.md). For a first look within minutes:
--worlds 64 --segment 5 --hidden 64 64 --critic 64 64 --samples 100000

log: as of walk, without difficulty. After a test of 64 episodes each: share of poses that are held for ten seconds; shares of episodes
that go from the floor to the second tread, from there to the platform, and from the platform to the floor; their sum, by which best.pt
is chosen.

Ctrl-C ends the run after the iteration it is in, with a checkpoint; once more ends it at once, and the last checkpoint stands."""

HAND = """The whole-body controller stands and steps, inverse kinematics moves the right arm; the policy decides, 12.5 times a second,
where the palm goes relative to the grasp that the demonstrations show, how the fingers close, and where the bulb is wanted before the
robot (docs/training.md). Episodes begin at the task's own start and at rows of the demonstrations. For a first look within minutes:
--worlds 64 --segment 5 --rooms 4 --samples 20000

log: as of walk, with successes in 1,000 decisions of a world, and samples that are decisions of four control steps. After a test of 64
episodes of 30 s from the task's own start, in rooms that training has not seen: shares of episodes in which the palm was within 5 cm of
the grasp, in which thumb and fingers pressed the bulb, in which it was lifted, which succeeded, which failed before that; their length
(s); the score by which best.pt is chosen, success + 0.3 lifted + 0.1 gripped + 0.1 near.

Ctrl-C ends the run after the iteration it is in, with a checkpoint; once more ends it at once, and the last checkpoint stands."""

EVALUATE = """Of ppo and hand: episodes of the task's whole length in rooms that training has not seen, as in a test during
the run. The others:

columns: share of episodes without a fall; errors of means over a second, of the velocities (m/s, rad/s), the pelvis's
height (m) and the torso's angles (rad); distance of the feet to the side (m) while both stand and the robot walks; share of
standing steps with an unloaded foot; speed of the joints while standing (rad/s); number of seconds that count, which begin
1.5 s after a command. '-': no robot stood long enough."""


def _whole(text: str) -> int:
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"{text} is not 1 or more")
    return number


def _positive(text: str) -> float:
    number = float(text)
    if not 0 < number < math.inf:
        raise argparse.ArgumentTypeError(f"{text} is not a positive number")
    return number


_whole.__name__, _positive.__name__ = "whole number", "number"


def _add_run(command: argparse.ArgumentParser, settings: type[Settings]) -> None:
    """Adds the arguments of a run with these settings."""
    command.add_argument(
        "--out", type=Path, required=True, help="folder for checkpoints, learning curve and TensorBoard events"
    )
    command.add_argument("--resume", action="store_true", help="continue from the last checkpoint in --out")
    command.add_argument(
        "--minutes", type=_positive, help="begin no segment that would end after this many minutes; the first always is"
    )
    command.add_argument(
        "--device", help="PyTorch device of the networks (default: the GPU if there is one, otherwise the CPU)"
    )
    command.add_argument("--threads", type=_whole, help="number of threads for the worlds (default: one for each core)")
    for field in dataclasses.fields(settings):
        value: Any = field.default
        is_list = isinstance(value, tuple)
        kind = type(value[0] if value else "") if is_list else type(value)
        many: dict[str, Any] = {"nargs": "+"} if is_list else {}
        default = " ".join(map(str, value)) or "none" if is_list else value
        help_text = f"{field.metadata['help']} (default: {default})"
        command.add_argument(f"--{field.name.replace('_', '-')}", type=kind, default=None, help=help_text, **many)


def _parser() -> argparse.ArgumentParser:
    def add(commands: Any, name: str, text: str, epilog: str = "") -> argparse.ArgumentParser:
        form = argparse.RawDescriptionHelpFormatter
        return commands.add_parser(
            name, help=text, description=f"{text[0].upper()}{text[1:]}.", epilog=epilog, formatter_class=form
        )

    parser = argparse.ArgumentParser(
        prog="python -m fiatlux.train",
        description="Trains controllers.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = parser.add_subparsers(dest="command", required=True)
    _add_run(add(commands, "walk", "train the whole-body controller by PPO", WALK), KINDS["walk"])
    _add_run(add(commands, "climb", "train a policy that follows the plan of the ladder by PPO", CLIMB), KINDS["climb"])
    _add_run(add(commands, "ppo", "train the published benchmark's baseline by PPO, on one task", PPO), KINDS["ppo"])
    text = "train a policy that grasps the bulb of S08, on top of the whole-body controller, by PPO"
    _add_run(add(commands, "hand", text, HAND), KINDS["hand"])
    evaluate = add(commands, "evaluate", "test a checkpoint's deterministic policy", EVALUATE)
    evaluate.add_argument("checkpoint", type=Path)
    evaluate.add_argument("--episodes", type=_whole, default=1000, help="episodes of 20 s of each test (default: 1000)")
    evaluate.add_argument("--tests", nargs="+", help="names of tests of a controller (default: all)")
    evaluate.add_argument(
        "--scene", choices=list(SCENES), default="floor", help="where a controller walks (default: floor)"
    )
    evaluate.add_argument(
        "--threads", type=_whole, help="number of threads for the worlds (default: one for each core)"
    )
    evaluate.add_argument("--device", default="cpu", help="PyTorch device of the network (default: cpu)")
    evaluate.add_argument("--json", action="store_true", help="print JSON instead of the table")
    export = add(commands, "export", "write a checkpoint's policy as one file that includes its contract")
    export.add_argument("checkpoint", type=Path)
    export.add_argument("file", type=Path, help="the .safetensors file to write")
    export.add_argument("--hardware", default="", help="hardware it was trained on, for the contract")
    export.add_argument("--force", action="store_true", help="overwrite the file")
    add(
        commands,
        "terms",
        "list the terms of the reward with their usual weights; docs/notes/training.md says what each pays",
    )
    return parser


def _run(arguments: argparse.Namespace) -> int:
    if arguments.command in KINDS:
        from .climb import ClimbRun
        from .hand import HandRun
        from .ppo import BaselineRun
        from .run import Run, train
        from .walk import WalkRun

        kinds: list[type[Run]] = [WalkRun, ClimbRun, BaselineRun, HandRun]
        kind = next(kind for kind in kinds if kind.kind == arguments.command)
        given = {field.name: getattr(arguments, field.name) for field in dataclasses.fields(KINDS[arguments.command])}
        given = {
            name: tuple(value) if isinstance(value, list) else value
            for name, value in given.items()
            if value is not None
        }
        return train(
            kind, arguments.out, given, arguments.resume, arguments.minutes, arguments.device, arguments.threads
        )
    if arguments.command == "evaluate":
        from .report import main as evaluate

        return evaluate(
            arguments.checkpoint,
            arguments.episodes,
            arguments.tests,
            arguments.threads,
            arguments.device,
            arguments.scene,
            arguments.json,
        )
    if arguments.command == "export":
        from .export import export

        export(arguments.checkpoint, arguments.file, arguments.hardware, arguments.force)
        return 0
    from .. import _native

    for name, weight in _native.Batch.walking_weights().items():
        print(f"{name:22}{weight:>10g}")
    return 0


def main() -> int:
    arguments = _parser().parse_args()
    try:
        return _run(arguments)
    except BrokenPipeError:
        return 1
    except (ValueError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    sys.exit(main())
