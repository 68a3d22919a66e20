"""Runs the benchmark in this process."""

import json
import warnings
from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, Callable, Mapping, Sequence

from . import _native
from .bag import Bag
from .client import run_of
from .env import Env
from .policy import Player, PolicyLike, settings_for
from .settings import Settings, complete
from .spaces import ObservationForm
from .tasks import SUBTASKS

if TYPE_CHECKING:
    from typing_extensions import Unpack


@dataclass(frozen=True)
class Evaluation:
    """The result of a policy in the benchmark."""

    scores: dict[str, Any]
    """The benchmark's scores, with the names of ``results.json``."""
    episodes: list[dict[str, Any]]
    """Each episode as judged by the judge that ended it, with the names of ``results.json``; ``state_digest`` is the digest of
    its rows. A recorded one has its ``bag``, a path relative to the folder."""
    lost: tuple[str, ...] = ()
    """Episodes of a recorded evaluation that are missing, with the reason."""

    def table(self) -> str:
        """The scores as a text table."""
        header = f"{'task':<30} {'score':>6} {'success':>8} {'progress':>9} {'broken':>7} {'dropped':>8} {'steps':>7}"
        lines = [header, "-" * len(header)]
        for row in self.scores["subtasks"]:
            name = f"{row['id']} {row['name']}"
            rates = f"{row['score_mean']:>6.3f} {row['success_rate']:>8.2f} {row['gate_progress']:>9.3f}"
            lines.append(f"{name:<30} {rates} {row['broken_rate']:>7.2f} {row['dropped_rate']:>8.2f} {row['mean_steps']:>7.0f}")
        mean, std = self.scores["score"]["mean"], self.scores["score"]["std"]
        if mean is not None:
            lines.append(f"benchmark score {mean:.4f}" + ("" if std is None else f" +- {std:.4f} over seeds"))
        if self.scores["missing"]:
            lines.append("missing: " + ", ".join(self.scores["missing"]))
        return "\n".join(lines)


def evaluate(
    policy: PolicyLike,
    tasks: Sequence[str] = SUBTASKS,
    seeds: Sequence[int] = (0, 1, 2, 3),
    *,
    out: str | PathLike[str] | None = None,
    parallel: int | None = None,
    name: str | None = None,
    observation: ObservationForm = "dict",
    record: Sequence[str] = (),
    max_steps: int | None = None,
    progress: Callable[[dict[str, Any]], None] | None = None,
    **settings: "Unpack[Settings]",
) -> Evaluation:
    """Plays a policy through tasks and seeds, one episode for each pair: by default the 48 episodes of the benchmark.

    For the same actions, the rows and digests are those of the program ``fiatlux evaluate``.

    Args:
        policy: See :data:`fiatlux.PolicyLike`.
        tasks: Short ids of the tasks.
        seeds: Seeds of the benchmark; every task is played under each.
        out: Folder for bags, ``results.json`` and ``report.html``. Episodes then go through a server and a client in this
            process, as in the program; the same call resumes an evaluation that was stopped.
        parallel: Episodes to play at once, only with ``out``. See :meth:`fiatlux.Client.evaluate`.
        name: The policy's name, for the record.
        observation: Form of the observations.
        record: Sensors to record in the bags in addition to the small ones, such as ``"camera"``.
        max_steps: Cuts episodes after this number of steps; the table cannot be compared with others then. Not with ``out``.
        progress: Called with the summary of each episode as it ends; with ``out``, a few times a second with a dictionary of
            counts.
        settings: See :class:`fiatlux.Settings`.
    """
    chosen = settings_for(policy, settings)
    if out is not None:
        if max_steps is not None:
            raise ValueError("max_steps: a bag always holds a whole episode; drop either out or max_steps")
        return _recorded(policy, tasks, seeds, Path(out), parallel, name, observation, record, progress, chosen)
    for field, given in (("parallel", parallel is not None), ("record", len(record) > 0)):
        if given:
            raise ValueError(f"{field}: only a recorded evaluation takes it; name a folder with out")
    episodes = []
    for task in tasks:
        env = Env(task, observation=observation, **chosen)
        for seed in seeds:
            summary = play(env, policy, seed, max_steps=max_steps)
            episodes.append(summary)
            if progress is not None:
                progress(summary)
        env.close()
    return Evaluation(_native.benchmark(episodes), episodes)


def play(env: Env, policy: PolicyLike, seed: int, episode: int = 0, max_steps: int | None = None) -> dict[str, Any]:
    """Plays one episode, and returns its summary."""
    played: Any = policy() if isinstance(policy, type) else policy
    observed, _ = env.reset(seed=seed, options={"episode": episode})
    begin = getattr(played, "reset", None)
    if callable(begin):
        begin({"task": env.task.short_id, "instruction": env.task.instruction, "seed": seed, "episode": episode})
    steps, ended = 0, False
    while not ended and (max_steps is None or steps < max_steps):
        observed, _, terminated, truncated, _ = env.step(played(observed))
        steps, ended = steps + 1, terminated or truncated
    return env.summary()


def _recorded(
    policy: PolicyLike,
    tasks: Sequence[str],
    seeds: Sequence[int],
    out: Path,
    parallel: int | None,
    name: str | None,
    observation: ObservationForm,
    record: Sequence[str],
    progress: Callable[[dict[str, Any]], None] | None,
    settings: Mapping[str, Any],
) -> Evaluation:
    if len(tasks) == 0 or len(seeds) == 0:
        raise ValueError("tasks and seeds: give at least one each")
    asked = complete(tasks[0] if len(tasks) == 1 else None, observation, settings)
    run = {**run_of(policy, tasks, seeds, parallel, name, out / "RUN.toml"), "record": list(record)}
    players = []

    def play_one() -> Player:
        players.append(1)
        return Player(policy, observation)

    text, lost = _native.evaluate_into(fspath(out), play_one, run, asked, progress)
    if not players and not lost:
        message = f"{out} had all episodes already, so none was played; name another folder for a changed policy"
        warnings.warn(message, stacklevel=3)
    episodes = [_summary(row, Bag(out / row["bag"])) for row in json.loads(text)["episodes"] if row["bag"]]
    return Evaluation(_native.benchmark(episodes), episodes, tuple(lost))


def _summary(row: Mapping[str, Any], bag: Bag) -> dict[str, Any]:
    """A graded episode as judged by the judge that ended it, in the form of :meth:`fiatlux.Env.summary`."""
    result = bag.result or {}
    verdict = result[bag.header["episode_protocol"]]
    return {
        "task": row["task"],
        "seed": row["seed"],
        "episode": row["episode"],
        "success": verdict["success"],
        "clean": verdict["success"] and not verdict["broken"] and not verdict["dropped"],
        "broken": verdict["broken"],
        "dropped": verdict["dropped"],
        "gate_progress": verdict["gate_progress"],
        "peak_hand_force_n": verdict["peak_hand_force_n"],
        "control_effort": verdict["control_effort"],
        "steps": verdict["steps"],
        "end": verdict["cause"],
        "state_digest": row["state_digest"],
        "bag": row["bag"],
    }
