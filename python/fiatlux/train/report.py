"""Runs the tests of a checkpoint, and prints their table."""

import json
import math
from pathlib import Path

from .._progress import Line, duration
from .evaluation import SECOND, TESTS, measure
from .settings import SCENES
from .run import device_of, load_checkpoint, settings_of
from .walk import models
from .worlds import WalkingWorlds


def main(
    checkpoint: Path,
    episodes: int,
    tests: list[str] | None,
    threads: int | None,
    device: str,
    scene: str = "floor",
    as_json: bool = False,
) -> int:
    """Prints a table of a checkpoint's tests, a line as each ends; or, at the end, an object with one for each test."""
    unknown = [name for name in tests or () if name not in TESTS]
    if unknown:
        raise ValueError(f"there is no test {unknown[0]!r}; the tests are {', '.join(TESTS)}")
    state = load_checkpoint(checkpoint)
    settings = settings_of(state, {})
    device = device_of(device)
    actor, _ = models(WalkingWorlds(1, device, settings.without), settings)
    actor.load_state_dict(state["ppo"]["actor_state_dict"])
    actor.to(device)
    table: dict[str, dict[str, float | None]] = {}
    names, steps, line = tests or list(TESTS), 1000, Line()
    for number, name in enumerate(names):

        def show(step: int, number: int = number, name: str = name) -> None:
            left = line.seconds_left(number * steps + step, len(names) * steps)
            line.show(
                f"test {number + 1} of {len(names)}, {name}: {step / SECOND:.0f} of {steps // SECOND} s, {duration(left)} left"
            )

        worlds = {**TESTS[name], **SCENES[scene]}
        found = measure(actor, device, threads, episodes, steps, 12345, worlds, settings.without, show)
        line.show("")
        if not table and not as_json:
            print(f"{'test':10}" + "".join(f"{key:>12}" for key in found))
        table[name] = {key: value if math.isfinite(value) else None for key, value in found.items()}
        if not as_json:
            shown = (
                "-" if value is None else f"{value:.0f}" if key == "seconds" else f"{value:.4f}"
                for key, value in table[name].items()
            )
            print(f"{name:10}" + "".join(f"{text:>12}" for text in shown), flush=True)
    if as_json:
        print(json.dumps(table, indent=2))
    return 0
