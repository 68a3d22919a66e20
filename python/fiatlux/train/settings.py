"""Settings of a training run."""

import dataclasses
import math
from dataclasses import dataclass
from typing import Any, ClassVar

from .. import _native
from ..settings import ROBOTS, Protocol, Reward, Robot
from ..tasks import TASKS

PARTS = ("history", "clock", "symmetry")
"""Parts of the method that training can leave out."""
SCENES = {"floor": {"robot": "g1_bare"}, "room": {"scene": "room", "robot": ROBOTS[0]}}
"""Where robots walk: arguments of :class:`fiatlux.WalkingVectorEnv`."""


FIRST_ROOM = _native.TRAINING_SEEDS[0]
"""Seed of the first room of training."""
FIRST_TEST_ROOM = 5000
"""Seed of the first room of a test, before which the rooms of training end."""


def _of(default: Any, text: str, least: float | None = None, most: float = math.inf) -> Any:
    return dataclasses.field(default=default, metadata={"help": text, "least": least, "most": most})


@dataclass(frozen=True)
class Settings:
    """Settings that all runs share. A checkpoint holds them; a resumed run keeps them, but for those that are given anew.

    Raises:
        ValueError: A setting is out of range.
    """

    FIXED: ClassVar[tuple[str, ...]] = ("hidden", "critic")
    """Settings that a resumed run cannot change."""

    seed: int = _of(0, "seed of networks and worlds", 0)
    worlds: int = _of(2048, "worlds", 1)
    steps: int = _of(24, "control steps of each world in an iteration", 1)
    segment: int = _of(25, "iterations from one checkpoint to the next", 1)
    samples: int = _of(100_000_000, "control steps of the whole run, all worlds together", 1)
    hidden: tuple[int, ...] = _of((256, 256, 128), "sizes of the policy's hidden layers", 2)
    critic: tuple[int, ...] = _of((512, 256, 128), "sizes of the critic's hidden layers", 2)
    epochs: int = _of(5, "passes over an iteration's samples", 1)
    batches: int = _of(4, "minibatches of a pass", 1)
    desired_kl: float = _of(0.012, "step of the policy that the learning rate is adjusted for", 1e-6)
    evaluate: int = _of(6, "checkpoints from one evaluation to the next", 1)

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            least, most = field.metadata["least"], field.metadata["most"]
            value = getattr(self, field.name)
            if least is None:
                continue
            for number in value if isinstance(value, tuple) else (value,):
                if not least <= number <= most:
                    bounds = f"{least:g} or more" if most == math.inf else f"{least:g} to {most:g}"
                    raise ValueError(f"{field.name} is {number}; give {bounds}")
        if self.batches > self.worlds * self.steps:
            raise ValueError(
                f"batches is {self.batches}, but an iteration has {self.worlds * self.steps} samples; give fewer"
            )


@dataclass(frozen=True)
class Walk(Settings):
    """Settings of a run of the whole-body controller."""

    FIXED: ClassVar[tuple[str, ...]] = (*Settings.FIXED, "without")

    entropy: float = _of(
        0.003, "weight of the entropy at first; it falls to a sixth over the second half of the curriculum's time", 0
    )
    least_std: float = _of(0.12, "least standard deviation of an action at first; it falls likewise to 0.05", 0.01, 1)
    calm_from: int = _of(25_000_000, "samples from which entropy and least deviation fall", 0)
    calm_over: int = _of(20_000_000, "samples over which they fall", 1)
    harder: float = _of(0.08, "growth of the difficulty at a checkpoint whose robots seldom fell", 0, 1)
    falls: float = _of(1.5, "falls in 1,000 control steps of a world below which the difficulty grows", 0)
    tracks: float = _of(0.62, "part of the most that velocity can pay from which on the difficulty grows", 0, 1)
    most_difficult: float = _of(1.0, "where the difficulty stops growing", 0, 1)
    pushes: float = _of(0.5, "size of pushes at difficulty 0, m/s an axis; 1.0 at difficulty 1", 0)
    scene: str = _of("floor", "floor, or room: the whole scene of a task, and a robot with its fingers; half as fast")
    without: tuple[str, ...] = _of(
        (),
        "what the policy has to do without: history (earlier frames), clock (the rhythm of the feet, and what it pays), symmetry (of the networks); to see what each is worth",
    )
    reward: tuple[str, ...] = _of(
        (),
        "weights of the reward's terms that are not to be the usual ones, as NAME=WEIGHT; the command terms lists them",
    )
    start: str = _of(
        "", "an exported controller (.safetensors) to go on from; in the first segment its new critic learns alone"
    )
    start_difficulty: float = _of(0.0, "difficulty of a new run, and of a resumed one that is given it", 0, 1)
    widen: float = _of(1.0, "factor of the actions' standard deviation where a run is resumed", 0.01, 100)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.scene not in SCENES:
            raise ValueError(f"scene is {self.scene!r}; give {' or '.join(SCENES)}")
        unknown = set(self.without) - set(PARTS)
        if unknown:
            raise ValueError(f"without: {', '.join(sorted(unknown))} is not known; give some of {', '.join(PARTS)}")
        weights_of(self.reward)


