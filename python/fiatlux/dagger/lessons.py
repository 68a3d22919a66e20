"""Episodes in which a student or the teacher drives, and the teacher says in each state what it would do."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
import torch
from numpy.typing import NDArray

from .. import poses
from ..expert import Experts
from ..hand import CONTROL_DT
from ..kinematics import Kinematics
from ..vector import VectorEnv
from ..whole_body import ARMS, DEAD_ZONE, LEGS_AND_WAIST, WholeBodies
from .network import CLOCKS, POSTURE, WALKS, Network, Shape, load, normalised
from .rollouts import Rollouts

SETTLES = 25
"""Control steps for which the robot stands first, and that are not learned."""
SLEW = np.array([0.6, 0.6, 1.2])
"""Largest changes of the velocity, m/s^2 and rad/s^2, as in ``crates/policies/src/gait.rs``."""
RANGES = np.array([[-0.3, 0.6], [-0.35, 0.35], [-0.8, 0.8]])
"""Of the commanded velocity, m/s and rad/s, as in ``crates/policies/src/see.rs``."""
GOALS = {"S05": "crate", "S07": "fresh_bulb", "S09": "ladder", "S06": "crate", "S08": "fresh_bulb"}
"""The thing to which each task walks, or at which it works."""
PHASES = {
    "S06": ("StepUp", "Settle", "Above", "Lower", "Rest", "Open", "Rise", "StandUp", "TakeDown"),
    "S08": (
        *("StepBack", "Raise", "StepUp", "Settle", "PreGrasp", "Approach", "Close", "Lift", "Hold", "Open", "Retreat"),
    ),
}
"""The expert's phases in the tasks for a network that has hands, as in ``crates/policies/src/hands``."""
TEACHERS = {"S08": "grasp.turns = { first = 0.545, last = 0.545, count = 1 }\nmotion.error = 0.03\n"}
"""Parameters of the expert of a lesson in which it differs from the one that plays. S08: of twelve turns of the fingers that one takes the
one with the most room for its arm, which no student sees, and it waits for a hand that is more exact than a student's."""
LAGS = 0.4, 30
"""In a lesson with hands that the teacher drives, what stands for the student's own phase: share of the changes that it is behind the
teacher, and for how many control steps at most."""
RATES = 1.2, 3.0
"""Largest rates of the targets of arms and of hands, rad/s, as in ``crates/policies/src/gait.rs``."""
MAX_TOUCH_N = 20.0
"""A force that counts as the largest."""
UPRIGHT = np.array([0.75, 0.0, 0.0, 0.0])
"""Height, m, roll, pitch and yaw, rad, of a robot that only walks."""
SLOW_NOISE = 0.02, 1.0
"""In a lesson with hands that the teacher drives: largest deviation of its noise on the targets of arms and hands, rad, and the time
in which that changes, s."""
HANDED_OVER = 0.5, 12.0
"""In a lesson with hands that a student drives: share of the episodes that the teacher begins, and for how long at most, s."""
HEAD_OF_HANDS = (512, 512)
"""Widths of the head's layers of a network that works with hands alone."""
HEAD_OF_ALL = (768, 768)
"""The same of one that has other tasks, too."""
EMBEDDING_OF_ALL = 256
"""Numbers that an encoder makes of a picture, of a network that acts and finds places."""
STARTS = 4
"""Starts of the task in each room, which episodes draw from."""
FAR_BEHIND_M = 0.15
"""Where the height that the teacher commands is so far from the robot's, it does what comes later than what the robot does: nothing is
learned there."""
SENSED = ("base_angular_velocity", "projected_gravity", "base_linear_velocity", "base_height")
SENSORS = ("proprioception", "hand_contact", "last_action", "privileged")
STUMBLES = 0.02, (15, 75)
"""In a lesson that the teacher drives: chance of a decision to be replaced by a random velocity, and for how many control steps."""

Array = NDArray[Any]


Kind = TypeVar("Kind", bound="Columns")


class Columns:
    """Arrays of a dataclass, each in a file of its own."""

    def save(self, folder: Path) -> None:
        """Writes each array into a file of its own."""
        folder.mkdir(parents=True, exist_ok=True)
        for field in fields(cast(Any, self)):
            np.save(folder / f"{field.name}.npy", getattr(self, field.name))

    @classmethod
    def load(cls: type[Kind], folder: Path) -> Kind:
        """Reads what :meth:`save` wrote."""
        names = [field.name for field in fields(cast(Any, cls))]
        return cls(**{name: np.load(folder / f"{name}.npy", mmap_mode="r") for name in names})


