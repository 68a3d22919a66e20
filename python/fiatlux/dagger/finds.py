"""Learns from pictures where the robot is: on the ladder, or in the room."""

import argparse
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, fields
from functools import partial
from typing import Any

import numpy as np
import torch
from torch import nn

from .. import poses
from .._scene import SCENE
from ..expert import Experts
from ..kinematics import Kinematics
from ..vector import VectorEnv
from .lessons import SENSED, SENSORS, SETTLES, Array, Columns, columns_of, lesson_worlds, state_of, touch
from .network import MIN_DEVIATION, Network, Shape, learning_rate, normalised, on_device, varied
from .parts import Part, do_all, rooms_of_parts, total

LOGARITHMS = -9.0, 2.0
"""Range of the logarithms of standard deviations."""
KEPT_OUT = 16
"""One room of so many is kept out of training."""


@dataclass(frozen=True)
class Finding:
    """Things that are found together."""

    tasks: tuple[str, ...]
    """Tasks that are played with it."""
    looks_in: tuple[str, ...]
    """Those of them in which the expert shows it."""
    numbers: tuple[str, ...]
    """Names of the numbers, as :func:`place_of` has them."""
    widths: tuple[float, ...]
    """Counts as 1, m, and rad for a heading."""
    deviations: dict[str, tuple[int, ...]]
    """Which numbers a standard deviation is of: its logarithm comes out, too."""
    every: int
    """Control steps from one look to the next."""
    above: float = -math.inf
    """The pelvis is as high where it looks, m."""
    says_wall: bool = False
    """A last number is above 0 where the socket is at a wall."""

    @property
    def finds(self) -> tuple[str, ...]:
        """Numbers that come out, as ``crates/policies/src/see/finds.rs`` reads them."""
        wall = ("wall",) if self.says_wall else ()
        return (*self.numbers, *(f"log_{name}" for name in self.deviations), *wall)

    @property
    def spread_of(self) -> list[int]:
        """For each number the place of its standard deviation among them."""
        return [
            next(place for place, of in enumerate(self.deviations.values()) if number in of)
            for number in range(len(self.numbers))
        ]


ON_LADDER = Finding(
    # It gets onto the ladder there, or begins on the platform.
    tasks=("S02", "S03", "S04", "S10", "S11", "S12"),
    looks_in=("S03", "S04", "S11", "S12"),
    numbers=("x", "y", "heading"),
    widths=(0.05, 0.05, 0.1),
    deviations={"x": (0,), "y": (1,), "heading": (2,)},
    every=5,
    above=1.5,
    says_wall=True,
)
"""x and y of the pelvis in the ladder's frame, and by how much it looks to the left of the way up."""
IN_ROOM = Finding(
    tasks=("S01",),
    looks_in=("S01",),
    numbers=("x", "y", "cos", "sin", "bench_ahead", "bench_left", "crate_ahead", "crate_left"),
    widths=(2.0, 2.0, 0.7, 0.7, 2.0, 2.0, 2.0, 2.0),
    deviations={"x": (0,), "y": (1,), "heading": (2, 3), "bench": (4, 5), "crate": (6, 7)},
    every=10,
)
"""x, y and heading of the pelvis in the room, and the middles of bench and crate ahead and to the left of it."""


def finding_of(task: str) -> Finding:
    """The things that are found in a task."""
    return next(finding for finding in (ON_LADDER, IN_ROOM) if task in finding.looks_in)


@dataclass
class Looks(Columns):
    """Pictures, and what they show."""

    pictures: Array
    """Bytes: looks x cameras x height x width x 3."""
    body: Array
    """The body's own senses."""
    place: Array
    """The numbers that are to be found, looks x numbers."""
    wall: Array
    """1 where the socket is at a wall, 0 where it is at the ceiling."""
    room: Array


