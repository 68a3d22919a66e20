"""A trained baseline as a policy, without the libraries that trained it."""

import hashlib
import json
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ._files import regular

FORMAT = "fiatlux-baseline/1"
"""Name and version of the contract's layout."""
TOLERANCE = 1e-3
"""Largest difference from what the network gave when it was exported."""


def format_of(file: str | PathLike[str]) -> Any:
    """Format that the contract of an exported file names, if it has one.

    Raises:
        ValueError: It is not an exported file.
    """
    _, metadata = _tensors(Path(file), regular(file).read_bytes())
    try:
        return json.loads(metadata["contract"])["format"]
    except (KeyError, TypeError, ValueError):
        return None


class Network:
    """The network of a file that was exported, with its contract.

    Args:
        file: The file.
        form: Format that its contract must name.
        command: Command of the training, for messages.

    Raises:
        ValueError: It is not such a file, or it is damaged.
    """

    def __init__(self, file: str | PathLike[str], form: str, command: str) -> None:
        data = regular(file).read_bytes()
        tensors, metadata = _tensors(Path(file), data)
        try:
            self.contract: dict[str, Any] = json.loads(metadata["contract"])
            layers = len(self.contract["hidden"]) + 1
            parts = [(tensors[f"layer{n}.weight"], tensors[f"layer{n}.bias"]) for n in range(layers)]
            observation, action = tensors["check.observation"], tensors["check.action"]
            given = self.contract["format"]
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(
                f"{file}: it has no contract of a policy of {command}; export a checkpoint of {command}"
            ) from error
        if given != form:
            raise ValueError(
                f"{file}: its contract is {given}, this version reads {form}; export a checkpoint of {command} again"
            )
        self._layers = parts
        self.inputs: int = parts[0][0].shape[1]
        """Numbers that it sees."""
        self.name = f"{Path(file).name}@{hashlib.sha256(data).hexdigest()[:12]}"
        """Name and digest of the file."""
        difference = float(np.abs(self(observation) - action).max())
        if not difference <= TOLERANCE:
            raise ValueError(f"{file}: the network differs from its export by {difference:.2g}; export it again")

    def __call__(self, numbers: NDArray[np.float32]) -> NDArray[np.float32]:
        """The mean action that answers an observation."""
        for number, (weight, bias) in enumerate(self._layers):
            numbers = weight @ numbers + bias
            if number < len(self._layers) - 1:
                numbers = np.where(numbers > 0, numbers, np.expm1(np.minimum(numbers, 0)))
        return numbers


class Baseline:
    """The policy of a file that ``python -m fiatlux.train export`` wrote from a run of ``ppo``::

        fiatlux.evaluate(fiatlux.Baseline("s02.safetensors"), tasks=["S02"])

    Args:
        file: The file.

    Raises:
        ValueError: It is not such a file, or it is damaged.
    """

    action_form = "action"

    def __init__(self, file: str | PathLike[str]) -> None:
        self._network = network = Network(file, FORMAT, "ppo")
        self.contract = network.contract
        try:
            self.sensors, self.robot = list(self.contract["sensors"]), str(self.contract["robot"])
        except (KeyError, TypeError) as error:
            raise ValueError(f"{file}: its contract lacks {error}; export a checkpoint of ppo again") from error
        self.__name__ = f"ppo:{network.name}"

    def __repr__(self) -> str:
        return f"<fiatlux.Baseline {self.__name__}: {self.robot}, {self._network.inputs} numbers of {', '.join(self.sensors)}>"

    def __call__(self, observation: Any) -> NDArray[np.float32]:
        """The mean action that answers an observation, as a dictionary of fields or as one vector."""
        if isinstance(observation, dict):
            observation = np.concatenate([np.ravel(field) for field in observation.values()])
        numbers: NDArray[np.float32] = np.asarray(observation, np.float32)
        expected = self._network.inputs
        if numbers.shape != (expected,):
            sensors = ", ".join(self.sensors)
            raise ValueError(f"observation: shape {numbers.shape} instead of ({expected},); its sensors are {sensors}")
        return self._network(numbers)


def _tensors(file: Path, data: bytes) -> tuple[dict[str, NDArray[np.float32]], dict[str, str]]:
    """Tensors and metadata of a safetensors file of float32."""
    try:
        length = int.from_bytes(data[:8], "little")
        header, body = json.loads(data[8 : 8 + length]), data[8 + length :]
        metadata = header.pop("__metadata__", {})
        tensors = {}
        for name, entry in header.items():
            first, end = entry["data_offsets"]
            tensors[name] = np.frombuffer(body[first:end], "<f4").reshape(entry["shape"])
            if entry["dtype"] != "F32" or not np.isfinite(tensors[name]).all():
                raise ValueError(f"tensor {name} is not of finite float32")
        return tensors, metadata
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"{file}: it is not a safetensors file of float32 ({error})") from error
