"""Training of the whole-body controller. The worlds of each segment begin anew."""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rsl_rl.models import MLPModel

from .evaluation import score
from .run import GROUPS, Run, Stopped
from .settings import SCENES, Walk, weights_of, worlds_of
from .start import begin_with
from .symmetry import MOVED, Mirror, SymmetricModel
from .worlds import WalkingWorlds

VELOCITY = ("track_lin_vel", "track_lin_vel_smoothed")
"""The reward's terms of velocity, each of which is its weight at best."""
STOP_KL = 1.0
"""A policy that moves so far in one iteration has broken, but for the first ones, in which the normaliser has yet to settle."""
SETTLES = 5
START_RATE = 3e-5
"""Learning rate with which a policy that has learned already goes on, before it is adjusted."""


def models(worlds: WalkingWorlds, settings: Walk) -> tuple[MLPModel, MLPModel]:
    """Policy and critic, new."""
    deviation = {"class_name": "GaussianDistribution", "init_std": 0.6, "std_type": "log", "std_range": (0.05, 1.0)}
    observation, mirrors = worlds.observation, worlds.mirrors
    is_symmetric = "symmetry" not in settings.without

    def model(group: str, part: str, outputs: int, mirror: Mirror, hidden: tuple[int, ...], **more: Any) -> MLPModel:
        kind = SymmetricModel if is_symmetric else MLPModel
        more |= {"inputs": mirrors[group], "outputs": mirror} if is_symmetric else {"obs_normalization": True}
        return kind(observation, GROUPS, part, outputs, hidden_dims=list(hidden), activation="elu", **more)

    actor = model("policy", "actor", worlds.num_actions, MOVED, settings.hidden, distribution_cfg=deviation)
    return actor, model("critic", "critic", 1, ([0], [1.0]), settings.critic)


class WalkRun(Run):
    """A run of the whole-body controller."""

    kind = "walk"
    tests = ("survived", "velocity", "turning", "height", "torso", "score")
    progress = (*Run.progress, "difficulty")
    settings: Walk
    worlds: WalkingWorlds

    def prepare(self) -> None:
        self.difficulty = self.settings.start_difficulty

    def begin_new(self) -> None:
        if self.settings.start:
            begin_with(self, Path(self.settings.start))

    def resume_with(self, given: Mapping[str, Any]) -> None:
        if "start_difficulty" in given:
            self.difficulty = self.settings.start_difficulty
        if "widen" in given:
            self.ppo.actor.distribution.log_std_param.data += math.log(self.settings.widen)

    def make_worlds(self, seed: int) -> WalkingWorlds:
        settings = self.settings
        given = worlds_of(self.difficulty, settings.pushes) | SCENES[settings.scene]
        given["reward_weights"] = weights_of(settings.reward)
        return WalkingWorlds(
            settings.worlds, self.device, settings.without, num_threads=self.threads, seed=seed, **given
        )

    def models(self) -> tuple[MLPModel, MLPModel]:
        return models(self.worlds, self.settings)

    def begin_iterations(self) -> None:
        """Less exploration the longer a run lasts; a new critic first learns alone."""
        settings, ppo = self.settings, self.ppo
        if settings.start:
            ppo.actor.requires_grad_(self.segment > 0).train(self.segment > 0)
            ppo.learning_rate = START_RATE if self.segment == 1 else ppo.learning_rate
        done = min(max((self.samples - settings.calm_from) / settings.calm_over, 0.0), 1.0)
        ppo.entropy_coef = settings.entropy * (1 - done * 5 / 6)
        least = settings.least_std + done * (min(0.05, settings.least_std) - settings.least_std)
        ppo.actor.distribution.log_std_range[0] = math.log(least)

    def check_update(self, kl: float, iteration: int) -> None:
        if kl > STOP_KL and not (self.segment == 0 and iteration <= SETTLES):
            raise Stopped(f"the policy moved by a KL of {kl:.2f} in one iteration")

    def end_iterations(self, row: dict[str, float], paid: Mapping[str, float]) -> None:
        """Makes it harder if robots seldom fall and follow their commands."""
        row["difficulty"] = self.difficulty
        settings = self.settings
        # A robot that is made to bend and carry before it walks learns to step in place.
        could_pay = sum(self.worlds.env.reward_weights[name] for name in VELOCITY)
        follows = sum(paid[name] for name in VELOCITY) >= settings.tracks * could_pay
        if row["falls_per_1000_steps"] < settings.falls and follows:
            self.difficulty = min(self.difficulty + settings.harder, settings.most_difficult)

    def described(self, row: Mapping[str, float]) -> str:
        return f"difficulty {row['difficulty']:.2f}  "

    def test(self) -> dict[str, float]:
        return score(self.ppo.actor, self.device, self.threads, self.settings.without)