def find(given: argparse.Namespace) -> None:
    """Looks on while the expert plays, and trains."""
    device = "cuda" if torch.cuda.is_available() else "cpu"
    finding = finding_of(given.tasks[0])
    if others := set(given.tasks) - set(finding.looks_in):
        raise SystemExit(f"--tasks: {given.tasks[0]} and {min(others)} find other things; make a network of each")
    env = VectorEnv(given.tasks[0], 1, robot=given.robot)
    shape = Shape(
        finding.tasks,
        picture=tuple(given.picture),
        every=finding.every,
        ages=(0,),
        joints=tuple(env.action_names),
        embedding=256,
        blind=given.blind,
        robot=given.robot,
        finds=finding.finds,
    )
    env.close()
    parts = parts_of_looks(given.tasks, shape, given)
    do_all(parts, given.threads)
    looks = read_looks(parts)
    began = time.monotonic()
    network, errors = fit(shape, looks, given, device)
    record = {
        "looks": sum(len(each.wall) for each in looks),
        "errors": errors,
        "minutes": (time.monotonic() - began) / 60,
        "seed": given.seed,
        "hardware": given.hardware,
    }
    network.keep(given.out / "found.pt", record)


def parts_of_looks(tasks: Sequence[str], shape: Shape, given: argparse.Namespace) -> list[Part]:
    """Looks in tasks, in parts."""
    parts = []
    for task in tasks:
        index = given.tasks.index(task)
        for rooms in rooms_of_parts(given.first_room, given.worlds[index % len(given.worlds)]):
            make = partial(look, task, rooms, given.steps, shape=shape, seed=given.seed + index + rooms[0])
            parts.append(Part(given.out / f"looks-{task}-{rooms[0]}", make))
    return parts


def read_looks(parts: Sequence[Part]) -> list[Looks]:
    """The looks of parts that are done."""
    if parts:
        print(f"{total(parts)['looks']} looks", flush=True)
    return [Looks.load(part.folder) for part in parts]


