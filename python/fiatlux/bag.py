"""Recorded episodes as arrays."""

from functools import cached_property
from os import PathLike
from typing import Any, Iterator, Mapping

from . import _native


class Bag(Mapping[str, dict[str, Any]]):
    """A recorded episode: topics of columns.

    ``bag["/state"]["joint_position"]`` is an array of rows x joints. A topic is read when it is first asked for. A column's
    name is the path of a field of the topic's message; where only some messages have it, ``NAME.rows`` has their places.
    """

    def __init__(self, path: str | PathLike[str]) -> None:
        self._bag = _native.Bag(path)
        self._read: dict[str, dict[str, Any]] = {}

    @cached_property
    def header(self) -> dict[str, Any]:
        """What was set when the episode began, as nested dictionaries under the names of the message ``EpisodeHeader``."""
        return self._bag.header()

    @cached_property
    def result(self) -> dict[str, Any] | None:
        """How the episode ended, as ``EpisodeResult``; none in a bag that was cut."""
        return self._bag.result()

    @property
    def is_whole(self) -> bool:
        """Whether all of the episode is there."""
        return self._bag.is_whole

    def __getitem__(self, topic: str) -> dict[str, Any]:
        if topic not in self._read:
            self._read[topic] = self._bag.columns(topic)
        return self._read[topic]

    def __iter__(self) -> Iterator[str]:
        return iter(self._bag.topics())

    def __len__(self) -> int:
        return len(self._bag.topics())
