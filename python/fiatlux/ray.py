"""Evaluation and rollouts over a Ray cluster; needs the extra ``ray``.

Each episode is a Ray task, which runs on a free core of any node, and is repeated on another node if its own is lost. An episode
depends only on task, seed, episode and policy, so the results are those of :func:`fiatlux.evaluate` in one process, on any nodes.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
import ray

from ._numbers import seeds_of
from .env import Env
from .evaluation import Evaluation, collect, play, steps
from .policy import PolicyLike, check_policy, settings_for
from .settings import Settings
from .spaces import ObservationForm
from .tasks import SUBTASKS

if TYPE_CHECKING:
    from typing_extensions import Unpack

LOST_NODES = 3
"""Number of times that an episode is restarted after its node was lost."""


def evaluate(
    policy: PolicyLike,
    tasks: Sequence[str] = SUBTASKS,
    seeds: Sequence[int] = (0, 1, 2, 3),
    *,
    observation: ObservationForm = "dict",
    max_steps: int | None = None,
    progress: Callable[[dict[str, Any]], None] | None = None,
    num_cpus: float = 1,
    num_gpus: float = 0,
    **settings: "Unpack[Settings]",
) -> Evaluation:
    """Like :func:`fiatlux.evaluate` without bags, on the cluster that ``ray.init`` has joined. Ctrl-C, and an exception of the policy or
    of ``progress``, end all work on the cluster.

    Args:
        policy: Pickled and sent to each node once; each episode begins with a fresh copy of it.
        tasks, seeds, observation, max_steps, settings: As in :func:`fiatlux.evaluate`.
        progress: Called with the summary of each episode as it ends, in any order.
        num_cpus, num_gpus: What an episode needs on its node.
    """
    jobs = [(task, seed) for task in tasks for seed in seeds_of(seeds)]
    check_policy(policy)
    remote = _episode.options(num_cpus=num_cpus, num_gpus=num_gpus)
    shared = ray.put(policy)
    chosen = settings_for(policy, settings)
    running = {remote.remote(shared, task, seed, observation, max_steps, chosen): (task, seed) for task, seed in jobs}
    with _ended(running):
        return collect(jobs, _as_they_end(running), progress)


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
