"""Plays policies on servers over Zenoh."""

import warnings
from collections.abc import Callable, Sequence
from os import PathLike, fspath
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Any

from . import _native
from ._numbers import seed_of, seeds_of
from .fingerprint import digest_of
from .policy import Player, PolicyLike, check_policy, is_stateful, name_of, settings_for
from .settings import Settings, complete, spelt_out
from .spaces import ObservationForm
from .tasks import SUBTASKS

if TYPE_CHECKING:
    from typing_extensions import Unpack


class Client:
    """A link to one server, or to several.

    Waiting for a server and playing release the interpreter's lock, and Ctrl-C stops them. The policy is called in another
    thread than the caller's.

    Args:
        endpoint: Address of the server, such as ``"tcp/192.168.1.7:7447"``; several may be given as a list. By default that of
            ``config``, or ``"tcp/127.0.0.1:7447"``.
        config: A Zenoh config file, the same as for the programs; it names the certificates of an encrypted link.
        token: File with the token by which a server lets this client open sessions.
        server_key: Key that the server must have, ``"ed25519:BASE64"`` as it prints it.
        known_servers: File with the keys of known servers; other servers are refused.

    Raises:
        ValueError: The endpoint or the key is not a valid one, or a file cannot be read.
        ConnectionError: Nobody answers at the endpoint.
    """

    def __init__(
        self,
        endpoint: str | Sequence[str] | None = None,
        *,
        config: str | PathLike[str] | None = None,
        token: str | PathLike[str] | None = None,
        server_key: str | None = None,
        known_servers: str | PathLike[str] | None = None,
    ) -> None:
        if endpoint is None:
            endpoint = "tcp/127.0.0.1:7447" if config is None else ()
        if server_key is not None and known_servers is not None:
            raise ValueError("server_key and known_servers: give one of them")
        endpoints = [endpoint] if isinstance(endpoint, str) else list(endpoint)
        files = [None if file is None else fspath(file) for file in (config, token, known_servers)]
        self._link = ", ".join(endpoints) or fspath(config or "")
        self._client = _native.Client(endpoints, files[0], files[1], server_key, files[2])

    def __repr__(self) -> str:
        return f"<fiatlux.Client of {self._link}>"

    @spelt_out(Settings)
    def run(
        self,
        policy: PolicyLike,
        task: str,
        seed: int = 0,
        episode: int = 0,
        *,
        server: str | None = None,
        name: str | None = None,
        observation: ObservationForm = "dict",
        record: Sequence[str] = (),
        **settings: "Unpack[Settings]",
    ) -> dict[str, Any]:
        """Plays one episode, and returns how it ended; ``state_digest`` is the digest of its rows.

        Args:
            policy: See :data:`fiatlux.PolicyLike`.
            task: Short id or environment id.
            seed, episode: Seed of the room, and index of the episode.
            server: Name of the server; not needed if there is only one.
            name: The policy's name, for the record.
            observation: Form of the observations.
            record: Sensors to record in the bag, such as ``"camera"``; the episode then waits for a recorder.
            settings: See :class:`fiatlux.Settings`.
        """
        check_policy(policy)
        asked = complete(task, observation, settings_for(policy, settings))
        player = Player(policy, observation)
        place = (task, seed_of(seed), seed_of(episode, "episode"))
        return self._client.run(player, name or name_of(policy), server, *place, asked, list(record))

    @spelt_out(Settings)
    def evaluate(
        self,
        policy: PolicyLike,
        tasks: Sequence[str] = SUBTASKS,
        seeds: Sequence[int] | str = (0, 1, 2, 3),
        *,
        parallel: int | None = None,
        hosted_seeds: int = 0,
        part: str | None = None,
        server: str | None = None,
        name: str | None = None,
        version: str = "",
        link: str = "",
        run_file: str | PathLike[str] = "RUN.toml",
        patience_s: float = 60.0,
        observation: ObservationForm = "dict",
        record: Sequence[str] = (),
        progress: Callable[[dict[str, Any]], None] | None = None,
        **settings: "Unpack[Settings]",
    ) -> dict[str, Any]:
        """Plays a whole run; called again with the same run file and arguments, it resumes the run.

        The server records the run and keeps its score. The result has the name of the ``run``, whether it is ``finished``, the
        ``servers`` that took part, the ``protocol`` whose judge says what ``success`` is, and its ``episodes``, each with its
        ``fate``: ``"played"``, ``"failed"``, or ``"lost"``, which the next call plays. A run that was finished before plays
        nothing, and a warning says so.

        Args:
            policy: See :data:`fiatlux.PolicyLike`. It must be deterministic: an episode that was cut off is played again.
            tasks, seeds: Every task is played once under every seed. ``"fresh:64"`` draws 64 rooms that nobody has seen, and keeps
                them next to the run file.
            parallel: Episodes to play at once; by default as many as the servers allow. A policy object with ``reset`` plays
                one at a time: give its class to play several.
            hosted_seeds: Number of seeds that the server draws, instead of ``seeds``.
            part: Subtask of the errand that the policy plays, such as ``"S03"``, as in :func:`fiatlux.evaluate`.
            server: Name of the server, or of a group: ``lab`` stands for ``lab``, ``lab-1`` and so on.
            name, version, link: Name, version and web page of the policy, for the record.
            run_file: File with the run's name and secret key, and a digest of the policy's code and weights
                (:func:`fiatlux.fingerprint.digest_of`); it is created if it does not exist. The file of another policy is refused.
            patience_s: How long to wait for servers that are gone, s.
            observation, record: As in :meth:`run`.
            progress: Called a few times a second with a dictionary of counts.
            settings: See :class:`fiatlux.Settings`.
        """
        check_policy(policy)
        asked = complete(part, observation, settings_for(policy, settings))
        drawn = () if hosted_seeds else seeds_of(seeds, record=Path(run_file).with_suffix(".seeds"))
        run = {
            **run_of(policy, tasks_of(part, tasks), drawn, parallel, name, run_file),
            "part": part,
            "version": version,
            "link": link,
            "hosted_seeds": hosted_seeds,
            "server": server,
            "record": list(record),
            "patience_s": patience_s,
        }
        # A policy is made even if nothing is left to play.
        begun = Event()
        outcome = self._client.evaluate(lambda: Player(policy, observation, begun), run, asked, progress)
        if outcome["finished"] and not begun.is_set():
            message = f"the run {outcome['run']} was finished already, so nothing was played; name another run_file for a new run"
            warnings.warn(f"{fspath(run_file)}: {message}", stacklevel=2)
        return outcome


