#!/usr/bin/env python3
"""Finds circles of modules: files of one crate, or of the Python package, that need each other.

A file needs another if a path in it leads to an item that the other defines. Re-exports (`pub use`, imports of an
`__init__.py`) are followed to where an item is defined and do not count themselves, so a root may hand out what its
submodules define. A submodule may take types, traits and constants from the files above it, which are its header: a type
with its parts in several files is one idea. If it calls a function of theirs while they need it, that is a circle.

Tests are left out, and `use x::*` is a need of x itself. In Python, imports in functions and for type checkers count.
"""

import ast
import re
import sys
from pathlib import Path

# Comments, raw strings, strings, characters (a lifetime has no closing quote).
SKIPPED = re.compile(
    r'//[^\n]*|/\*.*?\*/|b?r(#*)".*?"\1|b?"(?:\\.|[^"\\])*"|' r"b?'(?:\\.[^']*|[^'\\])'",
    re.DOTALL,
)
TEST = re.compile(r"#\[cfg\(test\)\]\s*(?:#\[[^\]]*\]\s*)*(?:pub(?:\([^)]*\))?\s+)?(?:mod\s+(\w+)|use|fn|impl|static|const)")
USE = re.compile(r"\b(pub(?:\([^)]*\))?\s+)?use\s+([^;]+);")
MODULE = re.compile(r"\bmod\s+(\w+)\s*;")
DEFINES = re.compile(
    r"\b(?:struct|enum|union|trait|type|const(?!\s+fn)|static(?:\s+mut)?|(?:const\s+|async\s+|unsafe\s+)*fn|macro_rules!)\s+(\w+)"
)
PATH = re.compile(r"(?<![\w:])\$?(\w+(?:::\w+)+)")


def end_of_block(text, start):
    """Where the item that begins at `start` ends: after its block, or its semicolon."""
    depth = 0
    for at in range(start, len(text)):
        if text[at] in "{([":
            depth += 1
        elif text[at] in "})]":
            depth -= 1
            if depth == 0 and text[at] == "}":
                return at + 1
        elif text[at] == ";" and depth == 0:
            return at + 1
    return len(text)


def without_tests(text):
    """The code without comments, strings and tests, and the names of the modules that are only tests."""
    text, tests = SKIPPED.sub(" ", text), set()
    while found := TEST.search(text):
        tests.add(found[1])
        text = text[: found.start()] + text[end_of_block(text, found.end()) :]
    return text, tests


def leaves(tree, prefix=()):
    """The paths of a `use` with their names here: `a::{self, b as c}` gives (a, a) and (a, b) as c."""
    tree = tree.strip()
    head, brace, rest = tree.partition("{")
    if brace:
        prefix = (*prefix, *(part.strip() for part in head.split("::") if part.strip()))
        depth, start, inner = 0, 0, rest[: rest.rindex("}")]
        for at, sign in enumerate(inner + ","):
            depth += (sign == "{") - (sign == "}")
            if sign == "," and depth == 0:
                if inner[start:at].strip():
                    yield from leaves(inner[start:at], prefix)
                start = at + 1
        return
    path, _, name = tree.partition(" as ")
    parts = (*prefix, *(part.strip() for part in path.split("::") if part.strip()))
    if parts and parts[-1] == "self":
        parts = parts[:-1]
    yield parts, name.strip() or parts[-1]


