"""Provides worlds of walking with the observation groups of RSL-RL."""

from typing import Any

import numpy as np
import torch
from tensordict import TensorDict

from ..vector import WalkingVectorEnv
from .symmetry import Mirror, columns


class Worlds:
    """Worlds whose observation has the groups ``policy`` and ``critic``."""

    def __init__(self, num_envs: int, device: str, without: tuple[str, ...] = (), **settings: Any) -> None:
        if "history" in without:
            settings["frames"] = 1
        if "clock" in without:
            settings["reward_weights"] = {"feet_height": 0.0, "feet_contact": 0.0, **settings.get("reward_weights", {})}
        self.env = WalkingVectorEnv(num_envs, observation="flat", copy=False, final_obs=False, **settings)
        self.num_envs = num_envs
        self.num_actions = int(np.prod(self.env.single_action_space.shape or ()))
        self.device = device
        groups = columns(self.env.fields)
        self.mirrors: dict[str, Mirror] = {name: mirror for name, (_, mirror) in groups.items()}
        self._columns = {name: torch.as_tensor(index, device=device) for name, (index, _) in groups.items()}
        self._blanked = self.env.fields["clock"][0] if "clock" in without else slice(0, 0)
        self.numbers = self.env.reset()[0]
        self.observation = self._show()

    def step(self, actions: torch.Tensor) -> tuple[torch.Tensor, np.ndarray, np.ndarray, np.ndarray]:
        """Takes a control step; returns reward, terminated, truncated, and the terms of the reward."""
        numbers, reward, terminated, truncated, info = self.env.step(actions.detach().cpu().numpy())
        self.numbers = numbers
        self.observation = self._show()
        return torch.from_numpy(reward).to(self.device), terminated, truncated, info["reward_terms"]

    def field(self, name: str) -> np.ndarray:
        """The newest frame of a field, worlds x numbers."""
        place, shape = self.env.fields[name]
        return self.numbers[:, place].reshape(self.num_envs, -1, shape[-1])[:, -1]

    def _show(self) -> TensorDict:
        self.numbers[:, self._blanked] = 0.0
        numbers = torch.from_numpy(self.numbers).to(self.device)
        groups = {name: numbers[:, index] for name, index in self._columns.items()}
        return TensorDict(groups, batch_size=[self.num_envs], device=self.device)