@dataclass
class Lesson(Columns):
    """Pictures and decisions of many episodes."""

    pictures: Array
    """Bytes, a row for each look: cameras x height x width x 3."""
    frame: Array
    """Of each decision, the row of its newest picture."""
    body: Array
    """The part of the body's senses that is read."""
    place: Array
    """x, y, m, and heading, rad, by the robot's own reckoning."""
    where: Array
    """The same at each look."""
    back: Array
    """Looks of its episode before its newest one."""
    task: Array
    velocity: Array
    """The teacher's, m/s and rad/s."""
    stands: Array
    moves: Array
    """The teacher's posture and targets of arms and hands, for a network that has hands."""
    phase: Array
    """Which phase the student believed to be in, -1 for none, and for how many control steps."""
    since: Array
    does: Array
    """The teacher's phase, -1 where it is none of the network's."""
    goal: Array
    """Where the goal is, ahead and to the left, m."""
    settles: Array
    """Those that are not learned."""


class Notebook:
    """Takes down the looks and decisions of many worlds, in memory that is there from the beginning."""

    def __init__(self, worlds: int, looks: int, decisions: int, shape: Shape) -> None:
        width, height = shape.picture
        self.looked, self.decided = np.zeros(worlds, np.int64), np.zeros(worlds, np.int64)
        self.pictures = np.zeros((worlds, looks, len(shape.cameras), height, width, 3), np.uint8)
        self.where = np.zeros((worlds, looks, 3), np.float32)
        widths = {
            "body": (shape.sensed,),
            "place": (3,),
            "velocity": (3,),
            "moves": (shape.moves,),
            "goal": (2,),
        }
        kinds: dict[str, type] = {"stands": np.bool_, "settles": np.bool_}
        kinds |= dict.fromkeys(("frame", "back", "phase", "since", "does"), np.int64)
        names = [field.name for field in fields(Lesson) if field.name not in ("pictures", "where", "task")]
        self.columns: dict[str, Array] = {
            name: np.zeros((worlds, decisions, *widths.get(name, ())), kinds.get(name, np.float32)) for name in names
        }

    def look(self, at: Array, pictures: Sequence[Array], place: Array) -> Array:
        """Takes down what these worlds see, and where they are. Arguments are of all worlds, pictures from each camera. Returns the
        pictures, count x cameras x height x width x 3."""
        rows = self.looked[at]
        for world, row in zip(at, rows):
            for camera, seen in enumerate(pictures):
                # Numbers of pictures are whole.
                np.copyto(self.pictures[world, row, camera], seen[world], casting="unsafe")
        self.where[at, rows] = place[at]
        self.looked[at] += 1
        return self.pictures[at, rows]

    def decide(self, at: Array, **numbers: Any) -> None:
        """Takes down a decision of these worlds; numbers are of all worlds."""
        for name, column in numbers.items():
            self.columns[name][at, self.decided[at]] = column[at]
        self.columns["frame"][at, self.decided[at]] = self.looked[at] - 1
        self.decided[at] += 1

    def lesson(self, task: int) -> Lesson:
        """All, world after world, so that what an episode saw before stands before it."""
        looks = np.arange(self.where.shape[1]) < self.looked[:, None]
        decisions = np.arange(self.columns["back"].shape[1]) < self.decided[:, None]
        self.columns["frame"] += (np.cumsum(self.looked) - self.looked)[:, None]
        columns = {name: column[decisions] for name, column in self.columns.items()}
        tasks = np.full(int(self.decided.sum()), task)
        return Lesson(pictures=self.pictures[looks], where=self.where[looks], task=tasks, **columns)


