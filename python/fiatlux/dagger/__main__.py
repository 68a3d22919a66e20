"""Command line of :mod:`fiatlux.dagger`."""

import argparse
import json
import math
import os
import platform
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from .lessons import GOALS, Lesson, play, state_of
from .network import GOAL, SPEEDS, Network, Shape, export, normalised
from .settings import FIRST_ROOM, keep

EXAMPLES = """examples:
  python -m fiatlux.dagger train --tasks S05 S07 S09 --out runs/walks
  python -m fiatlux.dagger train --tasks S05 --out runs/s05 --worlds 16 --steps 1000 --minutes 5 --rounds 2
  python -m fiatlux.dagger export runs/walks/round-3.pt walks.safetensors
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
        "--worlds", type=int, default=128, help="worlds of each task, each in a room of its own [default: 128]"
    )
    train.add_argument("--steps", type=int, default=1250, help="control steps of a round in each world [default: 1250]")
    train.add_argument("--minutes", type=float, default=2.0, help="minutes of training in each round [default: 2]")
    train.add_argument(
        "--updates",
        type=int,
        default=0,
        help="steps of training in each round, in place of minutes: the run then follows from the seed",
    )
    train.add_argument(
        "--takes-over",
        type=float,
        default=0.0,
        help="share of a student's episodes that the teacher ends, from a drawn time on [default: 0]",
    )
    train.add_argument("--batch", type=int, default=384, help="decisions in a step of training [default: 384]")
    train.add_argument("--rate", type=float, default=5e-4, help="learning rate at its highest [default: 5e-4]")
    train.add_argument("--picture", type=int, nargs=2, default=(128, 128), metavar=("WIDTH", "HEIGHT"))
    train.add_argument("--ages", type=int, nargs="+", default=(0, 50, 150), help="ages of pictures, control steps")
    train.add_argument("--threads", type=int, help="threads of the worlds [default: one a core]")
    train.add_argument("--seed", type=int, default=1)
    train.add_argument("--blind", action="store_true", help="grey pictures, to see what they are worth")
    train.add_argument("--hardware", default=platform.machine(), help="for the record")
    train.set_defaults(run=train_rounds)
    write = commands.add_parser("export", help="writes the file that the policy see plays")
    write.add_argument("checkpoint", type=Path)
    write.add_argument("file", type=Path)
    write.add_argument("--stands-from", type=float, default=0.0, help="the number from which it stands [default: 0]")
    write.set_defaults(run=export_file)
    given = parser.parse_args(arguments)
    if given.run is train_rounds:
        try:
            keep(given)
        except ValueError as error:
            train.error(str(error))
    try:
        return int(given.run(given) or 0)
    except KeyboardInterrupt:
        print("stopped; the same command goes on after the last round that was finished", file=sys.stderr)
        return 3


def train_rounds(given: argparse.Namespace) -> None:
    """Plays and trains, round by round."""
    device = "cuda" if torch.cuda.is_available() else "cpu"
    shape = Shape(tuple(given.tasks), picture=tuple(given.picture), ages=tuple(given.ages), blind=given.blind)
    student: Network | None = None
    lessons: list[Lesson] = []
    record: dict[str, Any] = {
        "seed": given.seed,
        "hardware": given.hardware,
        "minutes": 0.0,
        "demonstrated": 0,
        "labelled": 0,
    }
    for number in range(given.rounds + 1):
        checkpoint = given.out / f"round-{number}.pt"
        for task in shape.tasks:
            folder = given.out / f"lessons-{number}-{task}"
            if not (folder / "done").exists():
                began = time.monotonic()
                first = FIRST_ROOM + number * given.worlds
                lesson, ended, successes, unended = play(
                    task,
                    range(first, first + given.worlds),
                    given.steps,
                    shape=shape,
                    student=student,
                    takes_over=given.takes_over,
                    threads=given.threads,
                    seed=given.seed + number,
                    device=device,
                )
                lesson.save(folder)
                (folder / "done").write_text(
                    json.dumps({"episodes": ended, "successes": successes, "unended": unended})
                )
                driver = "student" if student else "teacher"
                print(
                    f"round {number} {task}: {driver} succeeded in {successes} of {ended} episodes, {unended} worlds ended none, "
                    f"{len(lesson.back)} decisions, {time.monotonic() - began:.0f} s",
                    flush=True,
                )
            lessons.append(Lesson.load(folder))
            record["labelled" if number else "demonstrated"] += len(lessons[-1].back)
        if checkpoint.exists():
            student, record = load(checkpoint, device)
            continue
        began = time.monotonic()
        student = fit(shape, lessons, given, device, student, number)
        record["minutes"] += (time.monotonic() - began) / 60
        # Whole or not there: a run that is ended here goes on before it.
        part_file = checkpoint.with_suffix(".part")
        torch.save({"shape": asdict(shape), "network": student.state_dict(), "record": record}, part_file)
        os.replace(part_file, checkpoint)


def load(checkpoint: Path, device: str) -> tuple[Network, dict[str, Any]]:
    """The network of a checkpoint, and the record of its training."""
    state = torch.load(checkpoint, map_location=device, weights_only=True)
    network = Network(Shape(**state["shape"])).to(device).eval()
    network.load_state_dict(state["network"])
    return network, state["record"]


def export_file(given: argparse.Namespace) -> None:
    """Writes the file of a checkpoint."""
    network, record = load(given.checkpoint, "cpu")
    export(network, given.file, record, given.stands_from)
    print(f"{given.file}: {given.file.stat().st_size} bytes")
    print(f"play it: fiatlux evaluate --policy see:{given.file} --tasks {','.join(network.shape.tasks)}")


def varied(pictures: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
    """Normalised pictures with another contrast, brightness and tint for each decision; count x ages x cameras x 3 x height x width."""

    def drawn(most: float, *shape: int) -> torch.Tensor:
        number = torch.rand((len(pictures), 1, 1, *shape, 1, 1), device=pictures.device, generator=generator)
        return most * (2 * number - 1)

    return pictures * (1 + drawn(0.2, 1)) + drawn(0.4, 1) + drawn(0.2, 3)


def fit(
    shape: Shape, lessons: Sequence[Lesson], given: argparse.Namespace, device: str, start: Network | None, number: int
) -> Network:
    """Trains a network on lessons, from the one of the round before."""
    torch.manual_seed(given.seed + number)
    generator = torch.Generator(device).manual_seed(given.seed + number)
    columns = {
        name: np.concatenate([getattr(lesson, name) for lesson in lessons])
        for name in ("body", "place", "back", "task", "velocity", "stands", "goal", "settles")
    }
    back, place = columns["back"].astype(np.int64), columns["place"].astype(np.float64)
    rows = np.arange(len(back))
    # Each episode is in its lesson from its first decision on, so that what it looks back at is there.
    olds = [rows - np.minimum(age // shape.every, back) for age in shape.ages]
    state = state_of(shape.tasks, columns["body"], place, [place[old] for old in olds[1:]], columns["task"])
    learned = np.flatnonzero(~columns["settles"].astype(bool))
    to = lambda array, kind=torch.float32: torch.from_numpy(np.ascontiguousarray(array)).to(device, kind)  # noqa: E731
    pictures = torch.cat([torch.from_numpy(np.array(lesson.pictures)).to(device) for lesson in lessons])
    ages, states, learned_rows = to(np.stack(olds, 1), torch.int64), to(state), to(learned, torch.int64)
    velocity = to(columns["velocity"]) / torch.tensor(SPEEDS, device=device)
    stands, goal = to(columns["stands"]), (to(columns["goal"]) / GOAL).clamp(-2, 2)
    network = Network(shape).to(device)
    network.normalise(states[learned_rows])
    if start is not None:
        network.load_state_dict(start.state_dict())
    optimizer = torch.optim.AdamW(network.parameters(), lr=given.rate, weight_decay=1e-4)
    network.train()
    began, step, totals, counted = time.monotonic(), 0, torch.zeros(3, device=device), 0
    print(f"round {number}: {len(learned)} decisions to learn, {device}", flush=True)
    every = max(1, min(500, given.updates // 20)) if given.updates else 500
    curve = (given.out / f"curve-{number}.csv").open("w", buffering=1)
    print("step,velocity,stands,goal", file=curve)
    while (part := step / given.updates if given.updates else (time.monotonic() - began) / (60 * given.minutes)) < 1:
        rate = given.rate * min(1, (step + 1) / 200) * (0.02 + 0.49 * (1 + math.cos(math.pi * part)))
        for group in optimizer.param_groups:
            group["lr"] = rate
        drawn = torch.randint(len(learned_rows), (given.batch,), device=device, generator=generator)
        at = learned_rows[drawn]
        seen = varied(normalised(pictures[ages[at]]), generator)
        sensed = states[at] + 0.02 * network.deviation * torch.randn(
            (given.batch, shape.state), device=device, generator=generator
        )
        with torch.autocast(device, torch.bfloat16, enabled=device == "cuda"):
            embedding = network.encode(seen.flatten(0, 1)).unflatten(0, seen.shape[:2])
            output, where = network.decide(embedding, sensed)
        output, where = output.float(), where.float()
        moves = (1 - stands[at])[:, None]
        losses = torch.stack(
            (
                ((output[:, :3] - velocity[at]).abs() * moves).mean(),
                nn.functional.binary_cross_entropy_with_logits(output[:, 3], stands[at]),
                (where - goal[at]).abs().mean(),
            )
        )
        optimizer.zero_grad(set_to_none=True)
        (losses * torch.tensor((1.0, 0.5, 0.5), device=device)).sum().backward()
        nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
        totals, counted, step = totals + losses.detach(), counted + 1, step + 1
        if step % every == 0:
            means = [f"{loss:.4f}" for loss in (totals / counted).tolist()]
            print(step, *means, sep=",", file=curve)
            of = " ".join(means)
            print(
                f"  step {step}: velocity, stands, goal {of}; {step / (time.monotonic() - began):.1f} steps/s",
                flush=True,
            )
            totals, counted = torch.zeros(3, device=device), 0
    curve.close()
    print(f"  {step} steps, {sum(parameter.numel() for parameter in network.parameters())} parameters", flush=True)
    return network.eval()


if __name__ == "__main__":
    sys.exit(main())
