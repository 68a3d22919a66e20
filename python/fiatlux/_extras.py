"""Packages of the wheel's extras: where one is missing, the error says which extra to install, and how."""

from importlib.util import find_spec

_HOW = 'pip install "fiatlux[{extra}] @ file:///ABSOLUTE/PATH/fiatlux-VERSION.whl" (docs/python/wheels.md)'


def missing(what: str, extra: str, error: ImportError) -> ImportError:
    """The error to raise where ``what`` cannot import a package of an extra."""
    how = _HOW.format(extra=extra)
    return ImportError(
        f"{what} needs its extra {extra}, but {error}; install the wheel with it: {how}", name=error.name
    )


def check(what: str, extra: str, *packages: str) -> None:
    """Raises :func:`missing` for the first of the packages that is not installed, without importing any."""
    for package in packages:
        try:
            found = find_spec(package)
        except (ImportError, ValueError):
            found = None
        if found is None:
            raise missing(what, extra, ModuleNotFoundError(f"No module named {package!r}", name=package))