class Memory:
    """The looks of a student in each world, as far back as it reads."""

    def __init__(self, network: Network, worlds: int, device: str) -> None:
        self.network, self.device = network, device
        self.ages = [age // network.shape.every for age in network.shape.ages]
        self.room = self.ages[-1] + 1
        width = network.shape.embedding * len(network.shape.cameras)
        self.seen = torch.zeros((worlds, self.room, width), device=device)
        self.places = np.zeros((worlds, self.room, 3))

    @torch.inference_mode()
    def look(self, worlds: Array, pictures: Array, place: Array, back: Array) -> None:
        """Keeps the pictures of these worlds, each in the look of its episode that ``back`` looks were before."""
        now = back % self.room
        with torch.autocast(self.device, torch.bfloat16, enabled=self.device == "cuda"):
            embedding = self.network.encode(normalised(torch.from_numpy(pictures).to(self.device))).float()
        at, slot = torch.from_numpy(worlds).to(self.device), torch.from_numpy(now).to(self.device)
        self.seen[at, slot] = embedding
        self.places[worlds, now] = place

    @torch.inference_mode()
    def decide(
        self, worlds: Array, body: Array, place: Array, back: Array, phase: Array, since: Array, task: int
    ) -> Array:
        """The network's answer in these worlds, m/s, rad/s, m and rad, a number for each phase, and what it finds; ``back`` is of the newest
        look."""
        at = torch.from_numpy(worlds).to(self.device)
        slots = [(back - np.minimum(age, back)) % self.room for age in self.ages]
        seen = torch.stack([self.seen[at, torch.from_numpy(slot).to(self.device)] for slot in slots], dim=1)
        old = [self.places[worlds, slot] for slot in slots[1:]]
        state = torch.from_numpy(
            state_of(self.network.shape, body, place, old, phase, since, np.full(len(worlds), task))
        )
        output, _ = self.network.decide(seen, state.to(self.device))
        return self.network.answer(output).cpu().numpy()


def state_of(
    shape: Shape, body: Array, place: Array, old: Sequence[Array], phase: Array, since: Array, task: Array
) -> NDArray[np.float32]:
    """The numbers that the head reads beside embeddings, count x numbers: body, where the robot was at each old picture, phase and time
    in it, and the task."""
    cos, sin = np.cos(place[:, 2]), np.sin(place[:, 2])
    parts = [body]
    for then in old:
        x, y, turn = (then - place).T
        parts.append(np.stack((cos * x + sin * y, cos * y - sin * x, np.cos(turn), np.sin(turn)), axis=1))
    if shape.phases:
        # The last row is that of no phase.
        parts.append(np.eye(len(shape.phases) + 1, len(shape.phases))[phase])
        parts.append(np.minimum(np.where(phase < 0, 0, since)[:, None] / np.array(CLOCKS), 1))
    return np.concatenate([*parts, np.eye(len(shape.tasks))[task]], axis=1).astype(np.float32)


class Phases:
    """The phase in which each world's student believes to be, as ``crates/policies/src/see.rs`` has it."""

    def __init__(self, random: np.random.Generator, worlds: int) -> None:
        self.random = random
        self.now, self.began, self.waits = np.full(worlds, -1), np.zeros(worlds, np.int64), np.zeros(worlds, np.int64)

    def reset(self, marks: Array) -> None:
        """Begins an episode in these worlds."""
        self.now[marks], self.began[marks], self.waits[marks] = -1, 0, 0

    def choose(self, chosen: Array, steps: Array) -> None:
        """A phase for each world, in the control step of its episode."""
        changes = chosen != self.now
        self.now, self.began = np.where(changes, chosen, self.now), np.where(changes, steps, self.began)

    def follow(self, taught: Array, steps: Array) -> None:
        """The teacher's phase; it is seen at once or a little later."""
        changes = taught != self.now
        self.waits = np.where(changes, self.waits - 1, self.waits)
        self.choose(np.where(changes & (self.waits < 0), taught, self.now), steps)
        due, count = changes & (self.waits < 0), len(taught)
        lags = (self.random.random(count) < LAGS[0]) * self.random.integers(1, LAGS[1] + 1, count)
        self.waits = np.where(due, lags, self.waits)


class Bodies:
    """Robots on command, as ``crates/policies/src/gait.rs`` has them: legs and waist are the controller's."""

    def __init__(self, worlds: int, threads: int, bends_low: bool = False) -> None:
        self.bodies = WholeBodies(worlds, threads, bends_low=bends_low)
        self.velocity = np.zeros((worlds, 3))
        self.goals = np.full((worlds, 2, 7), np.nan)

    def reset(self, marks: Array) -> None:
        """Begins an episode in these worlds."""
        self.bodies.reset(marks)
        self.velocity[marks] = 0.0

    def targets(self, sensed: Array, wanted: Array, steps: Array, others: Array, posture: Array = UPRIGHT) -> Array:
        """Joint targets, rad; those of arms and hands are ``others``."""
        goes = (np.abs(wanted) >= DEAD_ZONE).any(axis=1) & (steps >= SETTLES)
        change = np.clip(wanted - self.velocity, -SLEW * CONTROL_DT, SLEW * CONTROL_DT)
        self.velocity = np.where(goes[:, None], self.velocity + change, 0.0)
        commands = np.concatenate([self.velocity, np.broadcast_to(posture, (len(wanted), POSTURE))], axis=1)
        targets = others.copy()
        targets[:, :LEGS_AND_WAIST] = self.bodies(sensed, commands, self.goals)[:, :LEGS_AND_WAIST]
        return targets


def shape_of(tasks: Sequence[str], finds: tuple[str, ...] = (), **settings: Any) -> Shape:
    """The shape of a network for these tasks. One that works with hands, or that finds places too, has hands.

    Raises:
        ValueError: It should find places, but works with hands in no task, or learns of no look.
    """
    handed = [task for task in tasks if task in PHASES]
    if not handed:
        if finds:
            raise ValueError("a network for tasks on the ladder needs S06 or S08 among them, too; or train one by find")
        return Shape(tuple(tasks), **settings)
    env = VectorEnv(tasks[0], 1, sensors=["hand_contact"], robot=settings.get("robot", Shape.robot))
    touched = touch(env.reset()[0]).shape[1]
    env.close()
    phases = tuple(dict.fromkeys(name for task in handed for name in PHASES[task]))
    hidden = HEAD_OF_ALL if set(tasks) - set(handed) else HEAD_OF_HANDS
    return Shape(
        tuple(tasks),
        joints=tuple(env.action_names),
        touched=touched,
        phases=phases,
        finds=finds,
        hidden=hidden,
        embedding=EMBEDDING_OF_ALL if finds else Shape.embedding,
        **settings,
    )


def lesson_worlds(
    task: str, rooms: Sequence[int], shape: Shape, sensors: Sequence[str], *, threads: int | None, seed: int
) -> VectorEnv:
    """A world in each room, with these sensors and the cameras of a network of this shape, under the strict judge."""
    rate = round(1 / (shape.every * CONTROL_DT))
    return VectorEnv(
        task,
        len(rooms),
        seeds=rooms,
        episodes=STARTS,
        num_threads=threads,
        seed=seed,
        sensors=[*sensors, *(f"{camera}@{rate}" for camera in shape.cameras)],
        image_size=shape.picture,
        action_form="joint_target",
        protocol="strict",
        robot=shape.robot,
        copy=False,
        final_obs=False,
    )


@dataclass
class Played:
    """A lesson, and how its episodes ended."""

    lesson: Lesson
    rollouts: Rollouts
    ended: int
    successes: int
    """By the strict judge."""
    without_end: int
    """Worlds in which none ended: the slow ones, which the share of successes leaves out."""


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
    bags: int = 0,
) -> Played:
    """Plays episodes in a world for each room, one after the other, for some control steps.

    Without a student the teacher drives, and is disturbed now and then. With one, the teacher ends a share of the episodes, from a time
    on that is drawn from the whole; and of those with hands it begins some. So many clean ones are kept for bags.
    """
    worlds, cameras, every = len(rooms), shape.cameras, shape.every
    env = lesson_worlds(task, rooms, shape, SENSORS, threads=threads, seed=seed)
    random, number, has_hands = np.random.default_rng([seed, rooms[0]]), shape.tasks.index(task), task in PHASES
    bodies = Bodies(worlds, env.num_threads, has_hands)
    experts = Experts(env, num_threads=env.num_threads, parameters=TEACHERS.get(task))
    memory = None if student is None else Memory(student, worlds, device)
    disturbs = Stumbles(random, worlds, every) if not has_hands else SlowNoise(random, worlds, len(env.action_names))
    phases, indices = Phases(random, worlds), {name: index for index, name in enumerate(shape.phases)}
    count, ended, everyone = np.zeros(worlds, np.int64), np.zeros(worlds, np.int64), np.arange(worlds)
    place, wanted, successes = np.zeros((worlds, 3)), np.zeros((worlds, 3)), 0
    posture, arms = np.tile(UPRIGHT, (worlds, 1)), np.zeros((worlds, len(env.action_names) - LEGS_AND_WAIST))
    # An episode looks at its first step, too, and none ends while it settles.
    looks = steps // every + steps // SETTLES + 1
    notebook = Notebook(worlds, looks, steps if has_hands else looks, shape)
    rollouts = Rollouts(rooms, steps, len(env.action_names), bags)
    robot = Kinematics(robot=shape.robot)
    lower, upper = robot.joint_limits[LEGS_AND_WAIST:].T
    rates = CONTROL_DT * np.repeat(RATES, (ARMS, arms.shape[1] - ARMS))

    def student_drives() -> Array:
        """The control steps of each world's episode from which, and until which, the student drives."""
        if memory is None:
            return np.full((2, worlds), steps)
        share, longest = HANDED_OVER if has_hands else (0.0, 0.0)
        begins = (random.random(worlds) < share) * random.uniform(0, longest / CONTROL_DT, worlds)
        ends = np.where(random.random(worlds) < takes_over, random.integers(0, steps, worlds), steps)
        return np.stack((begins.astype(np.int64), ends))

    seen, _ = env.reset(seed=seed)
    drives, starts = student_drives(), env.drawn()["episode"]
    for _ in range(steps):
        label = experts.label()
        pelvis = columns_of(seen, SENSED)
        turning, ahead, left = pelvis[:, 2], pelvis[:, 6], pelvis[:, 7]
        moving = (count > 0) * CONTROL_DT
        cos, sin = np.cos(place[:, 2]), np.sin(place[:, 2])
        place += moving[:, None] * np.stack((cos * ahead - sin * left, sin * ahead + cos * left, turning), axis=1)
        command = np.nan_to_num(label.body_command)
        velocity = command[:, :3]
        moves = np.zeros((worlds, shape.moves))
        body, back = pelvis.astype(np.float32), count // every
        does = np.array([indices.get(name, -1) if has_hands else -1 for name in label.phase])
        since = count - phases.began
        behind = (does < 0) | (np.abs(command[:, 3] - pelvis[:, -1]) > FAR_BEHIND_M)
        unlearned = behind if has_hands else count < SETTLES
        if has_hands:
            moves = np.nan_to_num(np.concatenate([command[:, 3:], label.joint_target[:, LEGS_AND_WAIST:]], axis=1))
        if shape.joints:
            body = np.concatenate([body, columns_of(seen, ("joint_position",)), touch(seen)], axis=1).astype(np.float32)
        at = np.flatnonzero(count % every == 0)
        if len(at):
            pictures = notebook.look(at, [seen[camera] for camera in cameras], place)
            if memory is not None:
                memory.look(at, pictures, place[at], back[at])
        if has_hands:
            at = everyone
        if len(at):
            notebook.decide(
                at,
                body=body,
                place=place,
                back=back,
                velocity=velocity,
                stands=np.all(np.abs(velocity) < DEAD_ZONE, axis=1),
                moves=moves,
                goal=_ahead(seen, GOALS[task]),
                phase=phases.now,
                since=since,
                does=does,
                settles=unlearned | ~label.can_label,
            )
            if memory is not None:
                answer = memory.decide(at, body[at], place[at], back[at], phases.now[at], since[at], number)
                within = np.clip(answer[:, :3], RANGES[:, 0], RANGES[:, 1])
                wanted[at] = np.where(answer[:, 3:WALKS] > 0, 0.0, within)
                if has_hands:
                    ends = [WALKS, WALKS + POSTURE, WALKS + shape.moves, WALKS + shape.moves + len(shape.phases)]
                    _, posture, arms, chosen, _ = np.split(answer.astype(np.float64), ends, axis=1)
                    arms = np.clip(arms, lower, upper)
                    phases.choose(chosen.argmax(axis=1), count)
            elif has_hands:
                phases.follow(does, count)
        # A teacher that cannot answer says NaN.
        last = robot.q0 + 0.5 * seen["last_action"]
        taught = np.where(np.isfinite(label.joint_target), label.joint_target, last)
        others = taught.copy()
        if has_hands:
            reached = last[:, LEGS_AND_WAIST:]
            others[:, LEGS_AND_WAIST:] = reached + np.clip(arms - reached, -rates, rates)
        led = (count < drives[0]) | (count >= drives[1])
        if led.any():
            disturbed, noise = disturbs(velocity, led & (count > SETTLES))
            wanted[led], posture[led] = disturbed[led], command[led, 3:] if has_hands else UPRIGHT
            others[led] = (taught + noise)[led]
        sensed = np.concatenate([pelvis, columns_of(seen, ("joint_position", "joint_velocity"))], axis=1)
        targets = bodies.targets(sensed, wanted, count, others, posture)
        rollouts.step(count, targets)
        seen, _, terminated, truncated, info = env.step(targets)
        over = terminated | truncated
        count += 1
        if over.any():
            rollouts.end(starts, count, over & info["success"])
            starts = env.drawn()["episode"]
            ended[over] += 1
            successes += int(info["success"][over].sum())
            count[over], place[over], wanted[over] = 0, 0.0, 0.0
            disturbs.reset(over)
            bodies.reset(over)
            phases.reset(over)
            drives[:, over] = student_drives()[:, over]
    env.close()
    return Played(notebook.lesson(number), rollouts, int(ended.sum()), successes, int((ended == 0).sum()))


