"""The native part; what users meet is in the package's modules."""

from collections.abc import Callable
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

__version__: str
BENCHMARK_VERSION: int
MAX_WORLDS: int
MAX_THREADS: int
MAX_STARTS: int
BODY_COMMAND: list[str]
BODY_COMMAND_KEYS: list[str]

class FiatluxError(Exception):
    """The simulator refused a request; the message names the field and the remedy."""

def tasks() -> list[tuple[str, str, str, str, int]]: ...
def sensors() -> list[str]: ...
def controller_contract(
    frames: int, hidden: list[int], seed: int, samples: int, minutes: float, hardware: str
) -> str: ...
def benchmark(episodes: list[dict[str, Any]]) -> dict[str, Any]: ...
def evaluate_into(
    out: str,
    make_player: Callable[[], Any],
    run: dict[str, Any],
    settings: dict[str, Any],
    progress: Callable[[dict[str, Any]], None] | None,
) -> tuple[str, list[str]]: ...

class Client:
    def __init__(
        self,
        endpoints: list[str],
        config: str | None,
        token: str | None,
        server_key: str | None,
        known_servers: str | None,
    ) -> None: ...
    def run(
        self,
        player: Any,
        name: str,
        server: str | None,
        task: str,
        seed: int,
        episode: int,
        settings: dict[str, Any],
        record: list[str],
    ) -> dict[str, Any]: ...
    def evaluate(
        self,
        make_player: Callable[[], Any],
        run: dict[str, Any],
        settings: dict[str, Any],
        progress: Callable[[dict[str, Any]], None] | None,
    ) -> dict[str, Any]: ...

class Bag:
    is_whole: bool
    def __init__(self, path: str | PathLike[str]) -> None: ...
    def header(self) -> dict[str, Any]: ...
    def result(self) -> dict[str, Any] | None: ...
    @staticmethod
    def topics() -> list[str]: ...
    def columns(self, topic: str) -> dict[str, Any]: ...

class Snapshot:
    def __init__(self, bytes: bytes) -> None: ...

class Batch:
    num_worlds: int
    num_threads: int
    spec: dict[str, Any]
    def __init__(self, kind: str, arguments: tuple[Any, ...], snapshot: Snapshot | None = None) -> None: ...
    @staticmethod
    def walking_weights() -> dict[str, float]: ...
    def reset(self, seed: int | None, marks: NDArray[np.bool_] | None, observation: NDArray[np.float32]) -> None: ...
    def step(
        self,
        actions: NDArray[np.float64],
        observation: NDArray[np.float32],
        final_observation: NDArray[np.float32] | None,
        reward: NDArray[np.float32],
        reward_terms: NDArray[np.float32] | None,
        terminated: NDArray[np.bool_],
        truncated: NDArray[np.bool_],
        success: NDArray[np.bool_],
    ) -> None: ...
    def reset_world(self, world: int, observation: NDArray[np.float32], like: int | None = None) -> None: ...
    def save(self) -> Snapshot: ...
    def restore(self, snapshot: Snapshot, observation: NDArray[np.float32]) -> None: ...
    def row(self, world: int) -> dict[str, Any]: ...

class Episode:
    spec: dict[str, Any]
    digest: str
    def __init__(
        self,
        task: str,
        seed: int,
        episode: int,
        settings: dict[str, Any],
        actions: NDArray[np.float64] | None = None,
    ) -> None: ...
    def observe(self, observation: NDArray[np.float32]) -> None: ...
    def step(self, action: NDArray[np.float64]) -> tuple[float, bool, bool]: ...
    def reward_terms(self) -> dict[str, float]: ...
    def summary(self) -> dict[str, Any]: ...
    def row(self) -> dict[str, Any]: ...
    def mjcf(self, nearest: bool) -> str: ...
    def render(self, width: int, height: int, camera: str | None = None) -> bytes: ...

class WholeBody:
    def __init__(self, weights: str | None) -> None: ...
    def restart(self) -> None: ...
    def joints(self) -> list[tuple[str, float, float, float, float]]: ...
    def check(self, command: list[float]) -> None: ...
    def step(
        self,
        base_angular_velocity: list[float],
        projected_gravity: list[float],
        base_linear_velocity: list[float],
        base_height: float,
        joint_position: list[float],
        joint_velocity: list[float],
        command: list[float],
    ) -> list[float]: ...
    def hold_arms(
        self, projected_gravity: list[float], joint_position: list[float], angles: list[float]
    ) -> list[float]: ...
