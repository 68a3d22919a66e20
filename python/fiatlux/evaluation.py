"""Runs the benchmark in this process."""

import html
import json
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Any, Literal

from . import _native
from ._numbers import seeds_of
from .client import run_of, tasks_of
from .env import Env
from .expert import ShownExpert
from .policy import Player, PolicyLike, check_policy, settings_for
from .settings import Settings, complete, spelt_out
from .spaces import ObservationForm
from .tasks import SUBTASKS

if TYPE_CHECKING:
    from typing_extensions import Unpack

BagForm = Literal["full", "thin"]
"""The form in which bags are kept."""

SCORES = ("seeds", "score", "score_strict", "subtasks", "missing", "overall", "extra_tasks")
"""Fields of ``results.json`` that are scores."""


@dataclass(frozen=True, repr=False)
class Evaluation:
    """The result of a policy in the benchmark."""

    scores: dict[str, Any]
    """The benchmark's scores: the fields of ``results.json`` from ``seeds`` to ``extra_tasks``, with the same values. Plain names
    are of the published judge, those with ``strict`` of the strict one, which rankings use."""
    episodes: list[dict[str, Any]]
    """Each episode, with the fields and values of ``results.json``. Only a recorded one has ``bag``, a path relative to the
    folder, ``failure``, ``notes`` and ``signed_by``."""
    lost: tuple[str, ...] = ()
    """Episodes of a recorded evaluation that are missing, with the reason."""
    is_run: bool = False
    """True for a recorded evaluation, which is a run: in S a subtask that was not asked for counts 0."""

    def __repr__(self) -> str:
        strict = sum(bool(episode.get("strict_success")) for episode in self.episodes)
        published = sum(bool(episode.get("success")) for episode in self.episodes)
        return f"<fiatlux.Evaluation: {len(self.episodes)} episodes, success strict {strict}, published {published}; see table()>"

    def _repr_html_(self) -> str:
        """The table in a notebook."""
        return f"<pre>{html.escape(self.table())}</pre>"

    def table(self) -> str:
        """The scores as a text table."""
        judges = [("published", "score", "score_mean", "success_rate", "gate_progress")]
        if self.scores["score_strict"] is not None:
            judges.insert(0, ("strict", "score_strict", "strict_score_mean", "strict_success_rate", "strict_progress"))
        lines = [" " * 30 + "".join(f" {' ' + judge + ' ':-^26}" for judge, *_ in judges)]
        header = f"{'task':<30}" + f" {'score':>7} {'success':>8} {'progress':>9}" * len(judges)
        lines.append(header + f" {'broken':>7} {'dropped':>8} {'steps':>7}")
        lines.append("-" * len(lines[-1]))
        for row in (*self.scores["subtasks"], *self.scores["extra_tasks"]):
            line = f"{row['id'] + ' ' + row['name']:<30}"
            for _, _, score, success, progress in judges:
                line += f" {row[score]:>7.3f} {row[success]:>8.2f} {row[progress]:>9.3f}"
            lines.append(line + f" {row['broken_rate']:>7.2f} {row['dropped_rate']:>8.2f} {row['mean_steps']:>7.0f}")
        for judge, name, *_ in judges:
            score = self.scores[name]
            if score["mean"] is not None:
                spread = "" if score["std"] is None else f" +- {score['std']:.4f} over seeds"
                lines.append(f"score S, {judge}: {score['mean']:.4f}{spread}, {self._coverage(score)}")
        if self.scores["missing"]:
            lines.append("missing: " + ", ".join(self.scores["missing"]))
        return "\n".join(lines)

    def _coverage(self, score: dict[str, Any]) -> str:
        """The number of subtasks that S is over, in the words of the program's table."""
        counted, missing = score["subtasks"], len(self.scores["missing"])
        if counted < len(SUBTASKS):
            rest = ": not comparable"
        else:
            rest = f", {missing} of them not registered and 0" if self.is_run and missing else ""
        return f"over {counted} of {len(SUBTASKS)} subtasks{rest}"


