"""The code of functions as the user wrote it: syntax trees in a form that no version of Python changes."""

import ast
import dis
import functools
import importlib.util
import inspect
import linecache
import site
import sys
import sysconfig
from collections.abc import Iterator
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

Node = ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda
_NODES = (ast.FunctionDef, ast.AsyncFunctionDef, ast.Lambda)

CHANGES = frozenset(
    "add append appendleft clear discard extend extendleft fill insert pop popitem popleft put remove resize reverse rotate "
    "setdefault sort update add_ copy_ fill_ mul_ zero_".split()
)
"""Methods that change their object."""


def names_of(code: CodeType) -> set[str]:
    """Names that byte code mentions, with the code inside it."""
    return set(code.co_names).union(*(names_of(part) for part in code.co_consts if isinstance(part, CodeType)))


@functools.lru_cache(maxsize=1)
def _libraries() -> tuple[Path, ...]:
    paths = sysconfig.get_paths()
    places = {paths[name] for name in ("stdlib", "platstdlib", "purelib", "platlib")}
    places |= {*getattr(site, "getsitepackages", list)(), getattr(site, "getusersitepackages", str)()}
    own = Path(__file__).resolve().parent
    return (own, *(Path(place).resolve() for place in places if place))


@functools.lru_cache(maxsize=4096)
def in_library(file: str | None) -> bool:
    """True for a file of Python, of an installed package, or of this one; false for one of the user's, and for a notebook's cell."""
    if file is None or file.startswith("<frozen"):
        return True
    if file.startswith("<"):
        return False
    path = Path(file).resolve()
    return any(place in path.parents for place in _libraries())


def is_users(module: str | None, home: str) -> bool:
    """True for a module of the user's: one outside the libraries, or of the package that the policy is in."""
    if module is None:
        return False
    if module.partition(".")[0] == home.partition(".")[0]:
        return True
    found = sys.modules.get(module)
    return found is not None and (module == "__main__" or not in_library(getattr(found, "__file__", None)))


def imported(module: str, name: str, package: str | None, home: str) -> Any:
    """The thing that a function imports: a module of the user's, or a thing in one; none for a library's, and for what cannot be imported."""
    try:
        full = importlib.util.resolve_name(module, package)
        if full not in sys.modules:
            spec = importlib.util.find_spec(full)
            if spec is None or in_library(spec.origin) and full.partition(".")[0] != home.partition(".")[0]:
                return None
        found = importlib.import_module(full)
        if not is_users(full, home):
            return None
        return getattr(found, name, None) or importlib.import_module(f"{full}.{name}") if name else found
    except Exception:  # Whatever the module raises, it raises again when the policy imports it.
        return None


def _all_code(code: CodeType) -> Iterator[CodeType]:
    yield code
    for part in code.co_consts:
        if isinstance(part, CodeType):
            yield from _all_code(part)


class _Source:
    """A file: its functions, by line, and the code that it compiles to now."""

    def __init__(self, lines: list[str], filename: str) -> None:
        text = "".join(lines)
        tree = ast.parse(text)
        self.code = set(_all_code(compile(text, filename, "exec", dont_inherit=True)))
        self.functions: dict[int, list[Node]] = {}
        for node in ast.walk(tree):
            if isinstance(node, _NODES):
                decorators = getattr(node, "decorator_list", [])
                first = min([node.lineno, *(part.lineno for part in decorators)])
                self.functions.setdefault(first, []).append(node)


_SOURCES: dict[str, tuple[list[str], _Source | None]] = {}


def _source(filename: str) -> _Source | None:
    linecache.checkcache(filename)
    lines = linecache.getlines(filename)
    known = _SOURCES.get(filename)
    if known is None or known[0] != lines:
        try:
            known = lines, _Source(lines, filename) if lines else None
        except (SyntaxError, ValueError, RecursionError):
            known = lines, None
        _SOURCES[filename] = known
    return known[1]


def node_of(function: FunctionType) -> Node | None:
    """The syntax tree of a function; none where its source is not there, or is no longer what runs."""
    code = function.__code__
    source = _source(code.co_filename)
    if source is None or code not in source.code:
        return None
    name = code.co_name
    found = [
        node
        for node in source.functions.get(code.co_firstlineno, [])
        if name == ("<lambda>" if isinstance(node, ast.Lambda) else node.name)
    ]
    if len(found) > 1:
        found = [node for node in found if _compiles_to(node, code)] or found[:0]
    return found[0] if found else None


