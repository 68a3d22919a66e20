"""Evaluation and rollouts over a Ray cluster; needs the extra ``ray``.

Each episode, or each shard of a recorded evaluation, is a Ray task, which runs on a free core of any node, and is repeated on another
node if its own is lost. An episode depends only on task, seed, episode and policy, so the results are those of :func:`fiatlux.evaluate` in one process, on any nodes.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from os import PathLike, fspath
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from . import _native
from ._extras import missing
from ._native import FiatluxError
from ._numbers import seeds_of
from .client import run_of
from .env import Env
from .evaluation import BagForm, Evaluation, collect, is_thin, of_results, play, steps
from .policy import Player, PolicyLike, check_policy, is_stateful, settings_for
from .settings import Settings, complete, spelt_out
from .spaces import ObservationForm
from .tasks import SUBTASKS

try:
    import ray
except ImportError as error:
    raise missing("fiatlux.ray", "ray", error) from error

if TYPE_CHECKING:
    from typing_extensions import Unpack

LOST_NODES = 3
"""Number of times that an episode is restarted after its node was lost."""


@spelt_out(Settings)
def evaluate(
    policy: PolicyLike,
    tasks: Sequence[str] = SUBTASKS,
    seeds: Sequence[int] | str = (0, 1, 2, 3),
    *,
    out: str | PathLike[str] | None = None,
    shard_size: int = 4,
    bags: BagForm | None = None,
    name: str | None = None,
    record: Sequence[str] = (),
    observation: ObservationForm = "dict",
    max_steps: int | None = None,
    progress: Callable[[dict[str, Any]], None] | None = None,
    num_cpus: float = 1,
    num_gpus: float = 0,
    **settings: "Unpack[Settings]",
) -> Evaluation:
    """Like :func:`fiatlux.evaluate`, on the cluster that ``ray.init`` has joined. Ctrl-C, and an exception of ``progress``, end all work
    on the cluster; so does one of the policy without ``out``.

    With ``out`` it makes the same folder and the same result, and the same call goes on with what is left. An episode that cannot be
    played is a line in ``lost``, and the others stay. The nodes need no common disk: bags come to the caller through Ray, which keeps
    those of one task in memory. ``bags="thin"`` makes them small.

    Args:
        policy: Pickled and sent to each node once; each episode, or with ``out`` each shard, begins with a fresh copy of it.
        tasks, seeds, observation, max_steps, settings: As in :func:`fiatlux.evaluate`.
        out, name, record, bags: As there. ``out`` is a folder of the caller.
        shard_size: Episodes that one Ray task plays, only with ``out``. A lost node costs the episodes of its tasks.
        progress: Called with the summary of each episode as it ends, in any order; with ``out`` after each shard with a dictionary of
            the number of ``shards``, and of those that are ``done``.
        num_cpus, num_gpus: What an episode, or a shard, needs on its node.
    """
    check_policy(policy)
    chosen = settings_for(policy, settings)
    if out is not None:
        if max_steps is not None:
            raise ValueError("max_steps: a bag always holds a whole episode; drop either out or max_steps")
        recorded = _Recorded(
            policy, tasks, seeds, Path(out), name, record, bags, observation, chosen, shard_size, num_cpus
        )
        return recorded.play(policy, _shard.options(num_cpus=num_cpus, num_gpus=num_gpus), progress)
    for field, given in {"name": name, "record": record or None, "bags": bags}.items():
        if given is not None:
            raise ValueError(f"{field}: only a recorded evaluation takes it; name a folder with out")
    jobs = [(task, seed) for task in tasks for seed in seeds_of(seeds)]
    remote = _episode.options(num_cpus=num_cpus, num_gpus=num_gpus)
    shared = ray.put(policy)
    running = {remote.remote(shared, task, seed, observation, max_steps, chosen): (task, seed) for task, seed in jobs}
    with _ended(running):
        return collect(jobs, _as_they_end(running), progress)


class _Recorded:
    """A recorded evaluation, whose shards are tasks of Ray."""

    def __init__(
        self,
        policy: PolicyLike,
        tasks: Sequence[str],
        seeds: Sequence[int] | str,
        out: Path,
        name: str | None,
        record: Sequence[str],
        bags: BagForm | None,
        observation: ObservationForm,
        chosen: dict[str, Any],
        shard_size: int,
        num_cpus: float,
    ) -> None:
        if isinstance(tasks, str):
            raise ValueError(f"tasks is {tasks!r}; give a list, [{tasks!r}]")
        if shard_size < 1:
            raise ValueError(f"shard_size is {shard_size}; a shard has at least 1 episode")
        listed = seeds_of(seeds, record=out / "seeds.txt")
        if len(tasks) == 0 or len(listed) == 0:
            raise ValueError("tasks and seeds: give at least one each")
        self.out, self.count = out, -(-len(tasks) * len(listed) // shard_size)
        asked = complete(tasks[0] if len(tasks) == 1 else None, observation, chosen)
        out.mkdir(parents=True, exist_ok=True)
        parallel = 1 if is_stateful(policy) else max(1, int(num_cpus))
        run = {**run_of(policy, tasks, listed, parallel, name, out / "RUN.toml"), "record": list(record)}
        self.asked, self.run, self.thin, self.observation = asked, run, is_thin(bags), observation
        self.name = _native.begin_run(run, asked)
        self.folder = out / "runs" / self.name
        self.left = _native.shards_left(fspath(self.folder), self.count)

    def play(self, policy: PolicyLike, remote: Any, progress: Callable[[dict[str, Any]], None] | None) -> Evaluation:
        shared = ray.put(policy)
        common = (shared, self.run, self.asked, self.thin, self.observation, (self.out / "RUN.toml").read_text())
        running = {remote.remote(*common, self.name, f"{k}/{self.count}", self._files(k)): k for k in self.left}
        lost: dict[int, list[str]] = {}
        done = self.count - len(self.left)
        with _ended(running):
            left = dict(running)
            while left:
                (ended,), _ = ray.wait(list(left), num_returns=1)
                shard = left.pop(ended)
                try:
                    files, lost[shard] = ray.get(ended)
                    self._keep(files)
                except ray.exceptions.RayError as error:
                    lost[shard] = [f"shard {shard}/{self.count}: {_said(error)}"]
                done += 1
                if progress is not None:
                    progress({"shards": self.count, "done": done})
        lines = [line for shard in sorted(lost) for line in lost[shard]]
        if not self.folder.is_dir():
            raise FiatluxError("no episode was recorded:\n  " + "\n  ".join(lines))
        text, excluded = _native.grade_run(fspath(self.out), self.name)
        return of_results(text, [*lines, *(line for line in excluded if line not in lines)])

    def _files(self, shard: int) -> dict[str, bytes]:
        """The files of a shard that was not played to its end."""
        server = f"evaluate-{shard}of{self.count}"
        found = [*self.folder.glob(f"{server}-*.mcap"), *self.folder.glob(f"{server}.*")]
        return {path.name: path.read_bytes() for path in found}

    def _keep(self, files: dict[str, bytes]) -> None:
        self.folder.mkdir(parents=True, exist_ok=True)
        # A journal names bags: it comes after them.
        for name in sorted(files, key=lambda name: not name.endswith(".mcap")):
            part = self.folder / f".{name}.new"
            part.write_bytes(files[name])
            part.replace(self.folder / name)


def _said(error: BaseException) -> str:
    """The last line of an error: Ray's begin with the node's traceback."""
    lines = str(error).strip().splitlines() or [""]
    return f"{type(error).__name__}: {lines[-1].strip()}"


@spelt_out(Settings)
def rollouts(
    policy: PolicyLike,
    task: str,
    seeds: Sequence[int],
    *,
    max_steps: int | None = None,
    num_cpus: float = 1,
    num_gpus: float = 0,
    **settings: "Unpack[Settings]",
) -> Iterator[dict[str, Any]]:
    """Plays an episode for each seed, and yields each as arrays, in the order of the seeds.

    An episode has ``observations`` (flat vectors, one more than steps), ``actions``, ``rewards``, ``terminated`` and
    ``truncated`` of its last step, and its ``summary``. The arguments are as in :func:`evaluate`.
    """
    remote = _rollout.options(num_cpus=num_cpus, num_gpus=num_gpus)
    shared = ray.put(policy)
    chosen = settings_for(policy, settings)
    running = [remote.remote(shared, task, seed, max_steps, chosen) for seed in seeds_of(seeds)]
    with _ended(running):
        for reference in running:
            yield ray.get(reference)


@spelt_out(Settings)
def rollout(
    policy: PolicyLike, task: str, seed: int, max_steps: int | None = None, **settings: "Unpack[Settings]"
) -> dict[str, Any]:
    """Plays one episode of :func:`rollouts` in this process."""
    env = Env(task, observation="flat", **settings)
    actions, observations, rewards, terminated, truncated = zip(*steps(env, policy, seed, max_steps=max_steps))
    return {
        "observations": np.stack(observations),
        "actions": np.stack(actions[1:]) if actions[1:] else np.empty((0, *(env.action_space.shape or ()))),
        "rewards": np.array(rewards[1:]),
        "terminated": terminated[-1],
        "truncated": truncated[-1],
        "summary": env.summary(),
    }


@ray.remote(max_retries=LOST_NODES)
def _episode(
    policy: PolicyLike, task: str, seed: int, observation: ObservationForm, max_steps: int | None, settings: Any
) -> dict[str, Any]:
    return play(Env(task, observation=observation, **settings), policy, seed, max_steps=max_steps)


@ray.remote(max_retries=LOST_NODES)
def _shard(
    policy: PolicyLike,
    run: dict[str, Any],
    asked: dict[str, Any],
    thin: bool,
    observation: ObservationForm,
    run_file: str,
    name: str,
    shard: str,
    files: dict[str, bytes],
) -> tuple[dict[str, bytes], list[str]]:
    """Plays a shard, or what is left of it, in a folder of this node; returns the files of its run, and what is lost."""
    with TemporaryDirectory(prefix="fiatlux-shard-") as place:
        folder = Path(place, "runs", name)
        folder.mkdir(parents=True)
        for file, data in files.items():
            (folder / file).write_bytes(data)
        own = Path(place, "RUN.toml")
        own.write_text(run_file)
        own.chmod(0o600)
        here = {**run, "run_file": fspath(own), "shard": shard}
        _, lost = _native.evaluate_into(place, lambda: Player(policy, observation), here, asked, [], thin, True, None)
        made = [path for path in folder.iterdir() if path.suffix in (".mcap", ".jsonl")]
        return {path.name: path.read_bytes() for path in made}, lost


@ray.remote(max_retries=LOST_NODES)
def _rollout(policy: PolicyLike, task: str, seed: int, max_steps: int | None, settings: Any) -> dict[str, Any]:
    return rollout(policy, task, seed, max_steps, **settings)


@contextmanager
def _ended(running: Iterable[Any]) -> Iterator[None]:
    """Work that its caller no longer waits for ends: after Ctrl-C, an exception, or a rollout that nobody reads to its end."""
    try:
        yield
    except BaseException:
        for reference in list(running):
            ray.cancel(reference, force=True)
        raise


def _as_they_end(running: dict[Any, tuple[str, int]]) -> Iterator[tuple[tuple[str, int], dict[str, Any]]]:
    left = dict(running)
    while left:
        ended, _ = ray.wait(list(left), num_returns=1)
        for reference in ended:
            yield left.pop(reference), ray.get(reference)
