"""The tasks of the benchmark."""

from typing import NamedTuple

from . import _native


class Task(NamedTuple):
    """A task of the benchmark."""

    short_id: str
    """``S05``, ``replace``."""
    id: str
    """``Fiatlux-S05-CarryBulbToDisposal-v1``."""
    name: str
    """``Carry Bulb to Disposal``."""
    instruction: str
    """What the robot is told."""
    horizon_steps: int
    """Control steps of 20 ms until time-out."""


TASKS: dict[str, Task] = {task.short_id: task for task in (Task(*fields) for fields in _native.tasks())}
"""All tasks, by short id."""

SUBTASKS: tuple[str, ...] = tuple(f"S{number:02}" for number in range(1, 13))
"""The twelve subtasks that the benchmark's score is made of."""
