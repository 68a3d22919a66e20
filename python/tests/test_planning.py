"""The controller of the page on planning reaches its goal; it takes minutes, so that `FIATLUX_NIGHTLY` asks for it."""

import os
import pathlib
import re

import pytest

PAGE = pathlib.Path(__file__).resolve().parents[2] / "docs/python/planning.md"


@pytest.mark.skipif("FIATLUX_NIGHTLY" not in os.environ, reason="FIATLUX_NIGHTLY is not set")
def test_mppi_walks_to_the_bulb(capsys):
    (block,) = re.findall(r"^<!-- needs: nightly -->\n```python\n(.*?)^```", PAGE.read_text(), re.MULTILINE | re.DOTALL)
    names = {"__name__": "planning"}
    exec(compile(block, str(PAGE), "exec"), names)
    assert names["success"], capsys.readouterr().out