def look(
    task: str, rooms: Sequence[int], steps: int, *, shape: Shape, threads: int | None, seed: int
) -> tuple[Looks, dict[str, int]]:
    """Pictures of the cameras in a world for each room while the expert plays, and their number."""
    worlds, every, finding = len(rooms), shape.every, finding_of(task)
    env = lesson_worlds(task, rooms, shape, SENSORS, threads=threads, seed=seed)
    experts = Experts(env, num_threads=env.num_threads)
    count, q0, rows = np.zeros(worlds, np.int64), Kinematics(robot=shape.robot).q0, 0
    most = worlds * (steps // every + steps // SETTLES + 1)
    looks = Looks(
        pictures=np.zeros((most, len(shape.cameras), *shape.picture[::-1], 3), np.uint8),
        body=np.zeros((most, shape.sensed), np.float32),
        place=np.zeros((most, len(finding.numbers)), np.float32),
        wall=np.zeros(most, np.float32),
        room=np.zeros(most, np.int64),
    )
    seen, _ = env.reset(seed=seed)
    for _ in range(steps):
        label = experts.label()
        at = np.flatnonzero((count % every == 0) & (poses.of(seen, "robot")[:, 2] > finding.above))
        if len(at):
            new = slice(rows, rows := rows + len(at))
            for camera, name in enumerate(shape.cameras):
                np.copyto(looks.pictures[new, camera], seen[name][at], casting="unsafe")
            body = columns_of(seen, (*SENSED, "joint_position"))[at]
            looks.body[new] = np.concatenate([body, touch(seen)[at]], axis=1) if shape.touched else body
            looks.place[new] = place_of(finding, seen)[at]
            looks.wall[new] = at_wall(seen)[at]
            looks.room[new] = np.asarray(rooms)[at]
        last = q0 + 0.5 * seen["last_action"]
        taught = np.where(np.isfinite(label.joint_target), label.joint_target, last)
        seen, _, terminated, truncated, _ = env.step(taught)
        over = terminated | truncated
        count += 1
        count[over] = 0
    env.close()
    return Looks(**{field.name: getattr(looks, field.name)[:rows] for field in fields(Looks)}), {"looks": rows}


def place_of(finding: Finding, seen: Any) -> Array:
    """The numbers of all worlds that are to be found."""
    robot = poses.of(seen, "robot")
    if finding is ON_LADDER:
        pelvis = poses.compose(poses.inverse(poses.of(seen, "ladder")), robot)
        return np.column_stack((pelvis[:, :2], poses.heading(pelvis[:, 3:]) - np.pi / 2))
    heading = poses.heading(robot[:, 3:])
    cos, sin = np.cos(heading), np.sin(heading)

    def ahead(at: Array) -> tuple[Array, Array]:
        x, y = (at - robot[:, :2]).T
        return cos * x + sin * y, cos * y - sin * x

    # The fresh bulb stands on the bench, which never turns.
    bench = ahead(poses.of(seen, "fresh_bulb")[:, :2] - np.array(SCENE["bench"]["bulb_spot"]))
    return np.column_stack((robot[:, :2], cos, sin, *bench, *ahead(poses.of(seen, "crate")[:, :2])))


def at_wall(seen: Any) -> Array:
    """True where the socket is at a wall."""
    axis = poses.rotate(poses.of(seen, "socket")[:, 3:], np.array([0.0, 0.0, 1.0]))
    return (np.abs(axis[:, 2]) < 0.5).astype(np.float32)


class Finder:
    """Looks in the memory of a device, from which a network learns where things are: numbers and their standard deviations by their
    likelihood."""

    def __init__(self, shape: Shape, looks: Sequence[Looks], batch: int, device: str) -> None:
        self.shape, self.batch, self.device = shape, batch, device
        self.finding = next(each for each in (ON_LADDER, IN_ROOM) if each.finds == shape.finds)
        self.pictures = on_device(looks, device)
        self.body, self.place, self.wall, room = (
            torch.from_numpy(np.concatenate([getattr(each, name) for each in looks])).to(device)
            for name in ("body", "place", "wall", "room")
        )
        self.learned, self.kept_out = (torch.nonzero((room % KEPT_OUT == 0) == kept)[:, 0] for kept in (False, True))
        if not len(self.learned):
            raise SystemExit("there is no look to learn from; take more --worlds or --steps")
        # The rest of its input, one row for each task: all pictures are current, and it is in no phase.
        tasks = np.array([place for place, task in enumerate(shape.tasks) if task in self.finding.tasks])
        none = np.zeros(len(tasks), np.int64)
        still = np.zeros((len(tasks), 3))
        state = state_of(
            shape, np.zeros((len(tasks), shape.sensed)), still, [still] * (len(shape.ages) - 1), none - 1, none, tasks
        )
        self.rest = torch.from_numpy(state[:, shape.sensed :] if shape.acts else state[:, :0]).to(device)
        self.of = torch.tensor(self.finding.spread_of, device=device)

    def begin(self, network: Network) -> None:
        """Takes the scales of what comes out."""
        numbers, spreads, first = len(self.finding.numbers), len(self.finding.deviations), -len(self.shape.finds)
        centre, scale = network.centre[first:], network.scale[first:]
        centre[:numbers] = self.place.mean(0)
        scale[:numbers] = torch.tensor(self.finding.widths, device=self.device)
        centre[numbers : numbers + spreads] = math.log(0.2 * min(self.finding.widths))

    def answers(self, network: Network, seen: torch.Tensor, body: torch.Tensor, drawn: torch.Tensor) -> torch.Tensor:
        """The numbers that are found, from normalised pictures and body; ``drawn`` says in which of the tasks it believes to be."""
        with torch.autocast(self.device, torch.bfloat16, enabled=self.device == "cuda" and network.training):
            embedding = network.encode(seen)[:, None].expand(-1, len(self.shape.ages), -1)
            output, _ = network.decide(embedding, torch.cat((body, self.rest[drawn]), dim=1))
        return network.answer(output.float())[:, -len(self.shape.finds) :]

    def loss(self, network: Network, generator: torch.Generator) -> tuple[torch.Tensor, torch.Tensor]:
        """Of a batch that is drawn; and the means of the squares of the errors, and of the surprise about the wall."""
        at = self.learned[torch.randint(len(self.learned), (self.batch,), device=self.device, generator=generator)]
        drawn = torch.randint(len(self.rest), (self.batch,), device=self.device, generator=generator)
        seen = varied(normalised(self.pictures[at][:, None]), generator, 0)[:, 0]
        noise = torch.randn((self.batch, self.shape.sensed), device=self.device, generator=generator)
        body = self.body[at] + 0.02 * network.deviation[: self.shape.sensed] * noise
        answer, numbers = self.answers(network, seen, body, drawn), len(self.finding.numbers)
        off, logarithm = answer[:, :numbers] - self.place[at], answer[:, numbers + self.of].clamp(*LOGARITHMS)
        surprise = 0.5 * (off * torch.exp(-logarithm)).square() + logarithm
        says_wall = answer.new_zeros(())
        if self.finding.says_wall:
            says_wall = nn.functional.binary_cross_entropy_with_logits(answer[:, -1], self.wall[at])
        loss = surprise.sum() / self.batch + says_wall
        return loss, torch.cat((off.square().mean(0), says_wall[None])).detach()

    @torch.inference_mode()
    def errors(self, network: Network) -> dict[str, float]:
        """Root mean squares, m and rad, in rooms that are kept out of training, and the share of looks in which it is wrong about the wall."""
        numbers = len(self.finding.numbers)
        totals = torch.zeros(numbers + 1, device=self.device)
        for at in self.kept_out.split(self.batch):
            answer = self.answers(network, normalised(self.pictures[at]), self.body[at], at % len(self.rest))
            off = answer[:, :numbers] - self.place[at]
            wrong = ((answer[:, -1] > 0) != (self.wall[at] > 0)).sum() * self.finding.says_wall
            totals += torch.cat((off.square().sum(0), wrong[None]))
        looked = max(1, len(self.kept_out))
        print(f"kept out: {told(self.finding, totals / looked)}", flush=True)
        errors = (*(totals[:-1] / looked).sqrt().tolist(), totals[-1].item() / looked)
        return dict(zip((*self.finding.numbers, "wall"), errors))


def fit(
    shape: Shape, looks: Sequence[Looks], given: argparse.Namespace, device: str
) -> tuple[Network, dict[str, float]]:
    """Trains a network. Returns its errors, too."""
    torch.manual_seed(given.seed)
    generator = torch.Generator(device).manual_seed(given.seed)
    finder, network = Finder(shape, looks, given.batch, device), Network(shape).to(device)
    network.mean, network.deviation = finder.body.mean(0), finder.body.std(0).clamp(min=MIN_DEVIATION)
    finder.begin(network)
    optimizer = torch.optim.AdamW(network.parameters(), lr=given.rate, weight_decay=1e-4)
    network.train()
    began, every = time.monotonic(), max(1, min(1000, given.updates // 20))
    totals = torch.zeros(len(finder.finding.numbers) + 1, device=device)
    print(f"{len(finder.learned)} looks to learn, {len(finder.kept_out)} kept out, {device}", flush=True)
    for step in range(1, given.updates + 1):
        rate = learning_rate(given.rate, step, given.updates)
        for group in optimizer.param_groups:
            group["lr"] = rate
        loss, means = finder.loss(network, generator)
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
        totals += means
        if step % every == 0:
            speed = step / (time.monotonic() - began)
            print(f"  step {step}: {told(finder.finding, totals / every)}; {speed:.0f} steps/s", flush=True)
            totals.zero_()
    network.eval()
    return network, finder.errors(network)


def told(finding: Finding, means: torch.Tensor) -> str:
    """Errors in words, of means of squares, and of the wall."""
    errors = zip(finding.numbers, (means[:-1].sqrt() * 1e3).tolist())
    said = f"{' '.join(f'{name} {error:.1f}' for name, error in errors)} mm and mrad"
    return f"{said}, wall {means[-1]:.4f}" if finding.says_wall else said
