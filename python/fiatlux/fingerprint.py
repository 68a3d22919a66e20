"""A digest of what makes a policy play as it does: its code and its weights."""

import dataclasses
import datetime
import decimal
import enum
import fractions
import functools
import gc
import hashlib
import inspect
import random
import re
import uuid
import weakref
from collections import defaultdict, deque
from collections.abc import Iterable, Iterator, Mapping
from contextvars import ContextVar
from pathlib import PurePath
from types import (
    BuiltinFunctionType,
    CellType,
    FunctionType,
    MemberDescriptorType,
    MethodType,
    ModuleType,
    SimpleNamespace,
)
from typing import Any

import numpy as np

from ._code import Uses, code_bytes, imported, in_library, is_users, node_of, tree_bytes, unwrapped

_SETUP = frozenset(
    "__init__ __new__ __post_init__ __init_subclass__ __class_getitem__ __setstate__ __set_name__".split()
)
"""Methods that make an object: what they assign is no state."""

_OF_CLASSES = frozenset("__init_subclass__ __set_name__".split())
"""Those that run as a class is made, and not while a policy plays."""

_BY_NAME = frozenset("getattr attrgetter methodcaller __dict__ globals vars locals eval exec".split())
"""With these a function finds methods and globals by names that stand nowhere in its code."""

_BY_TEXT: tuple[type, ...] = (
    *(PurePath, range, slice, np.dtype, fractions.Fraction, decimal.Decimal, uuid.UUID),
    *(datetime.date, datetime.time, datetime.timedelta, datetime.tzinfo),
)
"""Values of the standard library that their text says whole."""

_WEAK = (weakref.ReferenceType, weakref.ProxyType, weakref.CallableProxyType)

_GENERATED = frozenset(
    "__init__ __repr__ __eq__ __hash__ __lt__ __le__ __gt__ __ge__ __new__ __replace__ __match_args__".split()
)
"""Methods that ``dataclass`` and ``NamedTuple`` write from the fields."""


def digest_of(policy: Any) -> str:
    """16 hexadecimal digits of a SHA-256 over a policy's code and weights, or its own attribute ``digest``.

    Code is that of the policy and of every function and class of the user's that it reaches: by name, in closures, defaults and
    attributes, in other modules of the user's. It counts as it is written, without comments, blanks and line breaks, so that the digest is the
    same in every process and version of Python; where the source is not there (``exec``, ``python -c``) or is no longer what runs, byte
    code counts in its place, and the digest holds for one version of Python. Libraries count by the names of what is used.

    Weights are all values in attributes, closures, defaults and named globals, and whatever has a ``state_dict``. What code that runs
    while the policy plays assigns or changes in place is state and does not count, but what ``__init__`` alone does. An object of a library that keeps its
    contents out of Python's sight counts by its type: give such a policy an attribute ``digest``.
    """
    # An own one: a policy that answers every name, or hands names on to another, has none by that.
    own: Any = getattr(policy, "digest", None) if _has(policy, "digest") else None
    if _is(own, str):
        return own
    function = policy
    while _is(function, functools.partial):
        function = function.func
    if _is(function, MethodType):
        function = function.__self__ if not _is(function.__self__, type) else function.__func__
    has_own = _is(function, (type, FunctionType, BuiltinFunctionType))
    home = (function if has_own else type(function)).__module__ or ""
    reach = _Reach(home)
    reach.follow(policy)
    return _Walk(reach).digest(policy).hex()[:16]


