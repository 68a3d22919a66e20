"""Command line of :mod:`fiatlux.dagger`."""

import argparse
import platform
import sys
import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from ..settings import ROBOTS
from .finds import IN_ROOM, ON_LADDER, Finder, find, parts_of_looks, read_looks
from .lessons import GOALS, PHASES, Lesson, part_of_lesson, shape_of, state_of
from .network import WALKS, Network, Shape, export, grown, learning_rate, load, normalised, on_device, varied
from .parts import Part, do_all, rooms_of_parts, total
from .settings import FIRST_ROOM, keep

LEARNED = {"velocity": 1.0, "stands": 0.5, "goal": 0.5, "moves": 6.0, "phases": 0.5, "finds": 0.1}
"""Weights of what is learned: velocity, whether to stand, where the goal is, what arms and hands do, the phase, and places on the ladder."""
LOOKS = 0.5
"""Looks of which it learns places, for each of the others in a batch."""
GOALS_FAR, GOALS_NEAR = (2.0, 2.0), (0.4, 3.0)
"""Distance to the goal that counts as 1, m, and the largest that counts: where it walks, and where hands must be exact."""
SHIFTED = 2
"""Largest shift of a picture in training, pixels; none where hands must be exact."""
SURE = 0.02
"""It learns to be this far from sure whether to stand: the teacher stops within millimetres that no picture shows."""
EXAMPLES = """examples:
  python -m fiatlux.dagger train --tasks S05 S07 S09 --out runs/walks
  python -m fiatlux.dagger train --tasks S02 S03 S04 S05 S06 S07 S08 S09 S10 S11 S12 --shown S06 S08 --out runs/all
  python -m fiatlux.dagger train --tasks S05 --out runs/s05 --worlds 16 --steps 1000 --updates 2000 --rounds 2
  python -m fiatlux.dagger export runs/walks/round-3.pt walks.safetensors
  python -m fiatlux.dagger find --out runs/platform
  python -m fiatlux.dagger export runs/platform/found.pt platform.safetensors
  fiatlux evaluate --policy see:walks.safetensors --tasks S05,S07,S09 --seeds fresh:48

In round 0 the teacher drives; in each one that follows, the student of the round before. Then a student is trained on all lessons so
far. Called again, it goes on after the last round that it finished."""


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(
        prog="python -m fiatlux.dagger",
        description="Trains a policy that sees by the expert's labels.",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    train = commands.add_parser("train", help="plays lessons and trains on them, round by round")
    train.add_argument(
        "--tasks",
        nargs="+",
        required=True,
        choices=sorted({*GOALS, *ON_LADDER.tasks}),
        help="tasks that one network learns; in those on the ladder it learns where it is",
    )
    train.add_argument("--out", type=Path, required=True, help="folder of the run")
    train.add_argument("--rounds", type=int, default=3, help="rounds in which a student drives [default: 3]")
    train.add_argument(
        "--worlds",
        type=int,
        nargs="+",
        default=[96],
        help="worlds of each task, one number or one a task, each in a room of its own [default: 96]",
    )
    train.add_argument("--first-room", type=int, default=FIRST_ROOM, help="first of the rooms [default: 1000]")
    train.add_argument(
        "--start",
        type=Path,
        help="checkpoint of another run, or a file that see plays, to begin with, which then drives in round 0, too; what it has not "
        "learned needs --demonstrates or --shown",
    )
    train.add_argument(
        "--shown",
        nargs="+",
        default=[],
        choices=sorted(GOALS),
        metavar="TASK",
        help="those of the tasks in which the teacher drives in every round",
    )
    train.add_argument(
        "--demonstrates", action="store_true", help="the teacher drives in round 0 of a run with --start, too"
    )
    train.add_argument("--steps", type=int, default=1250, help="control steps of a round in each world [default: 1250]")
    train.add_argument("--updates", type=int, default=5000, help="steps of training in each round [default: 5000]")
    train.add_argument(
        "--takes-over",
        type=float,
        default=0.0,
        help="share of a student's episodes that the teacher ends, from a drawn time on [default: 0]",
    )
    train.add_argument(
        "--bags",
        type=int,
        default=1,
        help="clean episodes to keep as thin bags, at most so many for each 32 worlds of a task in a round [default: 1]",
    )
    train.add_argument(
        "--batch", type=int, default=384, help="looks in a step of training, each with its decisions [default: 384]"
    )
    train.add_argument("--rate", type=float, default=5e-4, help="learning rate at its highest [default: 5e-4]")
    train.add_argument("--picture", type=int, nargs=2, default=(128, 128), metavar=("WIDTH", "HEIGHT"))
    train.add_argument("--ages", type=int, nargs="+", default=(0, 50, 150), help="ages of pictures, control steps")
    train.add_argument("--threads", type=int, help="cores that play, a process each, with some 2 GB [default: all]")
    train.add_argument("--seed", type=int, default=1)
    train.add_argument("--blind", action="store_true", help="grey pictures, to see what they are worth")
    train.add_argument("--robot", choices=ROBOTS, default=ROBOTS[0], help="robot that learns [default: %(default)s]")
    train.add_argument("--hardware", default=platform.machine(), help="for the record")
    train.set_defaults(run=train_rounds)
    finds = commands.add_parser(
        "find", help="looks on while the expert plays, and learns where the robot is in the room or on the ladder"
    )
    finds.add_argument(
        "--tasks",
        nargs="+",
        default=ON_LADDER.looks_in,
        choices=(*ON_LADDER.looks_in, *IN_ROOM.looks_in),
        help="tasks that it looks on in: S01 for the place in the room, others for the place on the ladder [default: all four of these]",
    )
    finds.add_argument("--out", type=Path, required=True, help="folder of the run; looks that are there are kept")
    finds.add_argument(
        "--worlds", type=int, nargs="+", default=[256], help="worlds, one number or one a task [default: 256]"
    )
    finds.add_argument("--first-room", type=int, default=FIRST_ROOM, help="first of the rooms [default: 1000]")
    finds.add_argument("--steps", type=int, default=1300, help="control steps in each world [default: 1300]")
    finds.add_argument("--updates", type=int, default=16000, help="steps of training [default: 16000]")
    finds.add_argument("--batch", type=int, default=512, help="looks in a step of training [default: 512]")
    finds.add_argument("--rate", type=float, default=5e-4, help="learning rate at its highest [default: 5e-4]")
    finds.add_argument("--picture", type=int, nargs=2, default=(128, 128), metavar=("WIDTH", "HEIGHT"))
    finds.add_argument("--threads", type=int, help="cores that play, a process each, with some 2 GB [default: all]")
    finds.add_argument("--seed", type=int, default=1)
    finds.add_argument("--blind", action="store_true", help="grey pictures, to see what they are worth")
    finds.add_argument("--robot", choices=ROBOTS, default=ROBOTS[0], help="robot that learns [default: %(default)s]")
    finds.add_argument("--hardware", default=platform.machine(), help="for the record")
    finds.set_defaults(run=find, rounds=0)
    write = commands.add_parser("export", help="writes the file that the policy see plays")
    write.add_argument("checkpoint", type=Path)
    write.add_argument("file", type=Path)
    write.add_argument("--stands-from", type=float, default=0.0, help="the number from which it stands [default: 0]")
    write.set_defaults(run=export_file)
    given = parser.parse_args(arguments)
    if command := {train_rounds: train, find: finds}.get(given.run):
        try:
            keep(given)
        except ValueError as error:
            command.error(str(error))
    try:
        return int(given.run(given) or 0)
    except KeyboardInterrupt:
        print("stopped; the same command goes on after what was finished", file=sys.stderr)
        return 3


def train_rounds(given: argparse.Namespace) -> None:
    """Plays and trains, round by round."""
    device = "cuda" if torch.cuda.is_available() else "cpu"
    played, looked = ([task for task in given.tasks if task in of] for of in (GOALS, ON_LADDER.looks_in))
    finds = ON_LADDER.finds if set(given.tasks) & set(ON_LADDER.tasks) else ()
    try:
        shape = shape_of(
            given.tasks,
            finds,
            picture=tuple(given.picture),
            ages=tuple(given.ages),
            blind=given.blind,
            robot=given.robot,
        )
    except ValueError as error:
        raise SystemExit(f"--tasks: {error}") from error
    if finds and not looked:
        raise SystemExit(f"--tasks: places are learned in {', '.join(ON_LADDER.looks_in)}; name one of them, too")
    lessons: list[Lesson] = []
    student, last = None, None
    record: dict[str, Any] = {"minutes": 0.0, "demonstrated": 0, "labelled": 0}
    if given.start:
        last = given.out / "start.pt"
        try:
            student, record = begin_with(given.start, shape, device)
        except ValueError as error:
            raise SystemExit(f"--start {given.start}: {error}") from error
        if not last.exists():
            student.keep(last, record)
    looks = parts_of_looks(looked, shape, given)
    finder: Finder | None = None
    record |= {"seed": given.seed, "hardware": given.hardware}
    for number in range(given.rounds + 1):
        checkpoint = given.out / f"round-{number}.pt"
        drivers = {
            task: None if task in given.shown or (number == 0 and given.demonstrates) else last for task in played
        }
        parts = {task: parts_of_lesson(task, number, shape, drivers[task], given, device) for task in played}
        fresh = {task for task in played if not all(part.is_done for part in parts[task])}
        # The slow ones first.
        do_all([*looks, *(part for task in played for part in parts[task])], given.threads)
        for task in played:
            ends = total(parts[task])
            record["labelled" if drivers[task] else "demonstrated"] += ends["decisions"]
            lessons += [Lesson.load(part.folder) for part in parts[task]]
            if task in fresh:
                print(
                    f"round {number} {task}: {'student' if drivers[task] else 'teacher'} succeeded in {ends['successes']} of "
                    f"{ends['episodes']} episodes, none ended in {ends['without_end']} of {ends['worlds']} worlds, "
                    f"{ends['decisions']} decisions",
                    flush=True,
                )
        last = checkpoint
        if checkpoint.exists():
            student, record = load(checkpoint, device)
            continue
        began = time.monotonic()
        if looks and finder is None:
            finder = Finder(shape, read_looks(looks), max(1, round(LOOKS * given.batch)), device)
        if finder and student and "looks" not in record:
            finder.begin(student)
        student = fit(shape, lessons, finder, given, device, student, number)
        record["minutes"] += (time.monotonic() - began) / 60
        if finder:
            record |= {"looks": len(finder.body), "errors": finder.errors(student)}
        student.keep(checkpoint, record)


def begin_with(start: Path, shape: Shape, device: str) -> tuple[Network, dict[str, Any]]:
    """A network of a shape that knows what another one does, and the record of that one's training.

    Raises:
        ValueError: The file is not a network, or has what that shape lacks.
    """
    network, record = load(start, device)
    return network if network.shape == shape else grown(network.cpu(), shape).to(device).eval(), record


def parts_of_lesson(
    task: str, number: int, shape: Shape, student: Path | None, given: argparse.Namespace, device: str
) -> list[Part]:
    """A task's lesson in a round, in parts; a student is that of a checkpoint."""
    first, worlds = (
        given.first_room + number * max(given.worlds),
        given.worlds[given.tasks.index(task) % len(given.worlds)],
    )
    make = partial(
        part_of_lesson,
        task,
        steps=given.steps,
        shape=shape,
        student=student,
        takes_over=given.takes_over,
        bags=given.bags,
        device=device,
    )
    parts = []
    for rooms in rooms_of_parts(first, worlds):
        name = f"{number}-{task}-{rooms[0]}"
        own = partial(make, rooms=rooms, seed=given.seed + number + rooms[0], into=given.out / f"bags-{name}")
        parts.append(Part(given.out / f"lessons-{name}", own))
    return parts


def export_file(given: argparse.Namespace) -> None:
    """Writes the file of a checkpoint."""
    network, record = load(given.checkpoint, "cpu")
    try:
        export(network, given.file, record, given.stands_from)
    except ValueError as error:
        raise SystemExit(str(error)) from error
    print(f"{given.file}: {given.file.stat().st_size} bytes")
    policy = "carry" if network.shape.finds == IN_ROOM.finds else "see"
    print(f"play it: fiatlux evaluate --policy {policy}:{given.file} --tasks {','.join(network.shape.tasks)}")


def fit(
    shape: Shape,
    lessons: Sequence[Lesson],
    finder: Finder | None,
    given: argparse.Namespace,
    device: str,
    start: Network | None,
    number: int,
) -> Network:
    """Trains a network on lessons, and on looks where it finds places, from the one of the round before."""
    torch.manual_seed(given.seed + number)
    generator = torch.Generator(device).manual_seed(given.seed + number)
    columns = {
        name: np.concatenate([getattr(lesson, name) for lesson in lessons])
        for name in (
            *("body", "place", "where", "back", "task", "velocity", "stands", "moves", "phase", "since", "does"),
            *("goal", "settles"),
        )
    }
    back, where = columns["back"].astype(np.int64), columns["where"].astype(np.float64)
    looks = np.cumsum([0, *(len(lesson.where) for lesson in lessons)])
    newest = np.concatenate([first + lesson.frame for first, lesson in zip(looks, lessons)])
    # Each episode is in its lesson from its first look on, so that what it looks back at is there.
    olds = [newest - np.minimum(age // shape.every, back) for age in shape.ages]
    place = columns["place"].astype(np.float64)
    then = [where[old] for old in olds[1:]]
    state = state_of(shape, columns["body"], place, then, columns["phase"], columns["since"], columns["task"])
    learned = np.flatnonzero(~columns["settles"].astype(bool))
    # Rows of a look, which follow one another; where there are fewer, the last one counts more.
    _, begins, counts = np.unique(newest[learned], return_index=True, return_counts=True)
    steps = np.arange(shape.every if shape.joints else 1)
    rows = learned[begins[:, None] + np.minimum(steps, counts[:, None] - 1)]
    to = lambda array, kind=torch.float32: torch.from_numpy(np.ascontiguousarray(array)).to(device, kind)  # noqa: E731
    pictures = on_device(lessons, device)
    ages, states, learned_rows = to(np.stack(olds, 1), torch.int64), to(state), to(rows, torch.int64)
    wanted = torch.cat((to(columns["velocity"]), to(columns["stands"])[:, None], to(columns["moves"])), dim=1)
    # Where hands work, they must be exact.
    handed = np.isin(columns["task"], [shape.tasks.index(task) for task in PHASES if task in shape.tasks])
    far, farthest = to(np.where(handed[:, None], GOALS_NEAR, GOALS_FAR)).split(1, dim=1)
    goal, does = (to(columns["goal"]) / far).clamp(-farthest, farthest), to(columns["does"], torch.int64)
    # What is seldom done is looked at more often than it is seen.
    kinds = columns["task"][rows[:, 0]] * (len(shape.phases) + 1) + columns["does"][rows[:, 0]]
    often = to(1 / np.sqrt(np.bincount(kinds - kinds.min())[kinds - kinds.min()])) if shape.phases else None
    network = Network(shape).to(device)
    if start is not None:
        network.load_state_dict(start.state_dict())
    first, moved = learned_rows[:, 0], WALKS + shape.moves
    handed = to(handed, torch.bool)
    measured = states[first, : shape.measured]
    if finder:
        others = finder.body[finder.learned]
        of_looks = torch.cat((others, finder.rest[:1, : shape.measured - shape.sensed].expand(len(others), -1)), dim=1)
        measured = torch.cat((measured, of_looks))
    shown = first[handed[first]]
    if shape.joints and not len(shown):
        raise SystemExit(
            "nothing can be learned of the tasks for hands: the robot did not follow; take more --steps or --worlds"
        )
    network.normalise(measured, wanted[shown, WALKS:], start is not None)
    if finder and start is None:
        finder.begin(network)
    wanted = (wanted - network.centre[:moved]) / network.scale[:moved]
    worth = torch.tensor(list(LEARNED.values()), device=device)
    optimizer = torch.optim.AdamW(network.parameters(), lr=given.rate, weight_decay=1e-4)
    network.train()
    began, totals = time.monotonic(), torch.zeros(len(LEARNED), device=device)
    print(f"round {number}: {len(learned)} decisions to learn, {device}", flush=True)
    every, curve = max(1, min(500, given.updates // 20)), (given.out / f"curve-{number}.csv").open("w", buffering=1)
    print("step", *LEARNED, sep=",", file=curve)
    for step in range(1, given.updates + 1):
        rate = learning_rate(given.rate, step, given.updates)
        for group in optimizer.param_groups:
            group["lr"] = rate
        if often is None:
            drawn = torch.randint(len(learned_rows), (given.batch,), device=device, generator=generator)
        else:
            drawn = torch.multinomial(often, given.batch, replacement=True, generator=generator)
        at = learned_rows[drawn].flatten()
        seen = varied(normalised(pictures[ages[learned_rows[drawn, 0]]]), generator, 0 if shape.joints else SHIFTED)
        sensed = states[at] + 0.02 * network.deviation * torch.randn(
            (len(at), shape.state), device=device, generator=generator
        )
        with torch.autocast(device, torch.bfloat16, enabled=device == "cuda"):
            embedding = network.encode(seen.flatten(0, 1)).unflatten(0, seen.shape[:2])
            output, found = network.decide(embedding.repeat_interleave(len(steps), dim=0), sensed)
        output, phases, _ = output.float().split([moved, len(shape.phases), len(shape.finds)], dim=1)
        errors, stands, works = (output - wanted[at]).abs(), wanted[at, WALKS - 1], handed[at]
        count = works.sum().clamp(min=1)
        finds = finder.loss(network, generator)[0] if finder else errors.new_zeros(())
        losses = torch.stack(
            (
                (errors[:, : WALKS - 1] * (1 - stands)[:, None]).mean(),
                nn.functional.binary_cross_entropy_with_logits(output[:, WALKS - 1], stands.clamp(SURE, 1 - SURE)),
                (found.float() - goal[at]).abs().mean(),
                (errors[:, WALKS:].sum(1) * works).sum() / (max(shape.moves, 1) * count),
                nn.functional.cross_entropy(phases, does[at], ignore_index=-1, reduction="sum") / count
                if shape.phases
                else errors.new_zeros(()),
                finds,
            )
        )
        optimizer.zero_grad(set_to_none=True)
        (losses * worth).sum().backward()
        nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
        totals += losses.detach()
        if step % every == 0:
            means = [f"{loss:.4f}" for loss in (totals / every).tolist()]
            print(step, *means, sep=",", file=curve)
            of, rate = " ".join(means), step / (time.monotonic() - began)
            print(f"  step {step}: {', '.join(LEARNED)} {of}; {rate:.1f} steps/s", flush=True)
            totals.zero_()
    curve.close()
    return network.eval()


if __name__ == "__main__":
    sys.exit(main())
