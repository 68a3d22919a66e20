"""Registers the environments with Gymnasium."""

import gymnasium

from .tasks import TASKS


def register() -> None:
    """Registers the fourteen tasks, each as a single environment and as a vector of worlds, and walking as a vector."""
    for task in TASKS.values():
        gymnasium.register(
            id=task.id,
            entry_point="fiatlux.env:Env",
            vector_entry_point="fiatlux.vector:VectorEnv",
            kwargs={"task": task.short_id},
        )
    gymnasium.register(id="Fiatlux-Walking-v1", vector_entry_point="fiatlux.vector:WalkingVectorEnv")