def part_of_lesson(
    task: str, *, student: Path | None, device: str, into: Path, **settings: Any
) -> tuple[Lesson, dict[str, int]]:
    """A part of a lesson, and how its episodes ended; a student is that of a checkpoint. Bags come into a folder."""
    played = play(task, student=None if student is None else load(student, device)[0], device=device, **settings)
    if played.rollouts.kept:
        played.rollouts.record(
            task, settings["shape"].robot, f"dagger by {student.stem if student else 'expert'}", into
        )
    ends = {"episodes": played.ended, "successes": played.successes, "without_end": played.without_end}
    return played.lesson, {**ends, "worlds": len(settings["rooms"]), "decisions": len(played.lesson.back)}


class Stumbles:
    """Now and then a random velocity in place of the teacher's, for a while."""

    def __init__(self, random: np.random.Generator, worlds: int, every: int) -> None:
        self.random, self.chance = random, STUMBLES[0] / every
        self.left, self.drawn = np.zeros(worlds, np.int64), np.zeros((worlds, 3))

    def __call__(self, velocity: Array, marks: Array) -> tuple[Array, Array]:
        """Velocities to walk with, and noise on the targets; new stumbles begin in marked worlds."""
        begins = (self.random.random(len(marks)) < self.chance) & (self.left == 0) & marks
        self.left[begins] = self.random.integers(*STUMBLES[1], begins.sum())
        self.drawn[begins] = self.random.uniform(RANGES[:, 0], RANGES[:, 1], (len(marks), 3))[begins]
        walked = np.where(self.left[:, None] > 0, self.drawn, velocity)
        self.left = np.maximum(self.left - 1, 0)
        return walked, np.zeros((len(marks), 1))

    def reset(self, marks: Array) -> None:
        """Begins an episode in these worlds."""
        self.left[marks] = 0


