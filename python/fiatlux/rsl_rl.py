"""Wraps worlds as a ``VecEnv`` of RSL-RL; needs the extra ``train``.

There are two observation groups: ``policy`` has the fields that a robot can sense, ``critic`` has all of them.
"""

from typing import Any

import numpy as np

from ._extras import missing
from .vector import VectorEnv, WalkingVectorEnv, check_trainer

try:
    import torch
    from rsl_rl.env import VecEnv
    from tensordict import TensorDict
except ImportError as error:
    raise missing("fiatlux.rsl_rl", "train", error) from error


class RslRlVecEnv(VecEnv):
    """Wraps a vector of worlds that was made with ``observation="flat"``.

    Args:
        env: The worlds, with flat observations.
        max_episode_length: Control steps until the task's time-out; the runner reads it.
        device: PyTorch device of the tensors.
        cfg: What the runner should log about the environment.
    """

    def __init__(
        self,
        env: VectorEnv | WalkingVectorEnv,
        max_episode_length: int,
        device: str = "cpu",
        cfg: dict[str, Any] | None = None,
    ) -> None:
        shape = env.single_observation_space.shape
        if shape is None:
            raise ValueError("the observations of env are dictionaries; make it with observation='flat'")
        check_trainer(env, "RslRlVecEnv")
        self.env = env
        self.num_envs = env.num_envs
        self.num_actions = int(np.prod(env.single_action_space.shape or ()))
        self.max_episode_length = max_episode_length
        self.device = device
        self.cfg = cfg or {}
        self._lengths = torch.zeros(self.num_envs, dtype=torch.long, device=device)
        sensed = [field for name, (field, _) in env.fields.items() if not name.startswith(("privileged.", "verdict."))]
        columns = np.concatenate([np.arange(field.start, field.stop) for field in sensed])
        self._columns = None if len(columns) == shape[0] else torch.as_tensor(columns, device=device)
        self._latest = self._tensors(env.reset()[0])

    @property
    def episode_length_buf(self) -> torch.Tensor:
        """Control steps of each world's episode. Setting them, as the runner's random initial lengths do, lets the worlds time out as
        if their episodes had so many already."""
        return self._lengths

    @episode_length_buf.setter
    def episode_length_buf(self, lengths: torch.Tensor) -> None:
        self._lengths = lengths.to(self.device)
        steps = [row["step"] for row in map(self.env.row, range(self.num_envs))]
        self.env.stagger(np.maximum(self._lengths.cpu().numpy() - steps, 0))

    def get_observations(self) -> TensorDict:
        """The observation of the last step, or of the start."""
        return self._latest

    def step(self, actions: torch.Tensor) -> tuple[TensorDict, torch.Tensor, torch.Tensor, dict[str, Any]]:
        """Takes a control step; marks time-outs in the extras, so that the runner can bootstrap."""
        observation, rewards, terminated, truncated, info = self.env.step(actions.detach().cpu().numpy())
        ended = torch.as_tensor(terminated | truncated, device=self.device)
        self._lengths = torch.where(ended, 0, self._lengths + 1)
        self._latest = self._tensors(observation)
        means = info["reward_terms"].mean(axis=0)
        extras = {
            "time_outs": torch.as_tensor(truncated, device=self.device),
            "log": {f"reward/{name}": float(mean) for name, mean in zip(self.env.reward_terms, means)},
        }
        return self._latest, torch.as_tensor(rewards, device=self.device), ended.to(torch.long), extras

    def _tensors(self, observation: np.ndarray) -> TensorDict:
        critic = torch.as_tensor(observation, device=self.device)
        policy = critic if self._columns is None else critic[:, self._columns]
        return TensorDict({"policy": policy, "critic": critic}, batch_size=[self.num_envs], device=self.device)