@dataclass(frozen=True)
class Baseline(Settings):
    """Settings of a run of the published benchmark's baseline: PPO from nothing on the joints of a task, with the settings of the
    reference implementation for RSL-RL."""

    FIXED: ClassVar[tuple[str, ...]] = (*Settings.FIXED, "task", "worlds", "rooms", "episodes", "sensors", "robot")

    hidden: tuple[int, ...] = _of((512, 256, 128), "sizes of the policy's hidden layers", 2)
    critic: tuple[int, ...] = _of((512, 256, 128), "sizes of the critic's hidden layers", 2)
    epochs: int = _of(8, "passes over an iteration's samples", 1)
    desired_kl: float = _of(0.01, "step of the policy that the learning rate is adjusted for", 1e-6)
    task: str = _of("climb", "the task, such as S02")
    entropy: float = _of(0.006, "weight of the entropy", 0)
    learning_rate: float = _of(1e-3, "learning rate at first", 1e-9)
    std: float = _of(1.0, "standard deviation of an action at first", 0.01, 100)
    reward: Reward = _of("training", "training: the shaped reward; benchmark: what the task's score pays")
    protocol: Protocol = _of("published", "which judge ends an episode: published or strict")
    sensors: tuple[str, ...] = _of((), "sensors of the policy, such as lidar; without names, the task's usual ones")
    robot: Robot = _of(ROBOTS[0], "robot")
    rooms: int = _of(16, "rooms over which the worlds are spread, from seed 1000 on", 1)
    episodes: int = _of(4, "start states in each room", 1)
    stagger: int = _of(
        1, "1: the first episodes end at random times, so that the worlds are not in step; 0: they do not", 0, 1
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.task not in TASKS:
            raise ValueError(f"task is {self.task!r}; give one of {', '.join(TASKS)}")
        _check_rooms(self.rooms, self.worlds)


@dataclass(frozen=True)
class Climb(Settings):
    """Settings of a run of the policy that follows the plan of the ladder."""

    hidden: tuple[int, ...] = _of((512, 256, 128), "sizes of the policy's hidden layers", 2)
    critic: tuple[int, ...] = _of((512, 256, 128), "sizes of the critic's hidden layers", 2)
    until: float = _of(1000.0, "end of the part of the plan that is followed, s", 1, 1000)
    low: float = _of(
        0.4, "share of the episodes that begin below the second tread, besides those that begin anywhere", 0, 0.9
    )
    backwards: float = _of(0.5, "share of the episodes that follow the plan backwards", 0, 1)
    carries: float = _of(0.3, "share of the episodes in which the right arm is held as if it carried a bulb", 0, 1)
    holds: float = _of(0.2, "share of the episodes that hold the pose at which they begin", 0, 1)
    horizon: int = _of(800, "control steps of an episode", 1)
    entropy: float = _of(0.001, "weight of the entropy", 0)
    std: float = _of(0.35, "standard deviation of an action at first", 0.01, 1)
    least_std: float = _of(0.05, "least standard deviation of an action", 0.001, 1)
    pushes: float = _of(0.1, "size of pushes, m/s an axis", 0)
    robot: Robot = _of("g1_bare", "robot")
    reward: tuple[str, ...] = _of((), "weights of the reward's terms that are not to be the usual ones, as NAME=WEIGHT")

    def __post_init__(self) -> None:
        super().__post_init__()
        climbing_weights_of(self.reward)


@dataclass(frozen=True)
class Hand(Settings):
    """Settings of a run of a task of one hand on top of the whole-body controller."""

    FIXED: ClassVar[tuple[str, ...]] = (*Settings.FIXED, "task")

    worlds: int = _of(512, "worlds", 1)
    steps: int = _of(8, "decisions of each world in an iteration, of four control steps each", 1)
    segment: int = _of(20, "iterations from one checkpoint to the next", 1)
    hidden: tuple[int, ...] = _of((256, 128, 128), "sizes of the policy's hidden layers", 2)
    critic: tuple[int, ...] = _of((256, 128, 128), "sizes of the critic's hidden layers", 2)
    epochs: int = _of(4, "passes over an iteration's samples", 1)
    desired_kl: float = _of(0.02, "step of the policy that the learning rate is adjusted for", 1e-6)
    evaluate: int = _of(2, "checkpoints from one evaluation to the next", 1)
    task: str = _of("S08", "the task; S08 is the one that there is")
    demonstrations: str = _of("", "folder with bags of demonstrations, whose rows are starts")
    last_s: float = _of(8.0, "seconds before the end of a demonstration from which its rows are taken", 0.1)
    own: float = _of(0.6, "weight of the task's own starts against that of the demonstrations of a room", 0)
    rooms: int = _of(16, "rooms over which the worlds are spread, from seed 1000 on", 1)
    episodes: int = _of(4, "start states in each room", 1)
    horizon: int = _of(800, "control steps of an episode", 1)
    entropy: float = _of(0.002, "weight of the entropy", 0)
    learning_rate: float = _of(3e-4, "learning rate at first", 1e-9)
    std: float = _of(0.5, "standard deviation of an action at first", 0.01, 100)
    gamma: float = _of(0.99, "discount of a decision", 0, 1)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.task != "S08":
            raise ValueError(f"task is {self.task!r}; give S08")
        if not self.demonstrations:
            raise ValueError("demonstrations: give a folder of bags, as `fiatlux demonstrate --task S08` records them")
        _check_rooms(self.rooms, self.worlds)


def _check_rooms(rooms: int, worlds: int) -> None:
    """Refuses more rooms than there are worlds, or than training has before those of its tests."""
    if rooms > worlds:
        raise ValueError(f"rooms is {rooms}, but there are {worlds} worlds; give at most one room for each")
    if rooms > FIRST_TEST_ROOM - FIRST_ROOM:
        tests = f"rooms from {FIRST_TEST_ROOM} on are for tests"
        raise ValueError(f"rooms is {rooms}, but {tests}; give at most {FIRST_TEST_ROOM - FIRST_ROOM}")


KINDS: dict[str, type[Settings]] = {"walk": Walk, "climb": Climb, "ppo": Baseline, "hand": Hand}
"""Settings of each command that trains."""


def weights_of(given: tuple[str, ...]) -> dict[str, float]:
    """Weights of the walking task's reward that are given as NAME=WEIGHT."""
    return _weights_of(given, _native.Batch.walking_weights())


def climbing_weights_of(given: tuple[str, ...]) -> dict[str, float]:
    """The same of the climbing task's reward."""
    return _weights_of(given, _native.Batch.climbing_weights())


def _weights_of(given: tuple[str, ...], known: dict[str, float]) -> dict[str, float]:
    weights = {}
    for pair in given:
        name, _, weight = pair.partition("=")
        if name not in known:
            raise ValueError(f"reward: there is no term {name!r}; the terms are {', '.join(known)}")
        try:
            weights[name] = float(weight)
        except ValueError:
            raise ValueError(
                f"reward: {pair!r} has no number; give NAME=WEIGHT, such as {name}={known[name]:g}"
            ) from None
        if not math.isfinite(weights[name]):
            raise ValueError(f"reward: the weight of {name} is {weight}; give a finite number")
    return weights


def worlds_of(difficulty: float, pushes: float = Walk.pushes) -> dict[str, Any]:
    """Arguments of :class:`fiatlux.WalkingVectorEnv` at a difficulty from 0 to 1: everything that disturbs grows with it."""

    def between(easy: float, hard: float) -> float:
        return easy + difficulty * (hard - easy)

    return {
        "height": (between(0.74, 0.65), between(0.76, 0.79)),
        "stand_height": (between(0.74, 0.55), between(0.76, 0.79)),
        "torso": tuple((difficulty * low, difficulty * high) for low, high in ((-0.3, 0.3), (-0.1, 0.6), (-0.5, 0.5))),
        "arm_range": difficulty,
        "load_kg": difficulty,
        "hand_force_n": 20.0 * difficulty,
        "ranges": {"floor_friction": (0.5, 1.1), "mass": (0.95, 1.05), "com_shift_m": 0.01},
        "variations": 64,
        "disturbances": {
            "pushes": {"interval_s": (3.0, 8.0), "linear": between(pushes, 1.0), "angular": between(0.1, 0.4)}
        },
    }
