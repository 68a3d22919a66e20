"""Measures how well a policy walks: survival, and errors of one-second means."""

from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from .settings import worlds_of
from .worlds import WalkingWorlds

SECOND = 50
"""Control steps in a second."""
LOADED = 50.0
"""Load from which a foot stands, N."""
SETTLES = 75
"""Control steps after a new command during which errors do not count."""

UPRIGHT = {
    "height": (0.75, 0.75),
    "stand_height": (0.75, 0.75),
    "torso": ((0.0, 0.0),) * 3,
    "arm_range": 0.0,
    "load_kg": 0.0,
    "hand_force_n": 0.0,
    "disturbances": None,
    "ranges": {"floor_friction": (0.5, 1.1)},
}
_PUSHES = {"interval_s": (3.0, 8.0), "angular": 0.0}
TESTS: dict[str, dict[str, Any]] = {
    "upright": UPRIGHT,
    "arms": {**UPRIGHT, "arm_range": 1.0},
    "carry": {**UPRIGHT, "arm_range": 1.0, "load_kg": 1.0},
    "loads": {**UPRIGHT, "arm_range": 1.0, "load_kg": 1.0, "hand_force_n": 20.0},
    "pushes_0.6": {**UPRIGHT, "disturbances": {"pushes": {**_PUSHES, "linear": 0.6}}},
    "pushes_1.0": {**UPRIGHT, "disturbances": {"pushes": {**_PUSHES, "linear": 1.0}}},
    "posture": {**worlds_of(1.0), "arm_range": 0.0, "load_kg": 0.0, "hand_force_n": 0.0, "disturbances": None},
    "all": worlds_of(1.0),
}
"""Settings of the worlds of each test."""


def measure(
    actor: Any,
    device: str,
    threads: int | None,
    episodes: int,
    steps: int,
    seed: int,
    settings: dict[str, Any],
    without: tuple[str, ...] = (),
    progress: Callable[[int], None] = lambda step: None,
) -> dict[str, float]:
    """Plays ``episodes`` episodes in parallel, up to ``steps`` control steps each, with the policy's mean actions.

    ``survived`` is a share. The others are means over the worlds that have not fallen, and over the seconds that begin at least
    one and a half seconds after a command: the absolute error of the one-second mean of velocity (m/s, rad/s), height (m) and
    torso angles (rad). ``apart`` is the feet's distance to the side, m, while both stand and the robot walks. ``progress`` is
    called with the number of each step.
    """
    worlds = WalkingWorlds(
        episodes,
        device,
        without,
        num_threads=threads,
        seed=seed,
        horizon_steps=steps + 1,
        **{"variations": 64, **settings},
    )
    actor.eval()
    alive = np.ones(episodes, bool)
    since = np.zeros(episodes, int)
    sums = np.zeros((episodes, 7))
    commands = worlds.field("command").copy()
    errors: list[np.ndarray] = []
    stood: list[np.ndarray] = []
    unloaded = standing = jitter = apart = on_both = 0.0
    with torch.inference_mode():
        for step in range(steps):
            progress(step)
            actions = actor(worlds.observation)
            command = worlds.field("command").copy()
            worlds_command_changed = (np.abs(command - commands) > 1e-6).any(axis=1)
            _, terminated, _, _ = worlds.step(actions)
            alive &= ~terminated
            velocity = worlds.field("privileged.velocity")
            state = np.concatenate(
                (velocity[:, [0, 1, 5]], worlds.field("privileged.height"), worlds.field("privileged.torso")), axis=1
            )
            since = np.where(worlds_command_changed, 0, since + 1)
            commands = command
            counts = since > SETTLES
            sums = np.where(counts[:, None], sums + state - command, 0.0)
            done = alive & counts & ((since - SETTLES) % SECOND == 0)
            means = np.abs(sums[done] / SECOND)
            errors.append(means)
            stood.append(~command[done, :3].any(axis=1))
            sums[(since - SETTLES) % SECOND == 0] = 0.0
            feet, loads = worlds.field("privileged.foot_position"), worlds.field("privileged.foot_load")
            still = alive & counts & ~command[:, :3].any(axis=1)
            standing += still.sum()
            unloaded += (loads[still] < 1.0).any(axis=1).sum()
            both = alive & counts & command[:, :3].any(axis=1) & (loads > LOADED).all(axis=1)
            on_both += both.sum()
            apart += (feet[both, 1] - feet[both, 4]).sum()
            jitter += np.square(worlds.field("privileged.joint_velocity")[still, :15]).mean(axis=1).sum()
    worlds.env.close()
    table = np.concatenate(errors) if errors else np.zeros((0, 7))
    mean = table.mean(axis=0) if len(table) else np.full(7, np.nan)
    return {
        "survived": float(alive.mean()),
        "vx": float(mean[0]),
        "vy": float(mean[1]),
        "wz": float(mean[2]),
        "height": float(mean[3]),
        "roll": float(mean[4]),
        "pitch": float(mean[5]),
        "yaw": float(mean[6]),
        "apart": float(apart / on_both) if on_both else np.nan,
        "unloaded": float(unloaded / standing) if standing else np.nan,
        "still_speed": float(np.sqrt(jitter / standing)) if standing else np.nan,
        "seconds": float(len(table)),
    }


def score(actor: Any, device: str, threads: int | None, without: tuple[str, ...] = ()) -> dict[str, float]:
    """A short test over the whole range that ranks checkpoints: higher is better."""
    was_training = actor.training
    found = measure(actor, device, threads, 256, 500, 1, TESTS["all"], without)
    actor.train(was_training)
    speed, torso = max(found["vx"], found["vy"]), (found["roll"] + found["pitch"] + found["yaw"]) / 3
    errors = 2 * speed + found["wz"] + 3 * found["height"] + torso
    total = found["survived"] - (errors if np.isfinite(errors) else 10.0)
    return {
        "survived": found["survived"],
        "velocity": speed,
        "turning": found["wz"],
        "height": found["height"],
        "torso": torso,
        "score": total,
    }
