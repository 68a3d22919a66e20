"""Wraps worlds as a ``VecEnv`` of Stable-Baselines3; needs the extra ``train``."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium import spaces

from ._extras import missing
from .vector import VectorEnv, WalkingVectorEnv, check_trainer

try:
    from stable_baselines3.common.vec_env.base_vec_env import VecEnv
except ImportError as error:
    raise missing("fiatlux.stable_baselines3", "train", error) from error


def _undotted(observation: Any) -> Any:
    """An observation whose names are valid for PyTorch modules."""
    if not isinstance(observation, dict):
        return observation
    return {name.replace(".", "_"): part for name, part in observation.items()}


class StableBaselinesVecEnv(VecEnv):
    """Wraps a vector of worlds; observations may be flat or dictionaries.

    PyTorch allows no dots in module names, and the library makes a module for each field: ``privileged.foot_load`` is
    ``privileged_foot_load`` here.
    """

    def __init__(self, env: VectorEnv | WalkingVectorEnv) -> None:
        check_trainer(env, "StableBaselinesVecEnv")
        if env._final is None:
            raise ValueError(
                "StableBaselinesVecEnv: the library learns from the last observation of each episode; make env with final_obs=True"
            )
        self.env = env
        self.render_mode = None
        self._actions: np.ndarray | None = None
        space = env.single_observation_space
        if isinstance(space, spaces.Dict):
            space = spaces.Dict(_undotted(space.spaces))
        super().__init__(env.num_envs, space, env.single_action_space)

    def reset(self) -> Any:
        """Begins an episode in every world; uses the seed given to :meth:`seed` once."""
        seed = self._seeds[0]
        observation, _ = self.env.reset(seed=seed)
        self._reset_seeds()
        self.reset_infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        return _undotted(observation)

    def step_async(self, actions: np.ndarray) -> None:
        """Stores the actions for :meth:`step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[Any, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """Takes the control step with the stored actions."""
        observation, rewards, terminated, truncated, info = self.env.step(self._actions)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        ended = terminated | truncated
        for world in np.flatnonzero(ended):
            final = _undotted(info["final_obs"])
            last = {name: part[world] for name, part in final.items()} if isinstance(final, dict) else final[world]
            infos[world] = {
                "terminal_observation": last,
                "TimeLimit.truncated": bool(truncated[world] and not terminated[world]),
                "is_success": bool(info["success"][world]),
            }
        return _undotted(observation), rewards, ended, infos

    def close(self) -> None:
        """Ends the worlds and their threads."""
        self.env.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute of the vector, repeated for each requested world."""
        return [getattr(self.env, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refused: the worlds share one object."""
        raise AttributeError(f"cannot set {attr_name!r}: the worlds share one object; make it with other arguments")

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Refused: worlds have no methods of their own."""
        raise AttributeError(f"cannot call {method_name!r} of a world; call it on the vector, which is `.env`")

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> Sequence[bool]:
        """Worlds have no wrappers of their own."""
        return [False] * len(list(self._get_indices(indices)))