def _compiles_to(node: Node, code: CodeType) -> bool:
    """True if a node, with the same free variables, gives this byte code."""
    free = [ast.arg(name) for name in code.co_freevars]
    empty: dict[str, Any] = {"posonlyargs": [], "kwonlyargs": [], "kw_defaults": [], "defaults": []}
    body: ast.stmt = ast.Return(node) if isinstance(node, ast.Lambda) else node
    outer = ast.FunctionDef("outer", ast.arguments(args=free, **empty), [body], [])
    module = ast.fix_missing_locations(ast.copy_location(ast.Module([outer], []), node))
    ast.fix_missing_locations(outer)
    if sys.version_info >= (3, 12):
        outer.type_params = []
    parts = _all_code(compile(module, code.co_filename, "exec", dont_inherit=True))
    return any(_shape(part) == _shape(code) for part in parts)


def _shape(code: CodeType) -> tuple[Any, ...]:
    consts = tuple(_shape(part) if isinstance(part, CodeType) else repr(part) for part in code.co_consts)
    return code.co_code, consts, code.co_names, code.co_varnames, code.co_freevars


def tree_bytes(node: Any) -> bytes:
    """A syntax tree as bytes: equal for equal code in every version of Python, whatever its lines, comments and blanks."""
    if isinstance(node, list):
        return b"[" + b"".join(map(tree_bytes, node)) + b"]"
    if not isinstance(node, ast.AST):
        return f"{type(node).__name__}:".encode() + _text(node) + b";"
    if isinstance(node, ast.JoinedStr):
        return b"(JoinedStr" + b"".join(map(tree_bytes, _joined(node.values))) + b")"
    parts = [type(node).__name__.encode()]
    for name in sorted(node._fields):
        part = getattr(node, name, None)
        # What a version leaves out or writes as nothing is the same; the kind of a text is u"" or "".
        if part is None and not (isinstance(node, ast.Constant) and name == "value"):
            continue
        if part == [] or name in ("kind", "ctx", "type_comment"):
            continue
        parts.append(name.encode() + b"=" + tree_bytes(part))
    return b"(" + b" ".join(parts) + b")"


def _joined(values: list[ast.expr]) -> Iterator[ast.expr]:
    """Parts of a formatted text, with neighbouring texts as one: versions cut them differently."""
    text = ""
    for part in values:
        if isinstance(part, ast.Constant) and isinstance(part.value, str):
            text += part.value
            continue
        if text:
            yield ast.Constant(text)
        text = ""
        yield part
    if text:
        yield ast.Constant(text)


def _text(value: Any) -> bytes:
    if isinstance(value, str):
        return value.encode("utf-8", "surrogatepass")
    return value if isinstance(value, bytes) else repr(value).encode()


class Uses:
    """The names that a function's code mentions and changes.

    Attributes:
        names: Names of variables from outside the function.
        attributes: Names of attributes, of whatever object.
        imports: What it imports when it is called: a module's name and that of the thing in it, if one is named.
        changed: Variables from outside that it assigns or changes in place.
        own: Attributes of its first argument that it assigns or changes in place.
        others: The same of other objects.
    """

    def __init__(self, function: FunctionType, node: Node | None) -> None:
        code = function.__code__
        self.attributes: set[str] = set()
        self.imports: set[tuple[str, str]] = set()
        self.own: set[str] = set()
        self.others: set[str] = set()
        if node is None:
            self.names, self.changed = names_of(code), set(code.co_freevars)
            self._of_code(code)
            return
        scope = _Scope(self, code.co_varnames[0] if code.co_argcount else None)
        scope.enter(node)
        self.names, self.changed = scope.outside(scope.used), scope.outside(scope.changed)

    def _of_code(self, code: CodeType) -> None:
        self.attributes, self.changed = set(self.names), set()
        for part in _all_code(code):
            for step in dis.get_instructions(part):
                if step.opname in ("STORE_GLOBAL", "STORE_DEREF") and step.argval not in code.co_cellvars:
                    self.changed.add(step.argval)
                elif step.opname == "STORE_ATTR":
                    self.own.add(step.argval)


