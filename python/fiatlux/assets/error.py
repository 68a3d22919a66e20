"""The error of every stage."""

from __future__ import annotations

from .._extras import missing


class AssetError(ValueError):
    """An input that is refused; the message names it and the remedy. Nothing has been written."""


def needs(error: ImportError) -> ImportError:
    """The error to raise where a package of the extra ``assets`` cannot be imported."""
    return missing("fiatlux.assets", "assets", error)
