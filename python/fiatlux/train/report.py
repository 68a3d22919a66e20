"""Runs the tests of a checkpoint, and prints their table."""

import json
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from .._progress import Line, duration
from ..tasks import TASKS
from . import climb, hand, ppo, walk
from .evaluation import SECOND, TESTS, measure
from .run import device_of, kind_of, load_checkpoint, settings_of
from .settings import FIRST_TEST_ROOM, SCENES, Baseline, Climb, Hand
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
    state = load_checkpoint(checkpoint)
    settings = settings_of(state, {})
    device = device_of(device)
    if kind_of(state) == "ppo":
        return _baseline(state, settings, device, episodes, threads, as_json)
    if kind_of(state) == "climb":
        return _climber(state, settings, device, episodes, threads, as_json)
    if kind_of(state) == "hand":
        return _hand(state, settings, device, episodes, threads, as_json)
    unknown = [name for name in tests or () if name not in TESTS]
    if unknown:
        raise ValueError(f"there is no test {unknown[0]!r}; the tests are {', '.join(TESTS)}")
    actor, _ = walk.models(WalkingWorlds(1, device, settings.without), settings)
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


def _climber(
    state: Mapping[str, Any], settings: Climb, device: str, episodes: int, threads: int | None, as_json: bool
) -> int:
    """Prints the test of a policy that follows the plan of the ladder."""
    worlds = climb.ClimbingWorlds(1, device, until=settings.until)
    actor, _ = climb.models(worlds, settings)
    worlds.env.close()
    actor.load_state_dict(state["ppo"]["actor_state_dict"])
    found, _ = climb.measure(actor.to(device), settings, device, threads, episodes)
    _show_list({"samples": state["progress"]["samples"], "episodes": episodes, **found}, as_json)
    return 0


def _show_list(table: Mapping[str, Any], as_json: bool) -> None:
    print(json.dumps(table, indent=2) if as_json else "\n".join(f"{name:15}{value}" for name, value in table.items()))


def _baseline(
    state: Mapping[str, Any], settings: Baseline, device: str, episodes: int, threads: int | None, as_json: bool
) -> int:
    """Prints the test of a baseline."""
    worlds = ppo.worlds_of(settings, device, 1, FIRST_TEST_ROOM, 0, threads)
    actor, _ = ppo.models(worlds, settings)
    worlds.env.close()
    actor.load_state_dict(state["ppo"]["actor_state_dict"])
    found = _watched(
        settings.task,
        lambda show: ppo.measure(actor.to(device), settings, device, threads, episodes, progress=show),
    )
    _show_list({"task": settings.task, "samples": state["progress"]["samples"], "episodes": episodes, **found}, as_json)
    return 0


def _hand(
    state: Mapping[str, Any], settings: Hand, device: str, episodes: int, threads: int | None, as_json: bool
) -> int:
    """Prints the test of a policy of one hand."""
    grasp = state["grasp"]
    worlds = hand.HandWorlds(settings, grasp, device, 1, FIRST_TEST_ROOM, 0, threads, None, None)
    actor, _ = hand.models(worlds, settings)
    worlds.env.close()
    actor.load_state_dict(state["ppo"]["actor_state_dict"])
    found = _watched(
        settings.task,
        lambda show: hand.measure(actor.to(device), settings, grasp, device, threads, episodes, progress=show),
    )
    _show_list({"task": settings.task, "samples": state["progress"]["samples"], "episodes": episodes, **found}, as_json)
    return 0


def _watched(task: str, measure: Callable[[Callable[[int], None]], dict[str, float]]) -> dict[str, float]:
    """Plays whole episodes of a task, with a line that says how long it takes."""
    line, steps = Line(), TASKS[task].horizon_steps

    def show(step: int) -> None:
        line.show(
            f"{step / SECOND:.0f} of {steps // SECOND} s, {duration(line.seconds_left(step, steps))} left at most"
        )

    found = measure(show)
    line.show("")
    return found