class SlowNoise:
    """Noise on the targets of arms and hands that changes slowly, of another width in each episode."""

    def __init__(self, random: np.random.Generator, worlds: int, joints: int) -> None:
        self.random = random
        self.noise, self.width = np.zeros((worlds, joints)), np.zeros((worlds, 1))
        self.reset(np.ones(worlds, bool))

    def __call__(self, velocity: Array, marks: Array) -> tuple[Array, Array]:
        """Velocities to walk with, and noise on the targets; all are moved on."""
        keeps = 1 - CONTROL_DT / SLOW_NOISE[1]
        new = self.width * np.sqrt(1 - keeps**2) * self.random.standard_normal(self.noise.shape)
        self.noise = keeps * self.noise + new
        self.noise[:, :LEGS_AND_WAIST] = 0.0
        return velocity, np.where(marks[:, None], self.noise, 0.0)

    def reset(self, marks: Array) -> None:
        """Begins an episode in these worlds."""
        self.noise[marks] = 0.0
        self.width[marks] = self.random.uniform(0, SLOW_NOISE[0], (int(marks.sum()), 1))


def touch(seen: Any) -> Array:
    """Forces on the bodies of both hands, N, in the order of the sensor ``hand_contact``."""
    forces = np.concatenate([seen["right_hand_contact"], seen["left_hand_contact"]], axis=1)
    return np.minimum(np.linalg.norm(forces, axis=2), MAX_TOUCH_N)


def columns_of(seen: Any, names: Sequence[str]) -> Array:
    """These arrays of an observation, side by side: worlds x numbers."""
    return np.concatenate([np.reshape(seen[name], (len(seen[name]), -1)) for name in names], axis=1).astype(np.float64)


def _ahead(seen: Any, thing: str) -> Array:
    """Where a thing is, ahead and to the left of the robot on the floor, m."""
    robot, goal = poses.of(seen, "robot"), poses.of(seen, thing)
    (x, y), look = (goal[:, :2] - robot[:, :2]).T, poses.heading(robot[:, 3:])
    return np.stack((np.cos(look) * x + np.sin(look) * y, np.cos(look) * y - np.sin(look) * x), axis=1)