class _Reach:
    """The user's functions that run while a policy plays, and what they change."""

    def __init__(self, home: str) -> None:
        self.home = home
        self.uses: dict[int, Uses] = {}
        self._functions: list[FunctionType] = []
        self._classes: list[type] = []
        self._seen: dict[int, Any] = {}
        self._mentioned: set[str] = set()
        self._stored: set[str] = set()
        self._constructed: set[int] = set()
        self._by_name = False

    def follow(self, policy: Any) -> None:
        """Collects everything; methods count whose names are mentioned somewhere."""
        if _is(policy, type):
            self._constructed.add(id(policy))
        self._visit(policy)
        found = -1
        while found != len(self.uses):
            found = len(self.uses)
            for kind in list(self._classes):
                for name, function in methods(kind):
                    is_setup = name in _SETUP
                    is_special = name.startswith("__") or name == "reset" or name in self._mentioned or self._by_name
                    if name.endswith("="):
                        is_special = name[:-1] in self._stored
                    if is_special and (not is_setup or id(kind) in self._constructed):
                        self._function(function)
        playing = (uses for at, uses in self.uses.items() if self._seen[at].__name__ not in _OF_CLASSES)
        self.state_of_others = set().union(*(uses.others for uses in playing))

    def state_of(self, kind: type) -> set[str]:
        """Attributes of a class's objects that change while it plays."""
        names = set(self.state_of_others)
        for parent in kind.__mro__:
            for name, function in methods(parent):
                if name not in _SETUP and id(function) in self.uses:
                    names |= self.uses[id(function)].own
        return names

    def changed_in(self, namespace: Mapping[str, Any]) -> set[str]:
        """Globals of a module that change while the policy plays."""
        of_module = (self.uses[id(function)] for function in self._functions if function.__globals__ is namespace)
        return set().union(*(uses.changed for uses in of_module))

    def changed_cell(self, cell: CellType) -> bool:
        """True if some function changes the variable of a closure."""
        for function in self._functions:
            names = function.__code__.co_freevars
            for name, own in zip(names, function.__closure__ or ()):
                if own is cell and name in self.uses[id(function)].changed:
                    return True
        return False

    def is_users(self, value: Any) -> bool:
        return is_users(getattr(value, "__module__", None), self.home)

    def holds_users(self, value: Any, depth: int = 2) -> bool:
        """True for an object of a class of the user's, and for a list, tuple or mapping with one, or with a function."""
        if self.is_users(type(value)):
            return True
        parts = list(value.values()) if _is(value, Mapping) else list(value) if _is(value, (list, tuple)) else []
        functions = (FunctionType, MethodType, functools.partial)
        return depth > 0 and any(_is(part, functions) or self.holds_users(part, depth - 1) for part in parts)

    def is_users_code(self, function: FunctionType) -> bool:
        """By the file: a library's wrapper has the module of what it wraps."""
        return self.is_users(function) and (
            not in_library(function.__code__.co_filename)
            or function.__globals__.get("__name__", "").partition(".")[0] == self.home.partition(".")[0]
        )

    def globals_of(self, function: FunctionType) -> Iterator[tuple[str, Any]]:
        """Globals that a function mentions, by name, and of modules of the user's what it mentions of them."""
        uses = self.uses[id(function)]
        for name in sorted(uses.names):
            if name not in function.__globals__ or name in function.__code__.co_freevars:
                continue
            value = function.__globals__[name]
            yield name, value
            yield from self._of_module(name, value, uses.attributes)
        if uses.names & _BY_NAME - {"getattr"}:
            for name, value in sorted(function.__globals__.items()):
                if not name.startswith("__") and not _is(value, ModuleType):
                    yield f"by name {name}", value
        for module, name in sorted(uses.imports):
            value = imported(module, name, function.__globals__.get("__package__"), self.home)
            yield f"import {module} {name}", value
            yield from self._of_module(module, value, uses.attributes)

    def _of_module(self, name: str, value: Any, attributes: set[str]) -> Iterator[tuple[str, Any]]:
        if _is(value, ModuleType) and is_users(value.__name__, self.home):
            for attribute in sorted(attributes):
                if attribute in vars(value):
                    inner = vars(value)[attribute]
                    yield f"{name}.{attribute}", inner
                    if _is(inner, ModuleType) and inner.__name__.startswith(f"{value.__name__}."):
                        yield from self._of_module(f"{name}.{attribute}", inner, attributes)

    def _function(self, function: FunctionType) -> None:
        if id(function) in self.uses:
            return
        self._seen[id(function)] = function
        if self.is_users_code(function):
            uses = self.uses[id(function)] = Uses(function, node_of(function))
            self._functions.append(function)
            self._mentioned |= uses.attributes | uses.names
            self._stored |= uses.own | uses.others
            self._by_name |= bool((uses.names | uses.attributes) & _BY_NAME)
            for _, value in self.globals_of(function):
                if _is(value, type):
                    self._constructed.add(id(value))
                self._visit(value)
        for value in parts_of_function(function):
            self._visit(value)

    def _visit(self, value: Any) -> None:
        if _is(value, (str, bytes, int, float, complex, np.generic, np.ndarray, type(None), ModuleType)):
            return
        if id(value) in self._seen:
            return
        if _is(value, FunctionType):
            self._function(value)
            return
        self._seen[id(value)] = value
        if _is(value, type):
            for kind in value.__mro__:
                if self.is_users(kind) and all(kind is not known for known in self._classes):
                    self._classes.append(kind)
                    for _, part in members(kind):
                        # Methods are followed where they are called.
                        is_method = _is(part, (FunctionType, property, functools.cached_property))
                        if not is_method and unwrapped(part) is None:
                            self._visit(part)
            # What makes a class may also make its objects.
            if self.is_users(type(value)):
                self._constructed.add(id(type(value)))
                self._visit(type(value))
            return
        if _is(value, MethodType):
            self._mentioned.add(value.__func__.__name__)
        for part in _inner(value):
            self._visit(part)
        if self.is_users(type(value)):
            self._visit(type(value))


