"""Learns from pictures where the robot is on the ladder."""

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
from ..expert import Experts
from ..kinematics import Kinematics
from ..vector import VectorEnv
from .lessons import SENSED, SETTLES, Array, Columns, columns_of, lesson_worlds
from .network import MIN_DEVIATION, Network, Shape, learning_rate, normalised, on_device, varied

TASKS = ("S02", "S03", "S04", "S10", "S11", "S12")
"""Those that are played with what is found: the robot gets onto the ladder, or is there."""
LOOKS_IN = ("S03", "S04", "S11", "S12")
"""Those that begin on the platform."""
PLACE = ("x", "y", "heading")
"""Of the pelvis in the ladder's frame, m, and of where it looks from the way up, rad."""
FINDS = (*PLACE, *(f"log_{name}" for name in PLACE), "wall")
"""Numbers that come out, as ``crates/policies/src/see/finds.rs`` reads them: the place, the logarithms of its standard deviations, and
above 0 where the socket is at a wall."""
SENSORS = ("proprioception", "last_action", "privileged")
UP_M = 1.5
"""The robot looks for its place from where its pelvis is this high."""
LOGARITHMS = -9.0, 2.0
"""Range of the logarithms of standard deviations."""
KEPT_OUT = 16
"""One room of so many is kept out of training."""
WIDTHS = (0.05, 0.05, 0.1)
"""Counts as 1: m, and rad for the heading."""


@dataclass
class Looks(Columns):
    """Pictures, and what they show."""

    pictures: Array
    """Bytes: looks x cameras x height x width x 3."""
    body: Array
    """The body's own senses."""
    place: Array
    """The place that is to be found, looks x 3."""
    wall: Array
    """1 where the socket is at a wall, 0 where it is at the ceiling."""
    room: Array


def find(given: argparse.Namespace) -> None:
    """Looks on while the expert plays, and trains."""
    device = "cuda" if torch.cuda.is_available() else "cpu"
    env = VectorEnv(given.tasks[0], 1)
    shape = Shape(
        TASKS,
        picture=tuple(given.picture),
        ages=(0,),
        joints=tuple(env.action_names),
        embedding=256,
        blind=given.blind,
        finds=FINDS,
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
    worlds, every = len(rooms), shape.every
    env = lesson_worlds(task, rooms, shape, SENSORS, threads=threads, seed=seed)
    experts = Experts(env, num_threads=env.num_threads)
    count, q0, rows = np.zeros(worlds, np.int64), Kinematics().q0, 0
    most = worlds * (steps // every + steps // SETTLES + 1)
    looks = Looks(
        pictures=np.zeros((most, len(shape.cameras), *shape.picture[::-1], 3), np.uint8),
        body=np.zeros((most, shape.sensed), np.float32),
        place=np.zeros((most, len(PLACE)), np.float32),
        wall=np.zeros(most, np.float32),
        room=np.zeros(most, np.int64),
    )
    seen, _ = env.reset(seed=seed)
    for _ in range(steps):
        label = experts.label()
        pelvis = poses.compose(poses.inverse(poses.of(seen, "ladder")), poses.of(seen, "robot"))
        at = np.flatnonzero((count % every == 0) & (pelvis[:, 2] > UP_M))
        if len(at):
            new = slice(rows, rows := rows + len(at))
            for camera, name in enumerate(shape.cameras):
                np.copyto(looks.pictures[new, camera], seen[name][at], casting="unsafe")
            looks.body[new] = columns_of(seen, (*SENSED, "joint_position"))[at]
            looks.place[new, :2], looks.place[new, 2] = pelvis[at, :2], poses.heading(pelvis[at, 3:]) - np.pi / 2
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
    learned, kept_out = (torch.nonzero((room % KEPT_OUT == 0) == kept)[:, 0] for kept in (False, True))
    numbers = len(PLACE)
    network = Network(shape).to(device)
    network.mean, network.deviation = body.mean(0), body.std(0).clamp(min=MIN_DEVIATION)
    network.centre[:numbers] = place.mean(0)
    network.scale[:numbers] = torch.tensor(WIDTHS, device=device)
    network.centre[numbers : 2 * numbers] = math.log(0.01)
    optimizer = torch.optim.AdamW(network.parameters(), lr=given.rate, weight_decay=1e-4)
    network.train()
    began, every = time.monotonic(), max(1, min(1000, given.updates // 20))
    totals = torch.zeros(numbers + 1, device=device)
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
        off, logarithm = answer[:, :numbers] - place[at], answer[:, numbers : 2 * numbers].clamp(*LOGARITHMS)
        surprise = 0.5 * (off * torch.exp(-logarithm)).square() + logarithm
        says_wall = nn.functional.binary_cross_entropy_with_logits(answer[:, -1], wall[at])
        optimizer.zero_grad(set_to_none=True)
        (surprise.sum() / given.batch + says_wall).backward()
        nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
        totals += torch.cat((off.square().mean(0), says_wall[None])).detach()
        if step % every == 0:
            speed = step / (time.monotonic() - began)
            print(f"  step {step}: {told(totals / every)}; {speed:.0f} steps/s", flush=True)
            totals.zero_()
    network.eval()
    totals.zero_()
    with torch.inference_mode():
        for at in kept_out.split(given.batch):
            output, _ = network.decide(network.encode(normalised(pictures[at]))[:, None], body[at])
            answer = network.answer(output)
            off = answer[:, :numbers] - place[at]
            wrong = ((answer[:, -1] > 0) != (wall[at] > 0)).sum()
            totals += torch.cat((off.square().sum(0), wrong[None]))
    looked = max(1, len(kept_out))
    print(f"kept out: {told(totals / looked)}", flush=True)
    errors = (*(totals[:-1] / looked).sqrt().tolist(), totals[-1].item() / looked)
    return network, dict(zip((*PLACE, "wall"), errors))


def told(means: torch.Tensor) -> str:
    """Errors in words, of means of squares, and of the wall."""
    errors = zip(PLACE, (means[:-1].sqrt() * 1e3).tolist())
    return f"{' '.join(f'{name} {error:.1f}' for name, error in errors)} mm and mrad, wall {means[-1]:.4f}"
