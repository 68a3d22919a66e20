"""Runs the notebooks of the book as Jupyter does, cell by cell, each in a process of its own. They are kept without outputs."""

import json
import pathlib
import re
import subprocess
import sys

import pytest
from fiatlux import _native

BOOKS = sorted((pathlib.Path(__file__).resolve().parents[2] / "docs/notebooks").glob("*.ipynb"))
# The last expression of a cell is shown: by what its class has for notebooks, or as text.
RUNNER = """
import ast, json, sys
names = {"__name__": "__main__"}
for cell in json.load(open(sys.argv[1]))["cells"]:
    if cell["cell_type"] != "code":
        continue
    tree = ast.parse("".join(cell["source"]))
    last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
    exec(compile(tree, cell["id"], "exec"), names)
    shown = None if last is None else eval(compile(ast.Expression(last.value), cell["id"], "eval"), names)
    if shown is not None:
        kinds = [name for name in ("_repr_png_", "_repr_html_") if getattr(shown, name, lambda: None)()]
        print(cell["id"], *kinds, repr(shown).replace("\\n", " ")[:200])
"""
# A cell of each that shows a picture, or a table.
SHOWN = {
    "first_episode": "first-episode-3 _repr_png_",
    "write_an_expert": "write-an-expert-5 _repr_html_",
    "train_a_walker": "train-a-walker-7 _repr_png_",
    "learn_from_demonstrations": "learn-from-demonstrations-3 _repr_png_",
    "read_bags": "read-bags-1 _repr_png_",
}


def test_all_are_here():
    assert {book.stem for book in BOOKS} == set(SHOWN)


@pytest.mark.parametrize("book", BOOKS, ids=lambda book: book.stem)
def test_a_notebook_is_stored_without_outputs(book):
    text = book.read_text()
    stored = json.loads(text)
    assert (stored["nbformat"], stored["nbformat_minor"]) == (4, 5) and text.endswith("}\n")
    assert len({cell["id"] for cell in stored["cells"]}) == len(stored["cells"])
    for cell in stored["cells"]:
        source = "".join(cell["source"])
        if cell["cell_type"] == "code":
            assert cell["outputs"] == [] and cell["execution_count"] is None, f"{cell['id']}: clear all outputs"
            assert not re.search(r"^\s*[%!]", source, re.MULTILINE), f"{cell['id']}: only Python runs everywhere"
        for link in re.findall(r"\]\(([^)#:]+)\)", source):
            assert (book.parent / link).is_file(), f"{cell['id']}: {link}"


@pytest.mark.parametrize("book", BOOKS, ids=lambda book: book.stem)
def test_a_notebook_runs(book, tmp_path):
    if "demonstrations" in book.stem and not hasattr(_native, "run_program"):
        pytest.skip("needs a wheel with the programs: tests/run")
    run = subprocess.run([sys.executable, "-c", RUNNER, book], cwd=tmp_path, capture_output=True, text=True)
    assert run.returncode == 0, run.stdout[-2000:] + run.stderr[-4000:]
    assert SHOWN[book.stem] in run.stdout, run.stdout