def _inner(value: Any) -> Iterator[Any]:
    """Parts of an object that may be functions or objects of the user's."""
    if _is(value, MethodType):
        yield from (value.__func__, value.__self__)
    elif _is(value, functools.partial):
        yield from (value.func, *value.args, *value.keywords.values())
    elif _is(value, Mapping):
        yield from list(value.values())
        yield getattr(value, "default_factory", None)
    elif _is(value, (list, tuple, set, frozenset, deque)):
        yield from list(value)
    elif _is(value, _WEAK):
        yield referent(value)
    wrapped = unwrapped(value)
    if wrapped is not None:
        yield wrapped
    yield from held(value)
    yield from attributes(value).values()


def referent(value: Any) -> Any:
    """The object that a weak reference or a proxy stands for; none if it is gone."""
    try:
        return value() if _is(value, weakref.ReferenceType) else value.__init__.__self__
    except ReferenceError:
        return None


def held(value: Any) -> list[Any]:
    """Functions that an object of a library in C keeps out of Python's sight: ``np.frompyfunc``, ``map``, ``functools.cmp_to_key``."""
    kind = type(value)
    is_in_python = any("__slots__" in vars(parent) or "__weakref__" in vars(parent) for parent in kind.__mro__)
    if is_in_python or _is(value, (FunctionType, MethodType, functools.partial, type, ModuleType)):
        return []
    functions = (FunctionType, MethodType, functools.partial)
    parts = [inner for part in gc.get_referents(value) for inner in (part if _is(part, tuple) else (part,))]
    return [part for part in parts if _is(part, functions)]


def parts_of_function(function: FunctionType) -> Iterator[Any]:
    """Values that a function keeps: defaults and closure."""
    yield from function.__defaults__ or ()
    yield from (function.__kwdefaults__ or {}).values()
    for cell in function.__closure__ or ():
        try:
            yield cell.cell_contents
        except ValueError:
            continue
    if hasattr(function, "__wrapped__"):
        yield function.__wrapped__


def attributes(value: Any) -> dict[str, Any]:
    """Attributes of an object, those in slots too, in the order of their names: what it keeps, not what ``__getattr__`` answers."""
    found: dict[str, Any] = {}
    if not _is(value, type):
        try:
            found = dict(object.__getattribute__(value, "__dict__"))
        except (AttributeError, TypeError, ValueError):
            pass
    for kind in type(value).__mro__:
        if "__slots__" not in vars(kind):
            continue
        for name, slot in vars(kind).items():
            if _is(slot, MemberDescriptorType):
                try:
                    found[name] = slot.__get__(value)
                except AttributeError:
                    continue
    return {name: found[name] for name in sorted(found, key=str)}


