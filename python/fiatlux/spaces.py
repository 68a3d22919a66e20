"""Spaces of actions and observations, and the conversion of vectors to them."""

import copy
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Literal, get_args

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from ._numbers import real

ObservationForm = Literal["dict", "flat", "published"]
"""``"dict"``: the observation's fields by name; pictures are ``uint8``. ``"flat"``: all of them in one ``float32`` vector. ``"published"``: the vector of the
published benchmark, 6,543 numbers (6,453 in ``climb``), with the features of the camera's image."""

_UNBOUNDED = 1e9
"""Bound of unbounded numbers: no row has larger ones, and checkers warn about infinite bounds."""


JOINT_GROUPS = ("left_leg", "right_leg", "waist", "left_arm", "right_arm", "left_hand", "right_hand")
"""Groups of a robot's joints."""

_LIMBS = {"hip": "leg", "knee": "leg", "ankle": "leg", "shoulder": "arm", "elbow": "arm", "wrist": "arm"}


def joint_groups(names: Sequence[str]) -> dict[str, NDArray[np.int64]]:
    """Where the joints of each group are in a list of joints, such as the numbers of an action; groups without joints are left out."""
    found: dict[str, list[int]] = {group: [] for group in JOINT_GROUPS}
    for index, name in enumerate(names):
        side, _, rest = name.partition("_")
        # Joints of some hands.
        side = {"L": "left", "R": "right"}.get(side, side)
        group = "waist" if side == "waist" else f"{side}_{_LIMBS.get(rest.partition('_')[0], 'hand')}"
        if group in found:
            found[group].append(index)
    return {group: np.array(indices, np.int64) for group, indices in found.items() if indices}


_WORD = 4
"""Bytes of a picture in a number of the simulator's arrays."""


class Layout:
    """The places of an observation's fields in the simulator's arrays of ``float32``, where pictures are bytes, four to a number; and in
    the flat vector, where each byte is a number."""

    def __init__(self, spec: Mapping[str, Any], form: ObservationForm) -> None:
        if form not in get_args(ObservationForm):
            raise ValueError(
                f"observation is {form!r}; known ones are {', '.join(map(repr, get_args(ObservationForm)))}"
            )
        self.form = form
        self.fields: dict[str, tuple[slice, tuple[int, ...]]] = {}
        # Words of each field in the simulator's arrays.
        self._words: dict[str, slice] = {}
        self._pictures: set[str] = set()
        bounds: list[tuple[float, float]] = []
        boxes: dict[str, spaces.Space[Any]] = {}
        start = word = 0
        for name, shape, low, high, is_picture in spec["observation"]:
            length = int(np.prod(shape, dtype=np.int64))
            # A single number becomes a field of length 1, since some libraries cannot handle scalars.
            shape = tuple(shape) or (1,)
            low, high = max(low, -_UNBOUNDED), min(high, _UNBOUNDED)
            self.fields[name] = (slice(start, start + length), shape)
            boxes[name] = spaces.Box(low, high, shape, np.uint8 if is_picture else np.float32)
            bounds.append((low, high))
            start += length
            if is_picture:
                self._pictures.add(name)
            self._words[name] = slice(word, word + (-(-length // _WORD) if is_picture else length))
            word = self._words[name].stop
        self.length = start
        self.words = word
        lengths = [field.stop - field.start for field, _ in self.fields.values()]
        lows, highs = (np.repeat([bound[side] for bound in bounds], lengths).astype(np.float32) for side in (0, 1))
        self.space: spaces.Space[Any] = (
            spaces.Dict(boxes) if form == "dict" else spaces.Box(lows, highs, dtype=np.float32)
        )
        self.action_names: list[str] = spec["actions"]
        low, high = np.asarray(spec["action_range"], np.float32).T
        self.action_space = spaces.Box(low, high, dtype=np.float32)
        self.reward_terms: list[str] = spec["rewards"]

    @property
    def has_pictures(self) -> bool:
        """True if a field is a picture."""
        return bool(self._pictures)

    def show(self, words: NDArray[np.float32], copy: bool) -> Any:
        """Converts the simulator's arrays, with any number of leading axes, to the layout's form. ``copy`` is of numbers; pictures of a
        dictionary are views, so that an array which is written again must not be shown to those who keep pictures."""
        before = words.shape[:-1]
        if self.form == "dict":
            fields = self.fields.items()
            parts = {name: self._part(words, name).reshape(before + shape) for name, (_, shape) in fields}
            return {name: part.copy() if copy and name not in self._pictures else part for name, part in parts.items()}
        if not self._pictures:
            return words.copy() if copy else words
        flat = np.empty((*before, self.length), np.float32)
        for name, (field, _) in self.fields.items():
            flat[..., field] = self._part(words, name)
        return flat

    def _part(self, words: NDArray[np.float32], name: str) -> NDArray[Any]:
        """A field's numbers, or the bytes of its picture."""
        part = words[..., self._words[name]]
        if name not in self._pictures:
            return part
        field, _ = self.fields[name]
        return part.view(np.uint8)[..., : field.stop - field.start]


_BOUNDS = ("low", "high", "bounded_below", "bounded_above")


class _Boxes(spaces.Box[Any]):
    """As many boxes as there are worlds. Its bounds are views of one box's, in its copies too: those of a thousand worlds' pictures would
    take four times the memory of the pictures."""

    def __init__(self, one: spaces.Box[Any], count: int) -> None:
        self.__setstate__(vars(copy.deepcopy(one)) | {"_shape": (count, *one.shape)})

    def __getstate__(self) -> dict[str, Any]:
        return vars(self) | {bound: getattr(self, bound)[0] for bound in _BOUNDS}

    def __setstate__(self, state: Iterable[tuple[str, Any]] | Mapping[str, Any]) -> None:
        fields = dict(state)
        super().__setstate__(fields | {bound: np.broadcast_to(fields[bound], fields["_shape"]) for bound in _BOUNDS})


def batched(space: spaces.Space[Any], count: int) -> spaces.Space[Any]:
    """Gymnasium's ``batch_space`` of boxes, and of dictionaries of them."""
    if isinstance(space, spaces.Dict):
        return spaces.Dict({name: batched(part, count) for name, part in space.items()})
    assert isinstance(space, spaces.Box)
    return _Boxes(space, count)


def as_actions(actions: Any, shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Actions in the form that the simulator takes, for one world or many; refuses a wrong shape."""
    try:
        array: NDArray[Any] = np.ascontiguousarray(real(actions))
    except (TypeError, ValueError) as error:
        raise ValueError(f"action: cannot be read as numbers ({error}); give an array of shape {shape}") from error
    if array.shape != shape:
        raise ValueError(f"action: shape {array.shape} instead of {shape}")
    return array
