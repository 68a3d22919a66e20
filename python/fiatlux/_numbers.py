"""Whole numbers and sizes as users give them: one rule for all of them."""

import itertools
import operator
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import _native

MAX_SEED = 2**64 - 1
"""Largest seed, and largest index of an episode."""

MAX_SIDE = 4096
"""Most pixels along a side of a picture."""


def real(value: Any) -> NDArray[np.float64]:
    """An array of real numbers. Raises ValueError for what NumPy would make numbers of: text, dates, ``None``, complex numbers, and
    the numbers under a mask."""
    if np.ma.is_masked(value):
        raise ValueError("a masked array has no number where it is masked; give array.filled(NUMBER)")
    array: NDArray[Any] = np.asarray(value)
    if array.dtype.kind == "O":
        strange = next((item for item in array.flat if item is None or isinstance(item, (str, complex))), array)
        if strange is not array:
            raise ValueError(f"{strange!r} is not a real number")
    elif array.dtype.kind not in "biuf":
        raise ValueError(f"numbers of the type {array.dtype} are not real")
    return np.asarray(array, np.float64)


def whole(name: str, value: Any, least: int, most: int) -> int:
    """A whole number from ``least`` to ``most``: an ``int`` or one of NumPy's integers, but no ``bool``."""
    try:
        number = None if isinstance(value, (bool, np.bool_)) else operator.index(value)
    except TypeError:
        number = None
    if number is None:
        raise ValueError(f"{name} is {value!r}; give a whole number")
    if not least <= number <= most:
        raise ValueError(f"{name} is {number}; give {least} to {most}")
    return number


def seed_of(value: Any, name: str = "seed") -> int:
    """A seed, or an index of an episode."""
    return whole(name, value, 0, MAX_SEED)


def seeds_of(values: Iterable[Any], worlds: int | None = None, record: Path | None = None) -> list[int]:
    """The benchmark's seeds of rooms; where ``worlds`` are spread over them, not more than those.

    A text is read as the programs read it: ``"fresh:64"`` draws as many rooms that nobody has seen, and keeps them in the file
    ``record``, or reads them from there.
    """
    if isinstance(values, str) and worlds is None:
        return _native.parse_seeds(values, record)
    if isinstance(values, str):
        raise ValueError(f"seeds is {values!r}; give a list of whole numbers, such as range(1000, 1016)")
    try:
        seeds = [seed_of(value, "seeds") for value in itertools.islice(values, None if worlds is None else worlds + 1)]
    except TypeError as error:
        raise ValueError(f"seeds is {values!r}; give a list of whole numbers") from error
    if worlds is not None and len(seeds) > worlds:
        raise ValueError(
            f"seeds names more rooms than num_envs, which is {worlds}; give at least one world for each room"
        )
    return seeds


def size_of(name: str, value: Any) -> list[int]:
    """Width and height of a picture, pixels."""
    try:
        width, height = value
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name} is {value!r}; give width and height, pixels") from error
    return [whole(name, side, 1, MAX_SIDE) for side in (width, height)]
