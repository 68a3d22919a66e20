"""Makes the environments known to Gymnasium."""

import gymnasium

from .tasks import TASKS


def register() -> None:
    """Registers the fourteen tasks and walking, each as one environment and as a vector of them."""
    for task in TASKS.values():
        gymnasium.register(
            id=task.id,
            entry_point="fiatlux.env:Env",
            vector_entry_point="fiatlux.vector:VectorEnv",
            kwargs={"task": task.short_id},
        )
    gymnasium.register(id="Fiatlux-Walking-v1", vector_entry_point="fiatlux.vector:WalkingVectorEnv")
