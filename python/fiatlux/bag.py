"""Recorded episodes as arrays."""

from collections.abc import Iterator, Mapping
from functools import cached_property
from os import PathLike
from typing import Any

import numpy as np

from . import _native


class Bag(Mapping[str, dict[str, Any]]):
    """A recorded episode: a mapping of topics, each with its columns.

    ``bag["/state"]["joint_position"]`` is an array of rows x joints. A topic is read on first use. The name of a column is the
    path of a field in the topic's message; if only some messages have the field, ``NAME.rows`` holds their indices.
    """

    def __init__(self, path: str | PathLike[str]) -> None:
        self._bag = _native.Bag(path)
        self._read: dict[str, dict[str, Any]] = {}

    @cached_property
    def header(self) -> dict[str, Any]:
        """The conditions of the episode, as nested dictionaries with the field names of the message ``EpisodeHeader``."""
        return self._bag.header()

    @cached_property
    def result(self) -> dict[str, Any] | None:
        """The end of the episode, with the field names of ``EpisodeResult``; ``None`` in a bag that was cut."""
        return self._bag.result()

    @property
    def is_whole(self) -> bool:
        """True if the bag holds the whole episode."""
        return self._bag.is_whole

    def row(self, index: int) -> dict[str, Any]:
        """A recorded row in the form of :meth:`fiatlux.Env.row`, from which :meth:`fiatlux.VectorEnv.reset_worlds` begins."""
        states = self["/state"]
        row: dict[str, Any] = {"step": int(states["step"][index])}
        for name in states:
            body, _, part = name.partition(".")
            if part == "linear_velocity":
                row[f"{body}_pose"] = np.concatenate(
                    [states[f"{body}.{part}"][index] for part in ("position", "quaternion")]
                )
            if part in ("linear_velocity", "angular_velocity"):
                row[f"{body}_{part}"] = states[name][index]
            elif part == "seated":
                row[f"{body}_seated"] = np.atleast_1d(np.float64(states[name][index]))
            elif name in ("joint_position", "joint_velocity", "joint_target", "joint_effort", "action"):
                row[name] = states[name][index]
        return row

    def __getitem__(self, topic: str) -> dict[str, Any]:
        if topic not in self._read:
            self._read[topic] = self._bag.columns(topic)
        return self._read[topic]

    def __iter__(self) -> Iterator[str]:
        return iter(self._bag.topics())

    def __len__(self) -> int:
        return len(self._bag.topics())
