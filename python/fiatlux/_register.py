"""Registers the environments with Gymnasium."""

import gymnasium

from .tasks import TASKS


def only_vectors(**arguments: object) -> gymnasium.Env[object, object]:
    """Walking is a vector of worlds alone."""
    raise ValueError(
        "Fiatlux-Walking-v1 is a vector of worlds: use gymnasium.make_vec with vectorization_mode='vector_entry_point', or "
        "fiatlux.WalkingVectorEnv(1)"
    )


def register() -> None:
    """Registers the fourteen tasks, each as a single environment and as a vector of worlds, and walking as a vector."""
    for task in TASKS.values():
        gymnasium.register(
            id=task.id,
            entry_point="fiatlux.env:Env",
            vector_entry_point="fiatlux.vector:VectorEnv",
            kwargs={"task": task.short_id},
        )
    gymnasium.register(
        id="Fiatlux-Walking-v1",
        entry_point="fiatlux._register:only_vectors",
        vector_entry_point="fiatlux.vector:WalkingVectorEnv",
    )