def members(kind: type) -> Iterator[tuple[str, Any]]:
    """Functions and values of a class, without what Python adds."""
    is_generated = "__dataclass_fields__" in vars(kind) or (issubclass(kind, tuple) and hasattr(kind, "_fields"))
    for name, part in sorted(vars(kind).items()):
        part = getattr(part, "__func__", part) if _is(part, (staticmethod, classmethod)) else part
        if _is(part, FunctionType):
            file = part.__code__.co_filename
            if is_generated and (in_library(file) or (file.startswith("<") and name in _GENERATED)):
                continue
            yield name, part
        elif not name.startswith("__") and not name.startswith("_abc_") and name not in ("_field_defaults", "_fields"):
            if type(part).__name__ not in ("member_descriptor", "getset_descriptor", "_tuplegetter"):
                yield name, part


def methods(kind: type) -> Iterator[tuple[str, FunctionType]]:
    """Functions of a class, those in properties and decorators too; with ``=`` after the name those that a property's assignment calls."""
    for name, part in members(kind):
        inner: tuple[Any, ...] = (part, unwrapped(part))
        if _is(part, property):
            inner = (part.fget,)
            for function in (part.fset, part.fdel):
                if _is(function, FunctionType):
                    yield f"{name}=", function
        elif _is(part, functools.cached_property):
            inner = (part.func,)
        for function in inner:
            if _is(function, FunctionType):
                yield name, function


