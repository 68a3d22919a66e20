"""Runs the examples in README and pages: the ```python blocks of a page in order, in one namespace.

Blocks that need a server, or an extra, name it in a comment: `extras/` has the same calls.
"""

import pathlib
import re

import fiatlux
import pytest

ROOT = pathlib.Path(__file__).resolve().parents[2]
PAGES = [ROOT / "python/README.md", *sorted((ROOT / "docs/python").glob("*.md"))]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_examples_run(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(
        r"(?:^<!-- needs: (\w+) -->\n)?^```python\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL
    )
    names = {"__name__": page.stem}
    for needs, block in blocks:
        code = compile(block, str(page), "exec")
        if not needs:
            exec(code, names)


@pytest.mark.parametrize(
    "page, section, worlds",
    [
        ("notes/training.md", "What walking pays", fiatlux.WalkingVectorEnv),
        ("notes/training.md", "What following the plan pays", fiatlux.ClimbingVectorEnv),
    ],
)
def test_a_page_lists_the_terms_of_a_reward_with_their_weights(page, section, worlds):
    page = (ROOT / "docs" / page).read_text()
    text = page.split(f"\n## {section}\n")[1].split("\n## ")[0]
    listed = re.findall(r"^\| `(\w+)` \| (-?[\d.e-]+) \|", text, re.MULTILINE)
    assert {name: float(weight) for name, weight in listed} == worlds(1).reward_weights