@spelt_out(Settings)
def evaluate(
    policy: PolicyLike,
    tasks: Sequence[str] = SUBTASKS,
    seeds: Sequence[int] | str = (0, 1, 2, 3),
    *,
    out: str | PathLike[str] | None = None,
    bags: BagForm | None = None,
    parallel: int | None = None,
    name: str | None = None,
    observation: ObservationForm = "dict",
    record: Sequence[str] = (),
    max_steps: int | None = None,
    assets: Mapping[str, str | PathLike[str]] | None = None,
    part: str | None = None,
    shard: str | None = None,
    run_file: str | PathLike[str] | None = None,
    progress: Callable[[dict[str, Any]], None] | None = None,
    **settings: "Unpack[Settings]",
) -> Evaluation:
    """Plays a policy through tasks and seeds, one episode for each pair: by default the 48 episodes of the benchmark.

    For the same actions, the rows and digests are those of the program ``fiatlux evaluate``.

    Args:
        policy: See :data:`fiatlux.PolicyLike`.
        tasks: Short ids of the tasks.
        seeds: Seeds of the benchmark; every task is played under each. ``"fresh:64"`` draws 64 rooms that nobody has seen; with
            ``out`` they are kept in ``out/seeds.txt``, and the same call goes on with them.
        out: Folder for bags, ``results.json`` and ``report.html``. Episodes then go through a server and a client in this
            process, as in the program; the same call resumes an evaluation that was stopped.
        bags: ``"full"``, or ``"thin"``: actions and result alone, a tenth of the size or less; rows are simulated again when they are
            read. Only with ``out``; by default full.
        parallel: Episodes to play at once, only with ``out``. See :meth:`fiatlux.Client.evaluate`.
        name: The policy's name, for the record.
        observation: Form of the observations.
        record: Sensors to record in the bags in addition to the small ones, such as ``"camera"``.
        assets: Objects in place of things of the room, by place, such as ``{"crate": "DIR"}``, where ``python -m fiatlux.assets build``
            wrote the folder; only with ``out``. Such evaluations are ranked apart.
        part: Subtask such as ``"S03"`` that the policy plays within the task ``replace``; the expert plays all else. The policy is reset
            where its subtask begins, and sees the sensors that it asks for. Only with ``out``, whose ``results.json`` says in ``parts``
            how often each subtask was reached and done. Such evaluations are never ranked.
        shard: Part of the episodes to play, such as ``"2/4"``: the second and every fourth after it; ``"auto"`` takes it from Slurm's
            array or Kubernetes' indexed Job. Each shard has its own ``out``, and all have one ``run_file``; ``scorer merge`` makes
            one result of them. In the scores of a shard by itself the others' episodes count as failures.
        run_file: File with the name and key of the recorded run, by default ``out/RUN.toml``. It is made if it does not exist.
        max_steps: Cuts episodes after this number of steps; the table cannot be compared with others then. Not with ``out``.
        progress: Called with the summary of each episode as it ends; with ``out``, a few times a second with a dictionary of
            counts.
        settings: See :class:`fiatlux.Settings`.
    """
    if isinstance(tasks, str):
        raise ValueError(f"tasks is {tasks!r}; give a list, [{tasks!r}]")
    check_policy(policy)
    if shard is not None and isinstance(seeds, str) and seeds.startswith("fresh"):
        raise ValueError("seeds: each shard would draw rooms of its own; give all of them the same rooms")
    seeds = seeds_of(seeds, record=None if out is None else Path(out) / "seeds.txt")
    chosen = settings_for(policy, settings)
    tasks = tasks_of(part, tasks)
    if out is not None:
        if max_steps is not None:
            raise ValueError("max_steps: a bag always holds a whole episode; drop either out or max_steps")
        if shard is not None and run_file is None:
            raise ValueError("shard: give all shards one run_file, so that they are parts of one run")
        objects = {place: fspath(folder) for place, folder in (assets or {}).items()}
        return _recorded(
            policy,
            tasks,
            seeds,
            Path(out),
            parallel,
            name,
            observation,
            record,
            progress,
            chosen,
            objects,
            shard,
            part,
            run_file,
            is_thin(bags),
        )
    recorded_only = {
        "bags": bags,
        "parallel": parallel,
        "record": record or None,
        "assets": assets or None,
        "shard": shard,
        "part": part,
    }
    for field, given in {**recorded_only, "run_file": run_file}.items():
        if given is not None:
            raise ValueError(f"{field}: only a recorded evaluation takes it; name a folder with out")
    wanted = [(task, seed) for task in tasks for seed in seeds]
    return collect(wanted, _played(policy, tasks, seeds, observation, max_steps, chosen), progress)