class _Walk:
    """A walk over the code and the weights that a policy reaches."""

    def __init__(self, reach: _Reach) -> None:
        self._reach = reach
        # Objects of the walk, kept so that no later one has the same id, and their digests; none while one is at work in it.
        self._known: dict[int, tuple[Any, bytes | None]] = {}

    def digest(self, value: Any) -> bytes:
        """The digest of a value. What is reached again from within itself counts by its type."""
        if _is(value, (bool, int, float, complex, str, bytes, type(None))):
            return _hashed([type(value).__name__.encode(), _plain(value)])
        known = self._known.get(id(value))
        if known is not None:
            return known[1] or _hashed([b"again", _name(value if _is(value, type) else type(value))])
        self._known[id(value)] = value, None
        found = _hashed(self._object(value))
        self._known[id(value)] = value, found
        return found

    def _object(self, value: Any) -> Iterator[bytes]:
        kind = type(value)
        yield _name(kind)
        if _is(value, (np.ndarray, np.generic)) or _is_tensor(value):
            yield from self._numbers(value)
        elif _is(value, FunctionType):
            yield from self._function(value)
        elif _is(value, MethodType):
            yield from map(self.digest, (value.__func__, value.__self__))
        elif _is(value, functools.partial):
            yield from map(self.digest, (value.func, value.args, *self._sorted(value.keywords)))
        elif _is(value, type):
            yield from self._class(value)
        elif _is(value, ModuleType):
            yield value.__name__.encode()
        elif _is(value, enum.Enum):
            yield value.name.encode()
            yield from map(self.digest, (value.value, kind))
        elif _is(value, (property, functools.cached_property)):
            names = ("fget", "fset", "fdel", "func")
            yield from (self.digest(getattr(value, name, None)) for name in names)
        elif _is(value, re.Pattern):
            yield from map(self.digest, (value.pattern, value.flags))
        elif _is(value, _BY_TEXT):
            yield str(value).encode()
        elif _is(value, ContextVar):
            yield value.name.encode()
            try:
                yield self.digest(value.get())
            except LookupError:
                pass
        elif _is(value, (np.random.Generator, np.random.RandomState, random.Random)):
            return
        elif _is(value, Mapping):
            for name, part in list(value.items()):
                yield from (self.digest(name), self.digest(part))
            if _is(value, defaultdict):
                yield self.digest(value.default_factory)
            yield from self._instance(value)
        elif _is(value, (list, tuple, deque)):
            yield from map(self.digest, list(value))
            if _is(value, deque) and value.maxlen is not None:
                yield self.digest(value.maxlen)
            yield from self._instance(value)
        elif _is(value, (set, frozenset)):
            yield from sorted(map(self.digest, value))
        elif _is(value, _WEAK):
            yield self.digest(referent(value))
        else:
            wrapped = unwrapped(value)
            if wrapped is not None:
                yield self.digest(wrapped)
            else:
                # Python's versions keep them in other orders.
                yield from sorted(map(self.digest, held(value)))
            yield from self._instance(value)

    def _instance(self, value: Any) -> Iterator[bytes]:
        """Attributes of an object: all of the user's classes, of others texts and weights."""
        own = attributes(value)
        if _has_weights(value):
            yield from self._network(value)
        if self._reach.is_users(type(value)) or _is(value, SimpleNamespace):
            yield self.digest(type(value))
            state = self._reach.state_of(type(value))
            # A module of PyTorch keeps its own under names that begin with a line; its weights were counted.
            is_network = "_modules" in own
            yield from self._named(
                {
                    name: part
                    for name, part in own.items()
                    if name not in state and not (is_network and name.startswith("_"))
                }
            )
        else:
            yield _package(value)
            plain = (str, bytes, PurePath, np.ndarray, FunctionType, MethodType)
            kept = {
                name: part
                for name, part in own.items()
                if _is(part, plain) or _has_weights(part) or _is_tensor(part) or self._reach.holds_users(part)
            }
            yield from self._named(kept)

    def _network(self, value: Any) -> Iterator[bytes]:
        """Weights, and the layers that have none."""
        yield from self._named({str(name): part for name, part in value.state_dict().items()})
        for name, module in value.named_modules() if _has_method(value, "named_modules") else ():
            own = {
                key: part for key, part in attributes(module).items() if not key.startswith("_") and key != "training"
            }
            state = self._reach.state_of(type(module))
            plain = {
                key: part for key, part in own.items() if key not in state and _is(part, (bool, int, float, str, tuple))
            }
            yield from (name.encode(), _name(type(module)))
            yield from self._named(plain)
            if module is not value and self._reach.is_users(type(module)):
                yield self.digest(type(module))

    def _numbers(self, value: Any) -> Iterator[bytes]:
        if not _is(value, (np.ndarray, np.generic)):
            yield str(value.dtype).encode() + str(tuple(value.shape)).encode()
            yield _bytes_of(value)
            return
        yield f"{value.dtype.descr if value.dtype.names else value.dtype.str}{value.shape}".encode()
        if value.dtype.hasobject:
            yield from map(self.digest, np.asarray(value).ravel().tolist())
        else:
            yield value.tobytes()

    def _class(self, kind: type) -> Iterator[bytes]:
        if not self._reach.is_users(kind):
            yield _name(kind)
            return
        yield kind.__qualname__.encode()
        for parent in kind.__mro__:
            yield _name(parent)
            if not self._reach.is_users(parent):
                continue
            state = self._reach.state_of(parent)
            # A property, method or other descriptor is code, also where its name is assigned.
            kept = {name: part for name, part in members(parent) if name not in state or hasattr(type(part), "__get__")}
            yield from self._named(kept)
            for field in vars(parent).get("__dataclass_fields__", {}).values():
                # Types count as they are written: what else they are is different from version to version.
                made = field.default_factory
                yield f"{field.name} {field.init} {field.kw_only}".encode()
                yield from (self.digest(_or_none(field.default)), self.digest(_or_none(made)))
            if issubclass(parent, tuple) and "_fields" in vars(parent):
                defaults = getattr(parent, "_field_defaults", {})
                yield from (self.digest(tuple(vars(parent)["_fields"])), self.digest(dict(defaults)))
        if self._reach.is_users(type(kind)):
            yield self.digest(type(kind))

    def _function(self, function: FunctionType) -> Iterator[bytes]:
        reach = self._reach
        if id(function) in reach.uses or reach.is_users_code(function):
            node = node_of(function)
            if node is None:
                yield from code_bytes(function.__code__)
            else:
                yield tree_bytes(node)
            yield from map(self.digest, function.__defaults__ or ())
            yield from self._named(function.__kwdefaults__ or {})
            if id(function) in reach.uses:
                changed = reach.changed_in(function.__globals__)
                used = reach.globals_of(function)
                yield from self._named(
                    {name: part for name, part in used if name.removeprefix("by name ") not in changed}
                )
        else:
            yield _package(function)
        for name, cell in zip(function.__code__.co_freevars, function.__closure__ or ()):
            if not reach.changed_cell(cell):
                try:
                    yield from self._named({name: cell.cell_contents})
                except ValueError:
                    yield name.encode()
        if hasattr(function, "__wrapped__"):
            yield self.digest(function.__wrapped__)

    def _named(self, items: Mapping[str, Any]) -> Iterator[bytes]:
        for name in sorted(items, key=str):
            yield from (str(name).encode(), self.digest(items[name]))

    def _sorted(self, items: Mapping[str, Any]) -> Iterable[Any]:
        return sorted(items.items())


