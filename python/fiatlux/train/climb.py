"""Training of a policy that follows the plan of the ladder. The worlds of each segment begin anew."""

from typing import Any

import numpy as np
import torch
from rsl_rl.models import MLPModel

from ..vector import ClimbingVectorEnv
from .run import CONTROL_DT, GROUPS, Run
from .settings import Climb, climbing_weights_of
from .worlds import Worlds

TEST_WORLDS, TEST_SEED = 64, 1
"""Worlds of each test during the run, and their seed."""
HOLD_STEPS = 500
"""Control steps of a test that holds one pose."""
PHASE_S = 60.5
"""Unit of the plan's time in an observation, s."""
FIRST_TREADS_S = 46.0
"""Time of the plan at which both feet are on the second tread."""
LEVEL_SHARE = 0.1
"""Share of the episodes that begin at an end of the plan, where the robot stands otherwise than the plan says."""
LEFT_ARM = [-0.8, 0.3, 0.0, 0.6, 0.0, 0.0, 0.0]
CARRIES = [[*LEFT_ARM, -0.35, 0.0, 0.0, 0.35, 1.57, 0.0, 0.0], [*LEFT_ARM, 0.3, 0.0, -0.3, -0.3, 1.57, 0.0, 0.0]]
"""Postures of the arms with a bulb in the right hand, as S10 and S04 begin, rad."""


def starts_of(low: float) -> list[tuple[float, float]]:
    """Where episodes begin on the plan, s: a share below the second tread, another one at its ends, the others anywhere. There are twenty
    ranges, each as likely as the others."""
    ends = round(20 * LEVEL_SHARE / 2)
    treads = round(20 * low)
    ranges = ends * [(0.0, 1.9), (1000.0, 1000.0)] + treads * [(0.0, FIRST_TREADS_S)]
    return ranges + (20 - len(ranges)) * [(0.0, 1000.0)]


class ClimbingWorlds(Worlds):
    """Worlds of following the plan of the ladder; the critic sees what the policy sees and the exact state."""

    def __init__(self, num_envs: int, device: str, **settings: Any) -> None:
        env = ClimbingVectorEnv(num_envs, observation="flat", copy=False, final_obs=False, **settings)
        places = {name: np.arange(place.start, place.stop) for name, (place, _) in env.fields.items()}
        sensed = [place for name, place in places.items() if not name.startswith("privileged.")]
        groups = {"policy": np.concatenate(sensed), "critic": np.concatenate(list(places.values()))}
        super().__init__(env, groups, device)


def models(worlds: Worlds, settings: Climb) -> tuple[MLPModel, MLPModel]:
    """Policy and critic, new."""
    deviation = {
        "class_name": "GaussianDistribution",
        "init_std": settings.std,
        "std_type": "log",
        "std_range": (settings.least_std, 1.0),
    }
    more: dict[str, Any] = {"activation": "elu", "obs_normalization": True}
    hidden, critic = list(settings.hidden), list(settings.critic)
    actor = MLPModel(
        worlds.observation, GROUPS, "actor", worlds.num_actions, hidden_dims=hidden, distribution_cfg=deviation, **more
    )
    return actor, MLPModel(worlds.observation, GROUPS, "critic", 1, hidden_dims=critic, **more)


def varied(settings: Climb) -> dict[str, Any]:
    """Variations of the worlds, and pushes."""
    return {
        "robot": settings.robot,
        "until": settings.until,
        "ranges": {"floor_friction": (0.8, 1.1), "mass": (0.97, 1.03), "com_shift_m": 0.005},
        "variations": 64,
        "disturbances": {"pushes": {"interval_s": (2.0, 5.0), "linear": settings.pushes, "angular": settings.pushes}},
    }


class ClimbRun(Run):
    """A run of the policy that follows the plan of the ladder."""

    kind = "climb"
    tests = ("held", "treads", "up", "down", "score")
    settings: Climb
    worlds: ClimbingWorlds

    def make_worlds(self, seed: int) -> ClimbingWorlds:
        settings = self.settings
        return ClimbingWorlds(
            settings.worlds,
            self.device,
            num_threads=self.threads,
            seed=seed,
            horizon_steps=settings.horizon,
            starts=starts_of(settings.low),
            rates=(0.8, 2.2),
            backwards=settings.backwards,
            holds=settings.holds,
            arms=CARRIES,
            carries=settings.carries,
            reward_weights=climbing_weights_of(settings.reward),
            **varied(settings),
        )

    def models(self) -> tuple[MLPModel, MLPModel]:
        return models(self.worlds, self.settings)

    def test(self) -> dict[str, float]:
        actor = self.ppo.actor
        found, holds = measure(actor, self.settings, self.device, self.threads)
        actor.train()
        with (self.out / "holds.csv").open("a") as file:
            for part, steps in holds:
                file.write(f"{self.samples},{part:.4f},{steps * CONTROL_DT:.2f}\n")
        return found


def played(actor: Any, worlds: ClimbingWorlds, steps: int) -> np.ndarray:
    """Control steps until the first episode of each world ends, with the policy's mean actions."""
    alive, lasted = np.ones(worlds.num_envs, bool), np.zeros(worlds.num_envs)
    actor.eval()
    with torch.inference_mode():
        for _ in range(steps):
            _, terminated, truncated, _ = worlds.step(actor(worlds.observation))
            lasted += alive
            alive &= ~(terminated | truncated)
            if not alive.any():
                break
    worlds.env.close()
    return lasted


def measure(
    actor: Any, settings: Climb, device: str, threads: int | None, episodes: int = TEST_WORLDS
) -> tuple[dict[str, float], list[tuple[float, float]]]:
    """Shares of the episodes that hold a pose for ten seconds, that go from the floor to the second tread, to the platform, and from there
    to the floor; and the place on the plan and the control steps of each pose that was held."""

    def play(starts: tuple[float, float], steps: int, **more: Any) -> tuple[np.ndarray, np.ndarray]:
        worlds = ClimbingWorlds(
            episodes,
            device,
            num_threads=threads,
            seed=TEST_SEED,
            starts=[starts],
            horizon_steps=steps + 1,
            **(varied(settings) | more),
        )
        parts = worlds.numbers[:, worlds.env.fields["phase"][0].start] * PHASE_S
        return parts.copy(), played(actor, worlds, steps)

    def follow(start: float, seconds: float, rate: float, backwards: float) -> float:
        steps = int(seconds / rate / CONTROL_DT) + 50
        _, lasted = play((start, start), steps, rates=(rate, rate), backwards=backwards, holds=0.0)
        return float((lasted >= steps).mean())

    parts, held = play((0.0, 1000.0), HOLD_STEPS, holds=1.0)
    found = {
        "held": float((held >= HOLD_STEPS).mean()),
        "treads": follow(0.0, FIRST_TREADS_S, 1.5, 0.0),
        "up": follow(0.0, 116.0, 2.0, 0.0),
        "down": follow(1000.0, 116.0, 2.0, 1.0),
    }
    return found | {"score": sum(found.values())}, list(zip(parts.tolist(), held.tolist()))
