"""Episodes in which a student or the teacher drives, and the teacher says in each state what it would do."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from .. import poses
from ..expert import Experts
from ..hand import CONTROL_DT
from ..vector import VectorEnv
from ..whole_body import DEAD_ZONE, LEGS_AND_WAIST, WholeBodies
from .network import Network, Shape, normalised

SETTLES = 25
"""Control steps for which the robot stands first, and that are not learned."""
SLEW = np.array([0.6, 0.6, 1.2])
"""Largest changes of the velocity, m/s^2 and rad/s^2, as in ``crates/policies/src/gait.rs``."""
RANGES = np.array([[-0.3, 0.6], [-0.35, 0.35], [-0.8, 0.8]])
"""Of the commanded velocity, m/s and rad/s, as in ``crates/policies/src/see.rs``."""
GOALS = {"S05": "crate", "S07": "fresh_bulb", "S09": "ladder"}
"""The thing to which each task walks."""
SENSED = ("base_angular_velocity", "projected_gravity", "base_linear_velocity", "base_height")
SENSORS = ("proprioception", "hand_contact", "last_action", "privileged")
STUMBLES = 0.02, (15, 75)
"""In a lesson that the teacher drives: chance of a decision to be replaced by a random velocity, and for how many control steps."""

Array = NDArray[Any]


@dataclass
class Lesson:
    """Decisions of many episodes; a row of each array is one."""

    pictures: Array
    """Bytes, cameras x height x width x 3."""
    body: Array
    """The part of proprioception that is read."""
    place: Array
    """x, y, m, and heading, rad, by the robot's own reckoning."""
    back: Array
    """Decisions of its episode before it."""
    task: Array
    velocity: Array
    """The teacher's, m/s and rad/s."""
    stands: Array
    goal: Array
    """Where the goal is, ahead and to the left, m."""
    settles: Array
    """Those that are not learned."""

    def save(self, folder: Path) -> None:
        """Writes each array into a file of its own."""
        folder.mkdir(parents=True, exist_ok=True)
        for field in fields(self):
            np.save(folder / f"{field.name}.npy", getattr(self, field.name))

    @classmethod
    def load(cls, folder: Path) -> "Lesson":
        """Reads what :meth:`save` wrote."""
        return cls(**{field.name: np.load(folder / f"{field.name}.npy", mmap_mode="r") for field in fields(cls)})