def _hashed(parts: Iterable[bytes]) -> bytes:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(len(part).to_bytes(8, "little") + part)
    return digest.digest()


def _plain(value: Any) -> bytes:
    if _is(value, str):
        return value.encode("utf-8", "surrogatepass")
    return value if _is(value, bytes) else repr(value).encode()


def _name(kind: type) -> bytes:
    """A type's package and name; libraries move theirs between modules from version to version."""
    return f"{kind.__module__.partition('.')[0]}.{kind.__qualname__}".encode()


def _package(value: Any) -> bytes:
    """The same of a function of a library; nothing for an object without a name."""
    name = _first(value, "__qualname__", "__name__")
    module = _first(value, "__module__")
    package = module.partition(".")[0] if isinstance(module, str) else ""
    return f"{package}.{name}".encode() if isinstance(name, str) else b""


def _first(value: Any, *names: str) -> Any:
    """The first of the attributes that an object or its class has."""
    return next((getattr(value, name) for name in names if _has(value, name)), None)


def _or_none(value: Any) -> Any:
    return None if value is dataclasses.MISSING else value


def _is_tensor(value: Any) -> bool:
    """True for the arrays of PyTorch, JAX and TensorFlow: by their types, since a policy may answer to any name."""
    names = ("dtype", "shape", "__array__")
    return not _is(value, type) and all(_of_type(type(value), name) is not None for name in names)


def _has_weights(value: Any) -> bool:
    return _has_method(value, "state_dict")


def _is(value: Any, kinds: type | tuple[type, ...]) -> bool:
    """``isinstance`` by the type that an object has, not by a ``__class__`` that it claims, as proxies and doubles do."""
    return issubclass(type(value), kinds)


def _of_type(kind: type, name: str) -> Any:
    """The part of a class, or of one that it is made from, by its name; none for a name that ``__getattr__`` would answer."""
    return next((vars(parent)[name] for parent in kind.__mro__ if name in vars(parent)), None)


def _has_method(value: Any, name: str) -> bool:
    return not _is(value, type) and callable(_of_type(type(value), name))


def _has(value: Any, name: str) -> bool:
    """True for an attribute of an object's own or of its class."""
    return inspect.getattr_static(value, name, None) is not None


def _bytes_of(tensor: Any) -> bytes:
    """The bytes of a tensor, of PyTorch also where NumPy has no such type."""
    if not _has_method(tensor, "detach"):
        return np.asarray(tensor).tobytes()
    import torch

    flat = tensor.detach().cpu().contiguous().reshape(-1)
    return flat.view(torch.uint8).numpy().tobytes()
