"""Learns from pictures where the robot is: on the ladder, or in the room."""

import argparse
import math
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import torch
from torch import nn

from .. import poses
from .._scene import SCENE
from ..expert import Experts
from ..kinematics import Kinematics
from ..vector import VectorEnv
from .lessons import SENSED, SETTLES, Array, Columns, columns_of, lesson_worlds
from .network import MIN_DEVIATION, Network, Shape, learning_rate, normalised, on_device, varied

SENSORS = ("proprioception", "last_action", "privileged")
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
    env = VectorEnv(given.tasks[0], 1)
    shape = Shape(
        finding.tasks,
        picture=tuple(given.picture),
        every=finding.every,
        ages=(0,),
        joints=tuple(env.action_names),
        embedding=256,
        blind=given.blind,
        finds=finding.finds,
    )
    env.close()
    # One task's worlds work while another's wait for the slowest of theirs.
    with ThreadPoolExecutor() as pool:
        looks = list(pool.map(lambda index: looks_of(index, shape, given), range(len(given.tasks))))
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


def looks_of(index: int, shape: Shape, given: argparse.Namespace) -> Looks:
    """Looks in a task, which are made where the run has none yet."""
    task = given.tasks[index]
    folder = given.out / f"looks-{task}"
    if not (folder / "done").exists():
        began, worlds = time.monotonic(), given.worlds[index % len(given.worlds)]
        rooms = range(given.first_room, given.first_room + worlds)
        seen = look(task, rooms, given.steps, shape=shape, threads=given.threads, seed=given.seed + index)
        seen.save(folder)
        (folder / "done").touch()
        print(f"{task}: {len(seen.wall)} looks, {time.monotonic() - began:.0f} s", flush=True)
    return Looks.load(folder)


def look(task: str, rooms: Sequence[int], steps: int, *, shape: Shape, threads: int | None, seed: int) -> Looks:
    """Pictures of the cameras in a world for each room while the expert plays."""
    worlds, every, finding = len(rooms), shape.every, finding_of(task)
    env = lesson_worlds(task, rooms, shape, SENSORS, threads=threads, seed=seed)
    experts = Experts(env, num_threads=env.num_threads)
    count, q0, rows = np.zeros(worlds, np.int64), Kinematics().q0, 0
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
            looks.body[new] = columns_of(seen, (*SENSED, "joint_position"))[at]
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
    return Looks(**{field.name: getattr(looks, field.name)[:rows] for field in fields(Looks)})


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


def fit(
    shape: Shape, looks: Sequence[Looks], given: argparse.Namespace, device: str
) -> tuple[Network, dict[str, float]]:
    """Trains a network: numbers and their standard deviations by their likelihood. Returns its errors, too, in rooms that are kept out of
    training: root mean squares, m and rad, and the share of looks in which it is wrong about the wall."""
    torch.manual_seed(given.seed)
    generator = torch.Generator(device).manual_seed(given.seed)
    pictures = on_device(looks, device)
    body, place, wall, room = (
        torch.from_numpy(np.concatenate([getattr(each, name) for each in looks])).to(device)
        for name in ("body", "place", "wall", "room")
    )
    finding = next(each for each in (ON_LADDER, IN_ROOM) if each.finds == shape.finds)
    learned, kept_out = (torch.nonzero((room % KEPT_OUT == 0) == kept)[:, 0] for kept in (False, True))
    numbers, spreads = len(finding.numbers), len(finding.deviations)
    network = Network(shape).to(device)
    network.mean, network.deviation = body.mean(0), body.std(0).clamp(min=MIN_DEVIATION)
    network.centre[:numbers] = place.mean(0)
    network.scale[:numbers] = torch.tensor(finding.widths, device=device)
    network.centre[numbers : numbers + spreads] = math.log(0.2 * min(finding.widths))
    optimizer = torch.optim.AdamW(network.parameters(), lr=given.rate, weight_decay=1e-4)
    network.train()
    began, every = time.monotonic(), max(1, min(1000, given.updates // 20))
    totals = torch.zeros(numbers + 1, device=device)
    of = torch.tensor(finding.spread_of, device=device)
    print(f"{len(learned)} looks to learn, {len(kept_out)} kept out, {device}", flush=True)
    for step in range(1, given.updates + 1):
        rate = learning_rate(given.rate, step, given.updates)
        for group in optimizer.param_groups:
            group["lr"] = rate
        at = learned[torch.randint(len(learned), (given.batch,), device=device, generator=generator)]
        seen = varied(normalised(pictures[at][:, None]), generator, 0)[:, 0]
        noise = torch.randn((given.batch, shape.state), device=device, generator=generator)
        with torch.autocast(device, torch.bfloat16, enabled=device == "cuda"):
            output, _ = network.decide(network.encode(seen)[:, None], body[at] + 0.02 * network.deviation * noise)
        answer = network.answer(output.float())
        off, logarithm = answer[:, :numbers] - place[at], answer[:, numbers + of].clamp(*LOGARITHMS)
        surprise = 0.5 * (off * torch.exp(-logarithm)).square() + logarithm
        says_wall = answer.new_zeros(())
        if finding.says_wall:
            says_wall = nn.functional.binary_cross_entropy_with_logits(answer[:, -1], wall[at])
        optimizer.zero_grad(set_to_none=True)
        (surprise.sum() / given.batch + says_wall).backward()
        nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
        totals += torch.cat((off.square().mean(0), says_wall[None])).detach()
        if step % every == 0:
            speed = step / (time.monotonic() - began)
            print(f"  step {step}: {told(finding, totals / every)}; {speed:.0f} steps/s", flush=True)
            totals.zero_()
    network.eval()
    totals.zero_()
    with torch.inference_mode():
        for at in kept_out.split(given.batch):
            output, _ = network.decide(network.encode(normalised(pictures[at]))[:, None], body[at])
            answer = network.answer(output)
            off = answer[:, :numbers] - place[at]
            wrong = ((answer[:, -1] > 0) != (wall[at] > 0)).sum() * finding.says_wall
            totals += torch.cat((off.square().sum(0), wrong[None]))
    looked = max(1, len(kept_out))
    print(f"kept out: {told(finding, totals / looked)}", flush=True)
    errors = (*(totals[:-1] / looked).sqrt().tolist(), totals[-1].item() / looked)
    return network, dict(zip((*finding.numbers, "wall"), errors))


def told(finding: Finding, means: torch.Tensor) -> str:
    """Errors in words, of means of squares, and of the wall."""
    errors = zip(finding.numbers, (means[:-1].sqrt() * 1e3).tolist())
    said = f"{' '.join(f'{name} {error:.1f}' for name, error in errors)} mm and mrad"
    return f"{said}, wall {means[-1]:.4f}" if finding.says_wall else said