class _Scope(ast.NodeVisitor):
    """Names in a function, a comprehension or a class's body, each in its own scope."""

    def __init__(self, uses: Uses, first: str | None) -> None:
        self._uses, self._first = uses, first
        self.used: set[str] = set()
        self.changed: set[str] = set()
        self._bound: set[str] = set()
        self._shared: set[str] = set()

    def outside(self, names: set[str]) -> set[str]:
        """Those of the names that are not variables of this scope."""
        return names - (self._bound - self._shared)

    def enter(self, node: Any) -> None:
        """Reads what is in a scope."""
        if isinstance(node, _NODES):
            arguments = node.args
            every = [*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs, arguments.vararg, arguments.kwarg]
            self._bound.update(part.arg for part in every if part is not None)
            for part in node.body if isinstance(node.body, list) else [node.body]:
                self.visit(part)
        elif isinstance(node, ast.ClassDef):
            for part in node.body:
                self.visit(part)
        else:
            self.generic_visit(node)
        self.changed |= self._shared & self._bound

    def _inner(self, node: Any) -> None:
        inner = _Scope(self._uses, self._first)
        inner.enter(node)
        self.used |= inner.outside(inner.used)
        self.changed |= inner.outside(inner.changed)

    def _function(self, node: Any) -> None:
        if not isinstance(node, ast.Lambda):
            self._bound.add(node.name)
            for part in node.decorator_list:
                self.visit(part)
        for part in (*node.args.defaults, *node.args.kw_defaults):
            if part is not None:
                self.visit(part)
        self._inner(node)

    visit_FunctionDef = visit_AsyncFunctionDef = visit_Lambda = _function
    visit_ListComp = visit_SetComp = visit_DictComp = visit_GeneratorExp = _inner

    def visit_ClassDef(self, node: ast.ClassDef) -> None:
        self._bound.add(node.name)
        for part in (*node.bases, *node.keywords, *node.decorator_list):
            self.visit(part)
        self._inner(node)

    def visit_Name(self, node: ast.Name) -> None:
        self.used.add(node.id)
        if not isinstance(node.ctx, ast.Load):
            self._bound.add(node.id)

    def visit_Global(self, node: ast.Global | ast.Nonlocal) -> None:
        self._shared.update(node.names)
        self.used.update(node.names)

    visit_Nonlocal = visit_Global

    def visit_Import(self, node: ast.Import) -> None:
        self._bound.update((part.asname or part.name).partition(".")[0] for part in node.names)
        self._uses.imports.update((part.name, "") for part in node.names)

    def visit_ImportFrom(self, node: ast.ImportFrom) -> None:
        self._bound.update(part.asname or part.name for part in node.names)
        module = "." * node.level + (node.module or "")
        self._uses.imports.update((module, part.name) for part in node.names)

    def visit_ExceptHandler(self, node: ast.ExceptHandler) -> None:
        if node.name:
            self._bound.add(node.name)
        self.generic_visit(node)

    def visit_Attribute(self, node: ast.Attribute) -> None:
        self._uses.attributes.add(node.attr)
        if not isinstance(node.ctx, ast.Load):
            self._change(node)
        self.generic_visit(node)

    def visit_Subscript(self, node: ast.Subscript) -> None:
        if not isinstance(node.ctx, ast.Load):
            self._change(node.value)
        self.generic_visit(node)

    def visit_Call(self, node: ast.Call) -> None:
        if isinstance(node.func, ast.Attribute) and node.func.attr in CHANGES:
            self._change(node.func.value)
        for word in node.keywords:
            if word.arg == "out":
                self._change(word.value)
        self.generic_visit(node)

    def _change(self, target: ast.expr) -> None:
        while isinstance(target, ast.Subscript):
            target = target.value
        if isinstance(target, ast.Name):
            self.changed.add(target.id)
        elif isinstance(target, ast.Attribute):
            is_own = isinstance(target.value, ast.Name) and target.value.id == self._first
            (self._uses.own if is_own else self._uses.others).add(target.attr)


def code_bytes(code: CodeType) -> Iterator[bytes]:
    """Byte code without its lines, which holds for one version of Python."""
    yield f"Python {sys.version_info.major}.{sys.version_info.minor}".encode()
    for part in _all_code(code):
        yield part.co_code
        yield repr((part.co_names, part.co_varnames, part.co_freevars, part.co_flags)).encode()
        yield getattr(part, "co_exceptiontable", b"")
        for constant in part.co_consts:
            if isinstance(constant, frozenset):
                yield repr(sorted(map(repr, constant))).encode()
            elif not isinstance(constant, CodeType):
                yield repr(constant).encode()


def unwrapped(function: Any) -> Any:
    """The function that a decorator of a library wraps, if it keeps it."""
    for name in ("__wrapped__", "py_func"):
        inner = inspect.getattr_static(function, name, None)
        inner = getattr(function, name, None) if inner is not None else None
        if callable(inner):
            return inner
    return None