class Memory:
    """The pictures that a student has seen in each world, as far back as it looks."""

    def __init__(self, network: Network, worlds: int, device: str) -> None:
        self.network, self.device = network, device
        self.ages = [age // network.shape.every for age in network.shape.ages]
        self.room = self.ages[-1] + 1
        width = network.shape.embedding * len(network.shape.cameras)
        self.seen = torch.zeros((worlds, self.room, width), device=device)
        self.places = np.zeros((worlds, self.room, 3))

    @torch.inference_mode()
    def decide(self, worlds: Array, pictures: Array, body: Array, place: Array, back: Array, task: int) -> Array:
        """The network's answer in these worlds: velocity, m/s and rad/s, and whether to stand."""
        network = self.network
        now = back % self.room
        with torch.autocast(self.device, torch.bfloat16, enabled=self.device == "cuda"):
            given = normalised(torch.from_numpy(pictures).to(self.device))
            embedding = network.encode(given).float()
        at = torch.from_numpy(worlds).to(self.device)
        self.seen[at, torch.from_numpy(now).to(self.device)] = embedding
        self.places[worlds, now] = place
        slots = [(back - np.minimum(age, back)) % self.room for age in self.ages]
        seen = torch.stack([self.seen[at, torch.from_numpy(slot).to(self.device)] for slot in slots], dim=1)
        old = [self.places[worlds, slot] for slot in slots[1:]]
        state = torch.from_numpy(state_of(network.shape.tasks, body, place, old, np.full(len(worlds), task)))
        output, _ = network.decide(seen, state.to(self.device))
        return network.speeds(output).cpu().numpy()


def state_of(tasks: Sequence[str], body: Array, place: Array, old: Sequence[Array], task: Array) -> NDArray[np.float32]:
    """The numbers that the head reads beside embeddings, count x numbers: body, where the robot was at each old picture, and the task."""
    cos, sin = np.cos(place[:, 2]), np.sin(place[:, 2])
    parts = [body]
    for then in old:
        x, y, turn = (then - place).T
        parts.append(np.stack((cos * x + sin * y, cos * y - sin * x, np.cos(turn), np.sin(turn)), axis=1))
    return np.concatenate([*parts, np.eye(len(tasks))[task]], axis=1).astype(np.float32)


class Gaits:
    """Walks of many worlds on command, as ``crates/policies/src/gait.rs`` does it; arms and hands are the teacher's."""

    def __init__(self, worlds: int, threads: int) -> None:
        self.bodies = WholeBodies(worlds, threads)
        self.velocity = np.zeros((worlds, 3))
        self.commands = np.zeros((worlds, 7))
        self.commands[:, 3] = 0.75
        self.goals = np.full((worlds, 2, 7), np.nan)

    def reset(self, marks: Array) -> None:
        """Begins an episode in these worlds."""
        self.bodies.reset(marks)
        self.velocity[marks] = 0.0

    def targets(self, sensed: Array, wanted: Array, steps: Array, others: Array) -> Array:
        """Joint targets, rad; ``others`` are those of a teacher."""
        goes = (np.abs(wanted) >= DEAD_ZONE).any(axis=1) & (steps >= SETTLES)
        change = np.clip(wanted - self.velocity, -SLEW * CONTROL_DT, SLEW * CONTROL_DT)
        self.velocity = np.where(goes[:, None], self.velocity + change, 0.0)
        self.commands[:, :3] = self.velocity
        targets = others.copy()
        targets[:, :LEGS_AND_WAIST] = self.bodies(sensed, self.commands, self.goals)[:, :LEGS_AND_WAIST]
        return targets


def play(
    task: str,
    rooms: Sequence[int],
    steps: int,
    *,
    shape: Shape,
    student: Network | None,
    threads: int | None,
    seed: int,
    device: str,
    takes_over: float = 0.0,
) -> tuple[Lesson, int, int, int]:
    """Plays episodes in a world for each room, one after the other, for some control steps, and returns what was seen, the number of
    episodes that ended, how many of them succeeded by the strict judge, and the number of worlds in which none ended.

    Without a student the teacher drives, and stumbles now and then. With one, the teacher takes over in a share of the episodes, at a
    time drawn from the whole, and ends them.
    """
    worlds, cameras, every = len(rooms), shape.cameras, shape.every
    env = VectorEnv(
        task,
        worlds,
        seeds=rooms,
        episodes=1,
        num_threads=threads,
        seed=seed,
        sensors=[*SENSORS, *(f"{camera}@{round(1 / (every * CONTROL_DT))}" for camera in cameras)],
        image_size=shape.picture,
        action_form="joint_target",
        protocol="strict",
        copy=False,
        final_obs=False,
    )
    random, number = np.random.default_rng([seed, worlds]), shape.tasks.index(task)
    late = np.random.default_rng([seed, worlds, 1])
    gaits, experts = Gaits(worlds, env.num_threads), Experts(env, num_threads=env.num_threads)
    memory = None if student is None else Memory(student, worlds, device)
    count, place, wanted = np.zeros(worlds, np.int64), np.zeros((worlds, 3)), np.zeros((worlds, 3))
    stumbles, has_ended = np.zeros(worlds, np.int64), np.zeros(worlds, np.bool_)

    def until() -> Array:
        """The control step of each world's episode from which the teacher drives."""
        return np.where(late.random(worlds) < takes_over, late.integers(0, steps, worlds), steps)

    drives_until = until()
    rows: list[tuple[Array, ...]] = []
    ended = successes = 0
    seen, _ = env.reset(seed=seed)
    for _ in range(steps):
        label = experts.label()
        body = np.concatenate([np.reshape(seen[field], (worlds, -1)) for field in SENSED], axis=1).astype(np.float64)
        turning, ahead, left = body[:, 2], body[:, 6], body[:, 7]
        moving = (count > 0) * CONTROL_DT
        cos, sin = np.cos(place[:, 2]), np.sin(place[:, 2])
        place += moving[:, None] * np.stack((cos * ahead - sin * left, sin * ahead + cos * left, turning), axis=1)
        velocity = np.nan_to_num(label.body_command[:, :3])
        at = np.flatnonzero(count % every == 0)
        if len(at):
            pictures = np.stack([seen[camera][at] for camera in cameras], axis=1).astype(np.uint8)
            back = count[at] // every
            stands = ~(np.abs(velocity[at]) >= DEAD_ZONE).any(axis=1)
            settles = (count[at] < SETTLES) | ~label.can_label[at]
            row = (
                at,
                pictures,
                body[at],
                place[at],
                back,
                velocity[at],
                stands,
                _ahead(seen, GOALS[task])[at],
                settles,
            )
            rows.append(tuple(np.array(part, np.float32 if part.dtype == np.float64 else None) for part in row))
            if memory is not None:
                answer = memory.decide(at, pictures, body[at].astype(np.float32), place[at], back, number)
                within = np.clip(answer[:, :3], RANGES[:, 0], RANGES[:, 1])
                wanted[at] = np.where(answer[:, 3:] > 0, 0.0, within)
                taken = at[count[at] >= drives_until[at]]
                wanted[taken] = velocity[taken]
        if memory is None:
            begins = (random.random(worlds) < STUMBLES[0] / every) & (stumbles == 0) & (count > SETTLES)
            stumbles[begins] = random.integers(*STUMBLES[1], begins.sum())
            drawn = random.uniform(RANGES[:, 0], RANGES[:, 1], (worlds, 3))
            wanted[begins] = drawn[begins]
            steady = stumbles == 0
            wanted[steady] = velocity[steady]
            stumbles = np.maximum(stumbles - 1, 0)
        sensed = np.concatenate([body, seen["joint_position"], seen["joint_velocity"]], axis=1)
        targets = gaits.targets(sensed, wanted, count, label.joint_target)
        seen, _, terminated, truncated, info = env.step(targets)
        over = terminated | truncated
        count += 1
        if over.any():
            ended, successes = ended + int(over.sum()), successes + int(info["success"][over].sum())
            has_ended |= over
            drives_until[over] = until()[over]
            count[over], place[over], wanted[over], stumbles[over] = 0, 0.0, 0.0, 0
            gaits.reset(over)
    env.close()
    return _lesson(rows, number), ended, successes, int((~has_ended).sum())


def _ahead(seen: Any, thing: str) -> Array:
    """Where a thing is, ahead and to the left of the robot on the floor, m."""
    robot, goal = poses.of(seen, "robot"), poses.of(seen, thing)
    (x, y), look = (goal[:, :2] - robot[:, :2]).T, poses.heading(robot[:, 3:])
    return np.stack((np.cos(look) * x + np.sin(look) * y, np.cos(look) * y - np.sin(look) * x), axis=1)


def _lesson(rows: list[tuple[Array, ...]], task: int) -> Lesson:
    """Rows in the order of worlds, then of time, so that what an episode saw before stands before it."""
    columns = [np.concatenate(parts) for parts in zip(*rows)]
    order = np.argsort(columns[0], kind="stable")
    pictures, body, place, back, velocity, stands, goal, settles = (column[order] for column in columns[1:])
    return Lesson(pictures, body, place, back, np.full(len(order), task), velocity, stands, goal, settles)
