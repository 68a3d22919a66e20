"""A digest of what makes a policy play as it does: its code and its weights."""

import dis
import functools
import hashlib
import inspect
from collections.abc import Iterable, Iterator
from types import CodeType, FunctionType, MethodType, ModuleType
from typing import Any

import numpy as np

Named = Iterable[tuple[str, Any]]


def digest_of(policy: Any) -> str:
    """16 hexadecimal digits of a SHA-256 over a policy's code and weights, or its own attribute ``digest``.

    Code is the byte code of the policy's class or function, and of what these name in their own module. Weights are arrays,
    numbers and texts among attributes, closures, defaults and named globals, in lists and dictionaries arrays alone, and whatever
    has a ``state_dict``. What a method other than ``__init__``, or a function, assigns is state and does not count.
    """
    own = getattr(policy, "digest", None)
    if isinstance(own, str):
        return own
    function = policy.func if isinstance(policy, functools.partial) else policy
    home = function.__module__ if hasattr(function, "__qualname__") else type(function).__module__
    digest = hashlib.sha256()
    for part in _Walk(home).value(policy):
        digest.update(len(part).to_bytes(8, "little") + part)
    return digest.hexdigest()[:16]


class _Walk:
    """A walk over the code and the weights of one module."""

    def __init__(self, home: str) -> None:
        self._home = home
        self._seen: set[int] = set()

    def value(self, value: Any) -> Iterator[bytes]:
        if value is None or isinstance(value, (bool, int, float, complex, str, bytes, np.generic)):
            yield repr(value).encode()
        elif id(value) not in self._seen:
            self._seen.add(id(value))
            yield from self._object(value)

    def _object(self, value: Any) -> Iterator[bytes]:
        if isinstance(value, np.ndarray):
            yield f"{value.dtype.str}{value.shape}".encode() + (b"" if value.dtype.hasobject else value.tobytes())
        elif isinstance(value, CodeType):
            yield value.co_code + repr(value.co_names).encode()
            yield from self.value(value.co_consts)
        elif isinstance(value, FunctionType):
            yield from self._function(value)
        elif isinstance(value, MethodType):
            yield from self.value((value.__func__, value.__self__))
        elif isinstance(value, functools.partial):
            yield from self.value((value.func, value.args, *sorted(value.keywords.items())))
        elif isinstance(value, type):
            for kind in value.__mro__:
                if kind.__module__ == self._home:
                    yield from self._named(_members(kind))
        elif isinstance(value, tuple):
            for part in value:
                yield from self.value(part)
        elif isinstance(value, frozenset):
            yield repr(sorted(map(repr, value))).encode()
        elif isinstance(value, (list, dict)):
            # Further entries of a list or a dictionary may be a log, which grows.
            parts = value.items() if isinstance(value, dict) else enumerate(value)
            for name, part in parts:
                inner = list(self.value(part)) if _is_weight(part) else []
                yield from (str(name).encode(), *inner) if inner else ()
        elif _has_weights(value):
            yield from self._named((str(name), _array(part)) for name, part in value.state_dict().items())
            yield from self.value(type(value))
        elif type(value).__module__ == self._home:
            yield from self.value(type(value))
            state = _assigned(type(value))
            yield from self._named((name, part) for name, part in vars(value).items() if name not in state)
        elif not isinstance(value, ModuleType):
            # An object of a library, such as a trainer's model.
            yield from self._named(
                (name, part) for name, part in getattr(value, "__dict__", {}).items() if _has_weights(part)
            )

    def _function(self, function: FunctionType) -> Iterator[bytes]:
        if function.__module__ != self._home:
            return
        code = function.__code__
        yield from self.value((code, function.__defaults__, *(function.__kwdefaults__ or {}).items()))
        used = inspect.getclosurevars(function)
        state = _stored(code, "STORE_GLOBAL", "STORE_DEREF")
        yield from self._named(
            (name, part) for name, part in {**used.globals, **used.nonlocals}.items() if name not in state
        )

    def _named(self, items: Named) -> Iterator[bytes]:
        for name, part in items:
            yield name.encode()
            yield from self.value(part)


def _has_weights(value: Any) -> bool:
    return not isinstance(value, type) and callable(getattr(value, "state_dict", None))


def _is_weight(value: Any) -> bool:
    return _has_weights(value) or isinstance(value, (np.ndarray, list, dict))


def _array(value: Any) -> Any:
    """A tensor as an array of its bytes; anything else as it is."""
    if not hasattr(value, "detach"):
        return value
    import torch

    return value.detach().cpu().contiguous().reshape(-1).view(torch.uint8).numpy()


def _members(kind: type) -> Named:
    """Functions and values of a class."""
    for name, part in vars(kind).items():
        part = getattr(part, "__func__", getattr(part, "fget", part))
        if isinstance(part, FunctionType) or not name.startswith("__"):
            yield name, part


def _assigned(kind: type) -> set[str]:
    """Attributes that methods other than ``__init__`` assign."""
    members = (item for parent in kind.__mro__ for item in _members(parent))
    methods = (part for name, part in members if isinstance(part, FunctionType) and name != "__init__")
    return {name for method in methods for name in _stored(method.__code__, "STORE_ATTR")}


def _stored(code: CodeType, *operations: str) -> set[str]:
    """Names that byte code assigns by these operations."""
    found = {step.argval for step in dis.get_instructions(code) if step.opname in operations}
    return found.union(*(_stored(part, *operations) for part in code.co_consts if isinstance(part, CodeType)))
