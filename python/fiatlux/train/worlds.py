"""Provides worlds with the observation groups of RSL-RL."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict

from ..vector import VectorEnv, WalkingVectorEnv
from .symmetry import Mirror, columns

MIN_DEVIATION, MIN_FORCE = 0.05, 10.0
"""Added to the deviation by which a number of the observation is divided, and to that of a force, N."""


class Worlds:
    """Worlds whose observation has the groups ``policy`` and ``critic``: columns of the flat observation."""

    def __init__(self, env: Any, groups: Mapping[str, Any], device: str) -> None:
        self.env = env
        self.num_envs: int = env.num_envs
        self.num_actions = int(np.prod(env.single_action_space.shape or ()))
        self.device = device
        self._columns = {name: torch.as_tensor(index, device=device) for name, index in groups.items()}
        self.see(env.reset()[0])

    @property
    def reward_terms(self) -> Sequence[str]:
        """Name of each term of the reward."""
        terms: list[str] = self.env.reward_terms
        return terms

    def see(self, numbers: NDArray[np.float32]) -> None:
        """Takes over an observation of all worlds."""
        self.numbers = numbers
        on_device = torch.from_numpy(numbers).to(self.device)
        groups = {name: on_device[:, index] for name, index in self._columns.items()}
        self.observation = TensorDict(groups, batch_size=[self.num_envs], device=self.device)

    def step(self, actions: torch.Tensor) -> tuple[torch.Tensor, np.ndarray, np.ndarray, dict[str, Any]]:
        """Takes a control step; returns reward, terminated, truncated, and info."""
        numbers, reward, terminated, truncated, info = self.env.step(actions.detach().cpu().numpy())
        self.see(numbers)
        return torch.from_numpy(reward).to(self.device), terminated, truncated, info


class TaskWorlds(Worlds):
    """Worlds of a task of the benchmark. The policy has the fields that a robot can sense, the critic the exact ones too."""

    def __init__(self, env: VectorEnv, device: str) -> None:
        places = {name: np.arange(place.start, place.stop) for name, (place, _) in env.fields.items()}
        sensed = [place for name, place in places.items() if not name.startswith(("privileged.", "verdict."))]
        known = [place for name, place in places.items() if not name.startswith("verdict.")]
        super().__init__(env, {"policy": np.concatenate(sensed), "critic": np.concatenate(known)}, device)
        # A force that was never felt would else count as hundreds of deviations when it is.
        floor = np.full(self.numbers.shape[1], MIN_DEVIATION, np.float32)
        for name, index in places.items():
            floor[index] = MIN_FORCE if "contact" in name else MIN_DEVIATION
        self.floors = {name: torch.as_tensor(floor, device=device)[index] for name, index in self._columns.items()}


class WalkingWorlds(Worlds):
    """Worlds of walking by velocity command."""

    def __init__(self, num_envs: int, device: str, without: tuple[str, ...] = (), **settings: Any) -> None:
        if "history" in without:
            settings["frames"] = 1
        if "clock" in without:
            settings["reward_weights"] = {"feet_height": 0.0, "feet_contact": 0.0, **settings.get("reward_weights", {})}
        env = WalkingVectorEnv(num_envs, observation="flat", copy=False, final_obs=False, **settings)
        groups = columns(env.fields)
        self.mirrors: dict[str, Mirror] = {name: mirror for name, (_, mirror) in groups.items()}
        self._blanked = env.fields["clock"][0] if "clock" in without else slice(0, 0)
        super().__init__(env, {name: index for name, (index, _) in groups.items()}, device)

    def see(self, numbers: NDArray[np.float32]) -> None:
        numbers[:, self._blanked] = 0.0
        super().see(numbers)

    def field(self, name: str) -> np.ndarray:
        """The newest frame of a field, worlds x numbers."""
        place, shape = self.env.fields[name]
        return self.numbers[:, place].reshape(self.num_envs, -1, shape[-1])[:, -1]
