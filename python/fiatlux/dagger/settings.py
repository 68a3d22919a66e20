"""Settings that all rounds of a run have in common."""

import argparse
import json
import os

from .._files import regular
from .._native import TRAINING_SEEDS
from .lessons import SETTLES

FIRST_ROOM, END_OF_ROOMS = TRAINING_SEEDS
"""Rooms of lessons; all others are for judging."""
FILE = "settings.json"
FREE = ("out", "rounds", "updates", "threads", "hardware", "run", "bags")
"""Settings that may differ between calls that go on with a run."""


def keep(given: argparse.Namespace) -> None:
    """Notes the settings of a new run in its folder, or compares them with those of the run that is there.

    Raises:
        ValueError: They are not possible, or the folder has a run with others.
    """
    if given.rounds < 0 or min(*given.worlds, given.steps, given.batch, given.updates) < 1:
        raise ValueError("--worlds, --steps, --batch and --updates are above 0, and --rounds is not below")
    if getattr(given, "bags", 0) < 0:
        raise ValueError(f"--bags {given.bags}: give 0 for none")
    if given.steps <= SETTLES:
        raise ValueError(f"--steps {given.steps}: nothing is learned of the first {SETTLES} steps of an episode")
    if len(given.worlds) not in (1, len(given.tasks)):
        raise ValueError(
            f"--worlds has {len(given.worlds)} numbers for {len(given.tasks)} tasks: give one, or one a task"
        )
    if given.first_room < FIRST_ROOM:
        raise ValueError(f"--first-room {given.first_room} is for judging; rooms of lessons begin at {FIRST_ROOM}")
    rooms, each = END_OF_ROOMS - given.first_room, max(given.worlds)
    if (given.rounds + 1) * each > rooms:
        raise ValueError(f"{given.rounds} rounds after the first, in {each} rooms each: training has {rooms} rooms")
    if given.threads is not None and given.threads < 1:
        raise ValueError(f"--threads {given.threads}: at least one core plays")
    for task in getattr(given, "shown", []):
        if task not in given.tasks:
            raise ValueError(f"--shown {task} is not among --tasks")
    # As JSON has them: lists for tuples.
    settings = {name: value for name, value in vars(given).items() if name not in FREE}
    settings = json.loads(json.dumps(settings, default=str))
    file = given.out / FILE
    if not file.exists():
        if any(given.out.glob("lessons-*")) or any(given.out.glob("looks-*")):
            raise ValueError(f"{given.out} has lessons but no {FILE}; name another folder with --out")
        given.out.mkdir(parents=True, exist_ok=True)
        part_file = file.with_suffix(".part")
        part_file.write_text(json.dumps(settings, indent=1) + "\n")
        os.replace(part_file, file)
        return
    try:
        kept = dict(json.loads(regular(file).read_text()))
    except (ValueError, TypeError) as error:
        raise ValueError(f"{file} is damaged; name another folder with --out") from error
    others = [
        f"--{name.replace('_', '-')} {kept.get(name)}, not {settings.get(name)}"
        for name in {**kept, **settings}
        if kept.get(name) != settings.get(name)
    ]
    if others:
        raise ValueError(
            f"{given.out} has a run with {'; '.join(others)}: repeat its settings, or name another folder with --out"
        )
