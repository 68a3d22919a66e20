"""Names of the robots, for editors and type checkers, which read no data: `tests/test_users.py` compares them with the robots' files."""

from typing import Literal

Robot = Literal["g1_inspire", "g1_bare", "g1_dex3", "g1_inspire6", "inspire", "bare", "dex3", "inspire6"]
"""Name of a robot, or of its hands."""