class Crate:
    """The modules of a crate by their path, each a file."""

    def __init__(self, root):
        self.code, self.files, self.uses, self.names, self.globs, self.defined = {}, {}, {}, {}, {}, {}
        self.read((), root, root.parent)

    def read(self, module, file, folder):
        code, tests = without_tests(file.read_text())
        uses = [(bool(found[1]), leaf) for found in USE.finditer(code) for leaf in leaves(found[2])]
        self.code[module], self.files[module] = USE.sub(" ", code), file
        self.uses[module] = [path for shared, (path, _) in uses if not shared]
        self.names[module] = {name: path for _, (path, name) in uses if name != "*"}
        self.globs[module] = [path[:-1] for _, (path, name) in uses if name == "*"]
        self.defined[module] = set(DEFINES.findall(code))
        modules = MODULE.findall(code)
        if module and "include!" in code and folder.is_dir():
            # A build script lists the files of its folder.
            modules += sorted(path.stem for path in folder.glob("*.rs"))
            self.uses[module] += [("self", name) for name in modules]
        for name in modules:
            inner = next((path for path in (folder / f"{name}.rs", folder / name / "mod.rs") if path.exists()), None)
            if name not in tests and inner:
                self.read((*module, name), inner, folder / name)

    def target(self, module, path, seen=frozenset()):
        """The module that defines what a path in a module leads to; None for another crate's."""
        if not path or (module, path) in seen:
            return None
        seen |= {(module, path)}
        head, *rest = path
        if head == "crate":
            return self.inside((), tuple(rest), seen)
        if head == "self":
            return self.inside(module, tuple(rest), seen)
        if head == "super":
            return self.inside(module[:-1], tuple(rest), seen) if module else None
        if (*module, head) in self.files or head in self.names[module]:
            return self.inside(module, path, seen)
        return None

    def inside(self, module, path, seen):
        if not path:
            return module
        head, *rest = path
        if head == "super":
            return self.inside(module[:-1], tuple(rest), seen)
        if (*module, head) in self.files:
            return self.inside((*module, head), tuple(rest), seen)
        if head in self.defined[module]:
            return module
        if head in self.names[module]:
            shared = self.names[module][head]
            # A crate's own name, as in `use png;`, leads out.
            return None if shared[0] == head else self.target(module, (*shared, *rest), seen)
        for glob in self.globs[module]:
            found = self.target(module, glob, seen)
            if found not in (None, module) and head in self.defined[found]:
                return found
        # A macro of the crate, or an item that a macro makes.
        return module if path == (head,) else None

    def needs(self):
        """The modules that each module needs, without itself."""
        graph = {}
        for module, code in self.code.items():
            graph[module] = set()
            for path in self.uses[module] + [tuple(found.split("::")) for found in PATH.findall(code)]:
                target = self.target(module, path[:-1] if path[-1] == "*" else path)
                is_header = target == module[: len(target or ())] and any(name[:1].isupper() for name in path)
                if target not in (None, module) and not is_header:
                    graph[module].add(target)
        return graph


def python_needs(package):
    """The same for a Python package."""
    files, trees, handed = {}, {}, {}
    for file in sorted(package.rglob("*.py")):
        parts = file.relative_to(package.parent).with_suffix("").parts
        module = parts[:-1] if parts[-1] == "__init__" else parts
        files[module], trees[module] = file, ast.parse(file.read_text())

    def imports(module):
        place = module if files[module].name == "__init__.py" else module[:-1]
        for node in ast.walk(trees[module]):
            if isinstance(node, ast.ImportFrom):
                base = place[: len(place) - node.level + 1] if node.level else ()
                base += tuple(node.module.split(".")) if node.module else ()
                yield from ((base, name.name, name.asname or name.name) for name in node.names)
            elif isinstance(node, ast.Import):
                yield from ((tuple(name.name.split(".")), "", "") for name in node.names)

    for module in files:
        if files[module].name == "__init__.py":
            handed[module] = {shown: (base, name) for base, name, shown in imports(module)}

    def target(base, name):
        if (*base, name) in files:
            return (*base, name)
        return target(*handed[base][name]) if name in handed.get(base, {}) else base

    graph = {}
    for module in files:
        found = set() if module in handed else {target(base, name) for base, name, _ in imports(module)}
        graph[module] = {path for path in found if path in files and path != module}
    return graph


def circles(graph):
    """The groups of modules that need each other, sorted."""
    reach = {}
    for start in graph:
        reach[start], waiting = set(), [start]
        while waiting:
            for other in graph[waiting.pop()] - reach[start]:
                reach[start].add(other)
                waiting.append(other)
    groups = {frozenset(other for other in graph if other in reach[one] and one in reach[other]) for one in graph}
    return sorted(sorted(group) for group in groups if group)


def described(graph, join):
    """A line for each circle."""
    def name(module):
        return join.join(module) or "the root"

    for group in circles(graph):
        needs = [f"{name(one)} needs {', '.join(name(other) for other in sorted(graph[one] & {*group}))}" for one in group]
        yield "; ".join(needs)


def main():
    top = Path(__file__).parent.parent
    faults = []
    for manifest in sorted(top.glob("**/Cargo.toml")):
        folder = manifest.parent.relative_to(top)
        roots = [manifest.parent / "src" / name for name in ("lib.rs", "main.rs")]
        if "target" not in folder.parts:
            faults += [f"{folder}: {line}" for root in roots if root.exists() for line in described(Crate(root).needs(), "::")]
    faults += [f"python: {line}" for line in described(python_needs(top / "python/fiatlux"), ".")]
    for fault in faults:
        print(f"circle of modules in {fault}", file=sys.stderr)
    return bool(faults)


if __name__ == "__main__":
    sys.exit(main())
