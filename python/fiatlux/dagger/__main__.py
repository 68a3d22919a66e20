"""Command line of :mod:`fiatlux.dagger`."""

import argparse
import json
import platform
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from .._files import regular
from .finds import IN_ROOM, ON_LADDER, find
from .lessons import GOALS, Lesson, play, shape_of, state_of
from .network import WALKS, Network, Shape, export, learning_rate, normalised, on_device, read, varied
from .settings import FIRST_ROOM, keep

LEARNED = {"velocity": 1.0, "stands": 0.5, "goal": 0.5, "moves": 6.0, "phases": 0.5}
"""Weights of what is learned: velocity, whether to stand, where the goal is, what arms and hands do, and the phase."""
GOALS_FAR, GOALS_NEAR = (2.0, 2.0), (0.4, 3.0)
"""Distance to the goal that counts as 1, m, and the largest that counts: where it walks, and where hands must be exact."""
SHIFTED = 2
"""Largest shift of a picture in training, pixels; none where hands must be exact."""
SURE = 0.02
"""It learns to be this far from sure whether to stand: the teacher stops within millimetres that no picture shows."""
EXAMPLES = """examples:
  python -m fiatlux.dagger train --tasks S05 S07 S09 --out runs/walks
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
    train.add_argument("--tasks", nargs="+", required=True, choices=sorted(GOALS), help="tasks that one network learns")
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
        help="checkpoint of another run, or a file that see plays, to begin with; the teacher then drives in no round",
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
        "--batch", type=int, default=384, help="looks in a step of training, each with its decisions [default: 384]"
    )
    train.add_argument("--rate", type=float, default=5e-4, help="learning rate at its highest [default: 5e-4]")
    train.add_argument("--picture", type=int, nargs=2, default=(128, 128), metavar=("WIDTH", "HEIGHT"))
    train.add_argument("--ages", type=int, nargs="+", default=(0, 50, 150), help="ages of pictures, control steps")
    train.add_argument("--threads", type=int, help="threads of the worlds [default: one a core]")
    train.add_argument("--seed", type=int, default=1)
    train.add_argument("--blind", action="store_true", help="grey pictures, to see what they are worth")
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
    finds.add_argument("--threads", type=int, help="threads of the worlds [default: one a core]")
    finds.add_argument("--seed", type=int, default=1)
    finds.add_argument("--blind", action="store_true", help="grey pictures, to see what they are worth")
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
    try:
        shape = shape_of(given.tasks, picture=tuple(given.picture), ages=tuple(given.ages), blind=given.blind)
    except ValueError as error:
        raise SystemExit(f"--tasks: {error}") from error
    student: Network | None = None
    lessons: list[Lesson] = []
    record: dict[str, Any] = {"minutes": 0.0, "demonstrated": 0, "labelled": 0}
    if given.start:
        try:
            student, record = load(given.start, device)
        except ValueError as error:
            raise SystemExit(f"--start: {error}") from error
        if student.shape != shape:
            raise SystemExit(
                f"--start: {given.start} is of another shape or other tasks; repeat its --tasks and --ages"
            )
    record |= {"seed": given.seed, "hardware": given.hardware}
    for number in range(given.rounds + 1):
        checkpoint = given.out / f"round-{number}.pt"
        # One task's worlds work while another's wait for the slowest of theirs.
        with ThreadPoolExecutor() as pool:
            driver = None if number == 0 and given.demonstrates else student
            new = list(pool.map(lambda task: lesson_of(task, number, shape, driver, given, device), shape.tasks))  # noqa: B023
        lessons += new
        record["labelled" if driver else "demonstrated"] += sum(len(each.back) for each in new)
        if checkpoint.exists():
            student, record = load(checkpoint, device)
            continue
        began = time.monotonic()
        student = fit(shape, lessons, given, device, student, number)
        record["minutes"] += (time.monotonic() - began) / 60
        student.keep(checkpoint, record)


def lesson_of(
    task: str, number: int, shape: Shape, student: Network | None, given: argparse.Namespace, device: str
) -> Lesson:
    """A task's lesson in a round, which is played where the run has none yet."""
    folder = given.out / f"lessons-{number}-{task}"
    if not (folder / "done").exists():
        began, first = time.monotonic(), given.first_room + number * max(given.worlds)
        worlds = given.worlds[shape.tasks.index(task) % len(given.worlds)]
        played = play(
            task,
            range(first, first + worlds),
            given.steps,
            shape=shape,
            student=student,
            takes_over=given.takes_over,
            threads=given.threads,
            seed=given.seed + number,
            device=device,
        )
        played.lesson.save(folder)
        ends = {"episodes": played.ended, "successes": played.successes, "without_end": played.without_end}
        (folder / "done").write_text(json.dumps(ends))
        print(
            f"round {number} {task}: {'student' if student else 'teacher'} succeeded in {played.successes} of "
            f"{played.ended} episodes, none ended in {played.without_end} of {worlds} worlds, "
            f"{len(played.lesson.back)} decisions, {time.monotonic() - began:.0f} s",
            flush=True,
        )
    return Lesson.load(folder)


def load(checkpoint: Path, device: str) -> tuple[Network, dict[str, Any]]:
    """The network of a checkpoint, or of a file that `see` plays, and the record of its training."""
    if checkpoint.suffix == ".safetensors":
        network, record = read(regular(checkpoint))
        return network.to(device).eval(), record
    state = torch.load(regular(checkpoint), map_location=device, weights_only=True)
    network = Network(Shape(**state["shape"])).to(device).eval()
    network.load_state_dict(state["network"])
    return network, state["record"]


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
    shape: Shape, lessons: Sequence[Lesson], given: argparse.Namespace, device: str, start: Network | None, number: int
) -> Network:
    """Trains a network on lessons, from the one of the round before."""
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
    far, farthest = GOALS_NEAR if shape.joints else GOALS_FAR
    goal, does = (to(columns["goal"]) / far).clamp(-farthest, farthest), to(columns["does"], torch.int64)
    # What is seldom done is looked at more often than it is seen.
    kinds = columns["task"][rows[:, 0]] * (len(shape.phases) + 1) + columns["does"][rows[:, 0]]
    often = to(1 / np.sqrt(np.bincount(kinds - kinds.min())[kinds - kinds.min()])) if shape.phases else None
    network = Network(shape).to(device)
    if start is not None:
        network.load_state_dict(start.state_dict())
    network.normalise(states[learned_rows[:, 0]], wanted[learned_rows[:, 0], WALKS:], start is not None)
    moved = WALKS + shape.moves
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
        output, phases = output.float().split([moved, len(shape.phases)], dim=1)
        errors, stands = (output - wanted[at]).abs(), wanted[at, WALKS - 1]
        losses = torch.stack(
            (
                (errors[:, : WALKS - 1] * (1 - stands)[:, None]).mean(),
                nn.functional.binary_cross_entropy_with_logits(output[:, WALKS - 1], stands.clamp(SURE, 1 - SURE)),
                (found.float() - goal[at]).abs().mean(),
                errors[:, WALKS:].sum() / max(errors[:, WALKS:].numel(), 1),
                nn.functional.cross_entropy(phases, does[at]) if shape.phases else errors.new_zeros(()),
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
