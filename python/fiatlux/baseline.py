"""A trained baseline as a policy, without the libraries that trained it."""

import hashlib
import json
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

FORMAT = "fiatlux-baseline/1"
"""Name and version of the contract's layout."""
TOLERANCE = 1e-3
"""Largest difference from what the network gave when it was exported."""


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
        data = Path(file).read_bytes()
        tensors, metadata = _tensors(Path(file), data)
        try:
            self.contract: dict[str, Any] = json.loads(metadata["contract"])
            layers = len(self.contract["hidden"]) + 1
            parts = [(tensors[f"layer{n}.weight"], tensors[f"layer{n}.bias"]) for n in range(layers)]
            observation, action = tensors["check.observation"], tensors["check.action"]
            given, self.sensors = self.contract["format"], list(self.contract["sensors"])
        except (KeyError, TypeError, ValueError) as error:
            raise ValueError(f"{file}: it has no contract of a baseline; export a checkpoint of ppo") from error
        if given != FORMAT:
            raise ValueError(
                f"{file}: its contract is {given}, this version reads {FORMAT}; export the checkpoint again"
            )
        self._layers = parts
        self.robot: str = self.contract["robot"]
        self.__name__ = f"ppo:{Path(file).name}@{hashlib.sha256(data).hexdigest()[:12]}"
        difference = float(np.abs(self(observation) - action).max())
        if not difference <= TOLERANCE:
            raise ValueError(f"{file}: the network differs from its export by {difference:.2g}; export it again")

    def __call__(self, observation: Any) -> NDArray[np.float32]:
        """The mean action that answers an observation, as a dictionary of fields or as one vector."""
        if isinstance(observation, dict):
            observation = np.concatenate([np.ravel(field) for field in observation.values()])
        numbers: NDArray[np.float32] = np.asarray(observation, np.float32)
        expected = self._layers[0][0].shape[1]
        if numbers.shape != (expected,):
            sensors = ", ".join(self.sensors)
            raise ValueError(f"observation: shape {numbers.shape} instead of ({expected},); its sensors are {sensors}")
        for number, (weight, bias) in enumerate(self._layers):
            numbers = weight @ numbers + bias
            if number < len(self._layers) - 1:
                numbers = np.where(numbers > 0, numbers, np.expm1(np.minimum(numbers, 0)))
        return numbers


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