def run_of(
    policy: PolicyLike,
    tasks: Sequence[str],
    seeds: Sequence[int],
    parallel: int | None,
    name: str | None,
    run_file: str | PathLike[str],
) -> dict[str, Any]:
    """A run in the form that the native part takes, with defaults for what is not given."""
    if is_stateful(policy):
        if parallel not in (None, 1):
            raise ValueError(
                f"parallel is {parallel}, but one policy object with a method reset cannot play several episodes at once; "
                "give its class, so that each episode has its own"
            )
        parallel = 1
    return {
        "name": name or name_of(policy),
        "digest": digest_of(policy),
        "version": "",
        "link": "",
        "tasks": list(tasks),
        "seeds": seeds_of(seeds),
        "hosted_seeds": 0,
        "server": None,
        "parallel": parallel,
        "run_file": fspath(run_file),
        "record": [],
        "patience_s": 60.0,
        "shard": None,
        "part": None,
    }


def tasks_of(part: str | None, tasks: Sequence[str]) -> Sequence[str]:
    """The tasks to play: a part of the errand is played in the errand alone."""
    if part is None or list(tasks) == ["replace"]:
        return tasks
    if tuple(tasks) != SUBTASKS:
        raise ValueError(f"part: a part of the errand is played in the task replace, not in {', '.join(tasks)}")
    return ("replace",)