def collect(
    wanted: Sequence[tuple[str, int]],
    ended: Iterable[tuple[tuple[str, int], dict[str, Any]]],
    progress: Callable[[dict[str, Any]], None] | None,
) -> Evaluation:
    """Evaluates episodes, named by task and seed, from their summaries, which come as they end, in any order."""
    done: dict[tuple[str, int], dict[str, Any]] = {}
    for name, summary in ended:
        done[name] = summary
        if progress is not None:
            progress(summary)
    episodes = [done[name] for name in wanted]
    return Evaluation(_native.benchmark(episodes), episodes)


def _played(
    policy: PolicyLike,
    tasks: Sequence[str],
    seeds: Sequence[int],
    observation: ObservationForm,
    max_steps: int | None,
    settings: Mapping[str, Any],
) -> Iterator[tuple[tuple[str, int], dict[str, Any]]]:
    for task in tasks:
        env = Env(task, observation=observation, **settings)
        for seed in seeds:
            yield (task, seed), play(env, policy, seed, max_steps=max_steps)
        env.close()


def play(env: Env, policy: PolicyLike, seed: int, episode: int = 0, max_steps: int | None = None) -> dict[str, Any]:
    """Plays one episode, and returns its summary."""
    for _ in steps(env, policy, seed, episode, max_steps):
        pass
    return env.summary()


def steps(
    env: Env, policy: PolicyLike, seed: int, episode: int = 0, max_steps: int | None = None
) -> Iterator[tuple[Any, Any, float, bool, bool]]:
    """Plays one episode, and yields after each step: the policy's action, and observation, reward, terminated and truncated.
    First comes the reset state, without an action."""
    played: Any = policy() if isinstance(policy, type) else policy
    observed, _ = env.reset(seed=seed, options={"episode": episode})
    begin = getattr(played, "reset", None)
    if callable(begin):
        task = {"task": env.task.short_id, "instruction": env.task.instruction}
        begin({**task, "seed": seed, "episode": episode, "expert": ShownExpert(env)})
    yield None, observed, 0.0, False, False
    taken, ended = 0, False
    look = getattr(played, "look", None) if env.looks else None
    while not ended and (max_steps is None or taken < max_steps):
        # An episode begins with a look.
        if callable(look) and taken and (names := look(observed)):
            observed = env.look(names)
        action = played(observed)
        observed, reward, terminated, truncated, _ = env.step(action)
        yield action, observed, reward, terminated, truncated
        taken, ended = taken + 1, terminated or truncated


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
    assets: Mapping[str, str],
    shard: str | None,
    part: str | None,
    run_file: str | PathLike[str] | None,
    thin: bool,
) -> Evaluation:
    if len(tasks) == 0 or len(seeds) == 0:
        raise ValueError("tasks and seeds: give at least one each")
    asked = complete(part or (tasks[0] if len(tasks) == 1 else None), observation, settings)
    run = run_of(policy, tasks, seeds, parallel, name, out / "RUN.toml" if run_file is None else run_file)
    run |= {"record": list(record), "shard": shard, "part": part}
    # A policy may be made even if nothing is left to play.
    begun = Event()
    play_one = lambda: Player(policy, observation, begun)
    text, lost = _native.evaluate_into(fspath(out), play_one, run, asked, list(assets.items()), thin, False, progress)
    if not begun.is_set() and not lost:
        message = f"{out} had all episodes already, so none was played; name another folder for a new evaluation"
        warnings.warn(message, stacklevel=3)
    return of_results(text, lost)


def of_results(text: str, lost: Iterable[str]) -> Evaluation:
    """The evaluation of a recorded run, from the text of its ``results.json``."""
    results = json.loads(text)
    return Evaluation({name: results[name] for name in SCORES}, results["episodes"], tuple(lost), is_run=True)


def is_thin(bags: BagForm | None) -> bool:
    """Reads the form of the bags."""
    if bags not in (None, "full", "thin"):
        raise ValueError(f"bags is {bags!r}; use 'full' or 'thin'")
    return bags == "thin"
