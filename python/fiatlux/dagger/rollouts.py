"""Clean episodes of a lesson as bags: their actions are kept, and played again."""

import shutil
from collections.abc import Sequence
from itertools import chain, repeat
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from ..evaluation import evaluate

Array = NDArray[Any]


class Rollouts:
    """Actions of clean episodes of a room's first start, which a recorded evaluation can play again. At most one a room is kept, and at most
    so many of all."""

    def __init__(self, rooms: Sequence[int], steps: int, joints: int, most: int) -> None:
        self.rooms, self.most = np.asarray(rooms), most
        self.actions = np.zeros((len(rooms), steps, joints))
        self.kept: dict[int, Array] = {}

    def step(self, count: Array, actions: Array) -> None:
        """Takes down the actions of all worlds, each in the control step of its episode."""
        self.actions[np.arange(len(count)), count] = actions

    def end(self, episode: Array, count: Array, clean: Array) -> None:
        """Ends the marked worlds' episodes, which began at these starts and were of so many steps."""
        for world in np.flatnonzero(clean & (episode == 0)):
            if len(self.kept) < self.most:
                self.kept.setdefault(int(self.rooms[world]), self.actions[world, : count[world]].copy())

    def record(self, task: str, robot: str, name: str, folder: Path) -> None:
        """Plays them again into thin bags, in place of what a lesson left that was stopped.

        Raises:
            RuntimeError: An episode was another one, or is missing.
        """
        shutil.rmtree(folder, ignore_errors=True)
        played = evaluate(
            Again(self.kept),
            [task],
            sorted(self.kept),
            out=folder,
            bags="thin",
            name=name,
            action_form="joint_target",
            protocol="strict",
            robot=cast(Any, robot),
        )
        if played.lost:
            raise RuntimeError(f"{folder}: {'; '.join(played.lost)}")
        for episode in played.episodes:
            steps = len(self.kept[episode["seed"]])
            if not episode["strict_success"] or episode["strict_steps"] != steps:
                raise RuntimeError(
                    f"{folder}: room {episode['seed']} succeeded after {steps} steps in the lesson, and its bag ends after "
                    f"{episode['strict_steps']}; please report this"
                )


class Again:
    """Plays kept actions, by room, and holds the last one."""

    def __init__(self, actions: dict[int, Array]) -> None:
        self.actions = actions

    def reset(self, info: dict[str, Any]) -> None:
        """Begins an episode."""
        self.left = chain(self.actions[info["seed"]], repeat(self.actions[info["seed"]][-1]))

    def __call__(self, observation: Any) -> Array:
        """The next action."""
        return next(self.left)
