"""The published benchmark's baseline: PPO on the joints of one task, from nothing.

Rewards and ends are the published ones, the settings those of the reference implementation for RSL-RL. The worlds go on from one
segment to the next, and a checkpoint holds their state: episodes of two minutes are longer than a segment.
"""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
from rsl_rl.models import MLPModel

from .. import _native
from ..tasks import TASKS
from ..vector import VectorEnv
from .run import CONTROL_DT, GROUPS, Run
from .settings import FIRST_ROOM, FIRST_TEST_ROOM, Baseline
from .worlds import TaskWorlds

LOOKS = 40
"""Control steps by which the scales of the observation are found before the first iteration."""
TEST_EPISODES, TEST_STEPS = 64, 1000
"""Episodes and control steps of a test during the run."""


def models(worlds: TaskWorlds, settings: Baseline) -> tuple[MLPModel, MLPModel]:
    """Policy and critic, new."""
    deviation = {"class_name": "GaussianDistribution", "init_std": settings.std, "std_type": "scalar"}
    common: dict[str, Any] = {"activation": "elu", "obs_normalization": True}
    hidden = {"hidden_dims": list(settings.hidden), "distribution_cfg": deviation}
    actor = MLPModel(worlds.observation, GROUPS, "actor", worlds.num_actions, **hidden, **common)
    critic = MLPModel(worlds.observation, GROUPS, "critic", 1, hidden_dims=list(settings.critic), **common)
    actor.obs_normalizer.eps, critic.obs_normalizer.eps = worlds.floors["policy"], worlds.floors["critic"]
    return actor, critic


def worlds_of(
    settings: Baseline, device: str, num_envs: int, first_room: int, seed: int, threads: int | None, **more: Any
) -> TaskWorlds:
    """Worlds of the task with everything that policy and critic see."""
    sensors = settings.sensors or _native.body_sensors(settings.task)
    env = VectorEnv(
        settings.task,
        num_envs,
        seeds=range(first_room, first_room + min(settings.rooms, num_envs)),
        episodes=settings.episodes,
        num_threads=threads,
        seed=seed,
        observation="flat",
        sensors=[*sensors, "privileged", "verdict"],
        reward=settings.reward,
        protocol=settings.protocol,
        robot=settings.robot,
        copy=False,
        **more,
    )
    return TaskWorlds(env, device)


class BaselineRun(Run):
    """A run of the baseline."""

    kind = "ppo"
    tests = ("success", "gate_progress", "fell", "seconds", "reward", "score")
    settings: Baseline
    worlds: TaskWorlds

    def make_worlds(self, seed: int) -> TaskWorlds:
        settings = self.settings
        return worlds_of(settings, self.device, settings.worlds, FIRST_ROOM, seed, self.threads, final_obs=False)

    def begin_new(self) -> None:
        self.look(LOOKS)
        if self.settings.stagger:
            self.worlds.env.stagger()

    def begin_segment(self) -> None:
        """The worlds go on; only the noise of the actions begins anew."""
        self.seed_noise()

    def models(self) -> tuple[MLPModel, MLPModel]:
        return models(self.worlds, self.settings)

    def algorithm(self) -> dict[str, Any]:
        return super().algorithm() | {
            "clip_param": 0.2,
            "gamma": 0.99,
            "lam": 0.95,
            "value_loss_coef": 1.0,
            "learning_rate": self.settings.learning_rate,
            "max_grad_norm": 1.0,
            "use_clipped_value_loss": True,
            "schedule": "fixed",
        }

    def adapt(self, kl: float) -> None:
        self.adapt_once(kl)

    def state(self) -> dict[str, Any]:
        _, (worlds,) = self.worlds.env.save().__reduce__()
        return super().state() | {"worlds": torch.frombuffer(bytearray(worlds), dtype=torch.uint8)}

    def load(self, state: Mapping[str, Any]) -> None:
        super().load(state)
        snapshot = _native.Snapshot(state["worlds"].numpy().tobytes())
        self.worlds.see(self.worlds.env.restore(snapshot))

    def described(self, row: Mapping[str, float]) -> str:
        return f"successes {row['successes_per_1000_steps']:.2f}  "

    def test(self) -> dict[str, float]:
        actor = self.ppo.actor
        found = measure(actor, self.settings, self.device, self.threads, TEST_EPISODES, TEST_STEPS)
        actor.train()
        return found


def measure(
    actor: Any,
    settings: Baseline,
    device: str,
    threads: int | None,
    episodes: int,
    steps: int | None = None,
    progress: Callable[[int], None] = lambda step: None,
) -> dict[str, float]:
    """Plays ``episodes`` episodes in rooms that training has not seen, up to ``steps`` control steps each, with the policy's mean
    actions. Shares are of all episodes; ``seconds`` and ``reward`` are means of an episode, the reward per episode."""
    worlds = worlds_of(
        settings, device, episodes, FIRST_TEST_ROOM, 1, threads, final_obs=True, autoreset_mode="same_step"
    )
    steps = steps or TASKS[settings.task].horizon_steps
    place = worlds.env.fields["verdict.gate_progress"][0].start
    best, total = np.zeros(episodes), np.zeros(episodes)
    alive, success, fell = np.ones(episodes, bool), np.zeros(episodes, bool), np.zeros(episodes, bool)
    lasted = np.zeros(episodes)
    actor.eval()
    with torch.inference_mode():
        for step in range(steps):
            progress(step)
            if not alive.any():
                break
            reward, terminated, truncated, info = worlds.step(actor(worlds.observation))
            # Where an episode ended, the observation is the first of the next one.
            ended = terminated | truncated
            shown = worlds.numbers[:, place].copy()
            if ended.any():
                shown[ended] = info["final_obs"][ended, place]
            best = np.where(alive, np.maximum(best, shown), best)
            total += alive * reward.cpu().numpy()
            lasted += alive
            success |= alive & info["success"]
            fell |= alive & terminated & ~info["success"]
            alive &= ~ended
    worlds.env.close()
    progress_share, reward_mean = float(best.mean()), float(total.mean())
    return {
        "success": float(success.mean()),
        "gate_progress": progress_share,
        "fell": float(fell.mean()),
        "seconds": float(lasted.mean()) * CONTROL_DT,
        "reward": reward_mean,
        # Most episodes of a young policy succeed as little as each other; what they were paid tells them apart.
        "score": float(success.mean()) + progress_share + 1e-3 * reward_mean,
    }
