"""Compares the rates in README, the book and its pictures with docs/figures.toml: .ci/figures.py [--write]."""

import hashlib
import math
import pathlib
import re
import sys
import tomllib

ROOT = pathlib.Path(__file__).resolve().parent.parent
# A result as `fiatlux evaluate` prints it, and the figure that each policy's is.
RESULT = re.compile(r"^(\w+): (\d+)/(\d+) strict", re.MULTILINE)
RESULTS = {"expert": "expert_first_rooms"}
MARK = re.compile(r"<!--= ([\w.]+) (\w+) -->(.*?)<!--/-->", re.DOTALL)


def counts(figures: dict, name: str) -> tuple[int, int]:
    """Successes and episodes of a figure, `policy` or `policy.S01`."""
    figure, _, task = name.partition(".")
    if figure not in figures:
        raise KeyError(f"docs/figures.toml has no figure {figure}")
    entry = figures[figure]
    tasks = entry.get("tasks", {})
    if task:
        return tasks[task], entry["episodes"]
    if tasks:
        return sum(tasks.values()), entry["episodes"] * len(tasks)
    return entry["successes"], entry["episodes"]


def wilson(successes: int, episodes: int) -> tuple[float, float]:
    """Wilson's 95 % interval of a rate."""
    z, rate = 1.959964, successes / episodes
    scale = 1 + z * z / episodes
    middle = (rate + z * z / (2 * episodes)) / scale
    half = z * math.sqrt(rate * (1 - rate) / episodes + z * z / (4 * episodes * episodes)) / scale
    return max(middle - half, 0), min(middle + half, 1)


def text(figures: dict, name: str, form: str) -> str:
    successes, episodes = counts(figures, name)
    digits = 3 if episodes >= 200 else 2
    low, high = wilson(successes, episodes)
    forms = {
        "n": f"{successes}",
        "of": f"{successes} of {episodes}",
        "rate": f"{successes / episodes:.{digits}f}",
        "range": f"{low:.{digits}f} to {high:.{digits}f}",
    }
    forms["full"] = f"{forms['of']} = {forms['rate']} ({forms['range']})"
    if form not in forms:
        raise KeyError(f"{form} is not a form: {', '.join(forms)}")
    return forms[form]


def check(page: str, content: str, figures: dict) -> tuple[str, list[str]]:
    """The page with each rate as the data have it, and what is wrong in it."""
    wrong = []

    def fill(match: re.Match) -> str:
        name, form, said = match.groups()
        try:
            right = text(figures, name, form)
        except KeyError as error:
            wrong.append(f"{page}: {name} {form}: {error.args[0]}")
            return match[0]
        if said != right:
            wrong.append(f"{page}: {name} is {right}, the page says {said}; run .ci/figures.py --write")
        return f"<!--= {name} {form} -->{right}<!--/-->"

    filled = MARK.sub(fill, content)
    if content.count("<!--=") != len(MARK.findall(content)):
        wrong.append(f"{page}: a rate's comment cannot be read; write <!--= NAME FORM -->...<!--/-->")
    if re.search(r"^<!--=", filled, re.MULTILINE):
        wrong.append(f"{page}: a rate begins a line, which ends the paragraph before it; put a word ahead of it")
    return filled, wrong


def quoted(page: str, content: str, figures: dict) -> list[str]:
    """Faults of results that a page quotes from a terminal, where no comment can be."""
    wrong = []
    for policy, *said in RESULT.findall(content):
        right = text(figures, RESULTS[policy], "of") if policy in RESULTS else "in no figure"
        if " of ".join(said) != right:
            wrong.append(f"{page}: the result of {policy} is {right}, the page quotes {' of '.join(said)}")
    return wrong


def version() -> int:
    """The benchmark's version."""
    return int(re.search(r"BENCHMARK_VERSION: u32 = (\d+)", (ROOT / "crates/rules/src/lib.rs").read_text())[1])


def pictured(folder: pathlib.Path, figures: dict) -> list[str]:
    """Faults of the pictures of scores: docs/pictures/figures.toml says which figures each one shows."""
    drawn = tomllib.loads((folder / "figures.toml").read_text())
    wrong = []
    for name, entry in drawn.items():
        again = f"{name}: draw it anew, deploy/pictures.py {entry['part']}"
        if hashlib.sha256((folder / name).read_bytes()).hexdigest() != entry["sha256"]:
            wrong.append(f"{again}: it is not the picture that docs/pictures/figures.toml is of")
        if entry["version"] != version():
            wrong.append(f"{again}: it is of version {entry['version']} of the benchmark, which has version {version()}")
        for figure, said in entry["figures"].items():
            if said != (right := text(figures, figure, "of")):
                wrong.append(f"{again}: it shows {said} for {figure}, which is {right}")
    return wrong


def main() -> None:
    figures = tomllib.loads((ROOT / "docs/figures.toml").read_text())
    faults, used = [], set()
    for path in [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]:
        content = path.read_text()
        used |= {match[1].partition(".")[0] for match in MARK.finditer(content)}
        filled, wrong = check(str(path.relative_to(ROOT)), content, figures)
        if "--write" in sys.argv and filled != content:
            path.write_text(filled)
            wrong = check(str(path), filled, figures)[1]
        faults += wrong + quoted(str(path.relative_to(ROOT)), filled, figures)
    faults += pictured(ROOT / "docs/pictures", figures)
    faults += [f"docs/figures.toml: no page states {name}" for name in sorted(set(figures) - used)]
    if faults:
        sys.exit("\n".join(faults))


if __name__ == "__main__":
    main()
