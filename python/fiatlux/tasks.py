"""The tasks of the benchmark."""

from typing import NamedTuple

from . import _native


class Task(NamedTuple):
    """A task of the benchmark."""

    short_id: str
    """Short id, such as ``S05`` or ``replace``."""
    id: str
    """Id of the environment, such as ``Fiatlux-S05-CarryBulbToDisposal-v1``."""
    name: str
    """Name in words, such as ``Carry Bulb to Disposal``."""
    instruction: str
    """Instruction to the robot, in words."""
    horizon_steps: int
    """Control steps of 20 ms until time-out."""


TASKS: dict[str, Task] = {task.short_id: task for task in (Task(*fields) for fields in _native.tasks())}
"""All tasks, by short id."""

SUBTASKS: tuple[str, ...] = tuple(f"S{number:02}" for number in range(1, 13))
"""Short ids of the twelve subtasks that make up the benchmark's score."""
