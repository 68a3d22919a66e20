"""The error of every stage."""

from __future__ import annotations


class AssetError(ValueError):
    """An input that is refused; the message names it and the remedy. Nothing has been written."""


def needs(module: str) -> AssetError:
    return AssetError(f"{module} is not installed; install the wheel with its extra assets (docs/assets.md)")
