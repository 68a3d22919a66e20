"""Steps many worlds in one call, for training."""

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Literal, TypedDict

import numpy as np
from gymnasium.error import ClosedEnvironmentError, ResetNeeded
from gymnasium.vector import AutoresetMode
from gymnasium.vector import VectorEnv as Base
from numpy.typing import NDArray

from . import _native
from ._memory import check_memory
from ._numbers import MAX_SEED, real, seed_of, seeds_of, size_of, whole
from ._pictures import Picture, picture
from .env import check_camera, in_force
from .kinematics import Contacts
from .settings import (
    EpisodeSettings,
    Gains,
    RenderMode,
    Robot,
    Sensor,
    by_preset,
    complete,
    names_of,
    refuse_argument,
    spelt_out,
)
from .spaces import Layout, ObservationForm, as_actions, batched, joint_groups

if TYPE_CHECKING:
    from typing_extensions import Unpack


ROOMS = range(1000, 1016)
"""Rooms of the benchmark's seeds over which worlds are spread by default."""

EPISODES = 4
"""Starts in each room by default."""


def _autoreset(mode: AutoresetMode | str) -> AutoresetMode:
    """A mode of Gymnasium's by its value or its name, such as ``"next_step"``."""
    known = {mode.name: mode for mode in AutoresetMode} | {mode.value: mode for mode in AutoresetMode}
    found = known.get(mode.upper(), known.get(mode)) if isinstance(mode, str) else mode
    if not isinstance(found, AutoresetMode):
        names = ", ".join(repr(mode.name.lower()) for mode in AutoresetMode)
        raise ValueError(f"autoreset_mode is {mode!r}; known ones are {names}")
    return found


Autoreset = Literal["next_step", "same_step", "disabled", "NextStep", "SameStep", "Disabled"]
"""A mode of Gymnasium's, by its name or its value."""

Judgement = Callable[[Any, dict[str, Any]], tuple[Any, Any]]
"""A reward and an end of one's own over all worlds: from an observation and ``info`` to the rewards and to whether each episode ends.
Either may be ``None``, for what the task says."""


class SharedSettings(TypedDict, total=False):
    """Arguments that all vectors of worlds take; all are optional.

    Attributes:
        num_threads: Number of threads; by default one for each core that the process may use, by its affinity and by a
            container's limit of processors. Results do not depend on it.
        seed: Seed of the worlds' random streams.
        observation: Form of the observation, see :data:`fiatlux.spaces.ObservationForm`.
        ranges: What varies between worlds, such as ``{"robot_mass": (0.9, 1.1), "hand_friction": (0.6, 1.2)}``, by the names of
            :class:`fiatlux.Settings` and with their meaning: ``gravity``, ``floor_friction``, ``hand_friction``, ``robot_mass``,
            ``gains``, ``friction``, ``thing_mass``, ``preset``, and, in the benchmark's tasks, ``action_delay``, ``noise`` and
            ``camera``, drawn for each episode. Vectors alone draw for each of the robot's bodies the factor ``mass`` and the shift
            ``com_shift_m`` (the largest, m), for each drive the factors ``stiffness``, ``damping`` and ``effort_limit``, and
            ``light`` (true: it is drawn). :meth:`VectorEnv.drawn` has what was drawn.
        variations: Number of variations drawn for each start.
        disturbances: ``{"pushes": {"interval_s", "linear", "angular"}, "wrenches": {"link", "interval_s", "duration_s",
            "force_n", "torque_nm"}}``; missing keys have defaults.
        links: Sites and links, by the names of :attr:`Kinematics.sites`, whose poses and velocities are observed: field
            ``privileged.links`` has for each position, quaternion, velocity and angular velocity.
        forces: Whether the forces that rows measure are observed, N: fields such as ``privileged.floor_force`` and
            ``privileged.ladder_force``, on left and right foot, left and right palm.
        contacts: Whether worlds keep the contact points of their last step, for :meth:`VectorEnv.contacts`.
        copy: Whether returned arrays are copies; otherwise the next step overwrites them.
        final_obs: Whether to observe the last row of each episode too; only ``SAME_STEP`` needs it.
        autoreset_mode: When the next episode of a world begins: ``"same_step"``, ``"next_step"`` or ``"disabled"``, or
            Gymnasium's ``AutoresetMode``. Gymnasium's vector observation wrappers need ``"next_step"``.
        judge: A reward and an end of your own: called after each step with the observation that it led to, before any episode begins
            anew, and with ``info``; returns rewards and ends.
        render_mode, render_size, render_camera: As of :class:`fiatlux.Env`, for :meth:`VectorEnv.render`.
    """

    num_threads: int | None
    seed: int
    observation: ObservationForm
    ranges: Mapping[str, Any] | str | None
    variations: int
    disturbances: Mapping[str, Any] | None
    links: Sequence[str]
    forces: bool
    contacts: bool
    copy: bool
    final_obs: bool
    autoreset_mode: AutoresetMode | Autoreset
    judge: Judgement | None
    render_mode: RenderMode | None
    render_size: tuple[int, int]
    render_camera: str | None


class VectorSettings(SharedSettings, EpisodeSettings, total=False):
    """All optional arguments of :class:`VectorEnv` that another class has too."""


_SHARED: dict[str, Any] = {
    "num_threads": None,
    "seed": 0,
    "observation": "flat",
    "ranges": None,
    "variations": 64,
    "disturbances": None,
    "links": (),
    "forces": False,
    "contacts": False,
    "copy": True,
    "final_obs": True,
    "autoreset_mode": AutoresetMode.SAME_STEP,
    "judge": None,
    "render_mode": None,
    "render_size": (640, 480),
    "render_camera": None,
}


_WORLD_BYTES = 36_000
"""A world takes somewhat more than that, without its observations."""


def _check_memory(worlds: int, numbers: int | None = None) -> None:
    """Raises MemoryError where a limit is sure to end the process; with a number of observations, for these alone."""
    check_memory(
        worlds * (_WORLD_BYTES if numbers is None else 4 * numbers), f"num_envs: no memory for {worlds} worlds"
    )


def _native_settings(num_envs: int, shared: Mapping[str, Any]) -> dict[str, Any]:
    """The shared settings in the form that the native part takes; without a number of threads, one for each core."""
    threads, links = shared["num_threads"], shared["links"]
    if threads is None:
        threads = _native.available_threads()
    if isinstance(links, str):
        raise ValueError(f"links is {links!r}; give a list of names")
    return {
        "worlds": whole("num_envs", num_envs, 1, _native.MAX_WORLDS),
        "threads": whole("num_threads", threads, 1, _native.MAX_THREADS),
        "seed": seed_of(shared["seed"]),
        "autoreset": _autoreset(shared["autoreset_mode"]).value,
        "ranges": by_preset(shared["ranges"]),
        "variations": whole("variations", shared["variations"], 1, _native.MAX_STARTS),
        "disturbances": None if shared["disturbances"] is None else dict(shared["disturbances"]),
        "links": list(links),
        "forces": bool(shared["forces"]),
        "contacts": bool(shared["contacts"]),
    }


@dataclass(frozen=True)
class Rollout:
    """Results of :meth:`VectorEnv.rollout`; the first axis is that of steps, the next one that of worlds."""

    observation: Any
    """Of the last step, without the axis of steps; of each step with ``observations=True``."""
    reward: NDArray[np.float32]
    reward_terms: NDArray[np.float32]
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    success: NDArray[np.bool_]


@dataclass(frozen=True)
class Start:
    """Where episodes begin, for :class:`VectorEnv`.

    Args:
        task: Task whose starts these are; by default the one that is played. It must share the scene: S02 to S12 do.
        rows: States to begin at, as :meth:`VectorEnv.row` or :meth:`Bag.row` returns them, or parts of such; what is missing is as in
            the task's start. Without rows, the task's own starts.
        seed: Room of these starts, one of the vector's; by default all rooms. Rows of a recorded episode belong to its own room.
        weight: How likely they are, all together.
    """

    task: str | None = None
    rows: Sequence[Mapping[str, Any]] | None = None
    seed: int | None = None
    weight: float = 1.0


def _expanded(task: str, rooms: Sequence[int], episodes: int, starts: Sequence[Start]) -> list[Any]:
    """Each single start: task, room, episode, weight, and parts of its row."""
    if not len(starts):
        raise ValueError("starts is empty; leave it out for the task's own starts")
    expanded: list[Any] = []
    for start in starts:
        if not isinstance(start, Start):
            raise ValueError(f"starts has {start!r}; give a list of fiatlux.Start")
        if start.seed is not None and start.seed not in rooms:
            raise ValueError(f"starts: seed is {start.seed}, but the rooms are {', '.join(map(str, rooms))}")
        if start.rows is not None and not len(start.rows):
            raise ValueError("starts: rows is empty; leave it out for the task's own starts")
        own = [(episode, None) for episode in range(episodes)]
        rows = [(0, _plain(row)) for row in start.rows or ()] or own
        of, weight = start.task or task, float(start.weight) / len(rows)
        for room in rooms if start.seed is None else [start.seed]:
            expanded += [(of, room, episode, weight, parts) for episode, parts in rows]
    return expanded


def _plain(row: Mapping[str, Any]) -> dict[str, list[float]]:
    return {name: [float(number) for number in numbers] for name, numbers in row.items() if name != "step"}


class _Done:
    """Takes note of a native call that was done, even if Ctrl-C is raised as it returns; a call that was refused changed nothing."""

    def __init__(self, note: Callable[..., None], *arguments: Any) -> None:
        self._note, self._arguments = note, arguments

    def __enter__(self) -> None: ...

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if kind is None or not issubclass(kind, Exception):
            self._note(*self._arguments)


class _Batch(Base[Any, NDArray[np.float32], NDArray[Any]]):
    """Base class of all vectors of worlds.

    By default the autoreset mode is ``SAME_STEP``: when an episode ends, the next one begins in the same step. The observation of
    that step is the first of the new episode; ``info["final_obs"]`` has the last one of the old episode for the worlds that
    ``info["_final_obs"]`` marks. The other modes are as Gymnasium defines them.

    A copy or a pickle is made from the same arguments and continues from the same state. Before the first :meth:`reset` or
    :meth:`restore` of all worlds, a step, a rollout and a picture raise Gymnasium's ``ResetNeeded``, while the worlds can be read
    and changed. Ctrl-C is raised when a call is done.
    """

    metadata: dict[str, Any] = {
        "autoreset_mode": AutoresetMode.SAME_STEP,
        "render_modes": ["rgb_array"],
        "render_fps": 50,
    }

    def __init__(self, kind: str, arguments: Sequence[Any], num_envs: int, given: Mapping[str, Any]) -> None:
        for name in given:
            if name not in _SHARED:
                refuse_argument(name, inspect.signature(type(self)).parameters)
        shared = {**_SHARED, **given}
        copy, judge = shared["copy"], shared["judge"]
        render_mode, camera = shared["render_mode"], shared["render_camera"]
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise ValueError(f"render_mode is {render_mode!r}; known ones are None, 'rgb_array'")
        self.render_mode = render_mode
        self._render_size, self._render_camera = size_of("render_size", shared["render_size"]), camera
        check_camera(camera, arguments[-1]["robot"])
        self._made_for = arguments[0] if kind == "rulebook" else kind
        native = _native_settings(num_envs, shared)
        _check_memory(native["worlds"])
        self._batch = batch = _native.Batch(kind, (*arguments, native))
        if judge is not None and not callable(judge):
            raise ValueError(f"judge is {judge!r}; give a function from observation and info to what it judges")
        self._judge: Judgement | None = judge
        self._has_contacts = bool(shared["contacts"])
        self.autoreset_mode = _autoreset(shared["autoreset_mode"])
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self.num_envs = batch.num_worlds
        self.num_threads = batch.num_threads
        self.horizon_steps: int = batch.spec["horizon_steps"]
        self._layout = layout = Layout(batch.spec, shared["observation"])
        self.copies = copy
        self.single_observation_space = layout.space
        self.single_action_space = layout.action_space
        self.observation_space = batched(layout.space, self.num_envs)
        self.action_space = batched(layout.action_space, self.num_envs)
        worlds, length = self.num_envs, layout.words
        _check_memory(worlds, length)
        self._observation = np.zeros((worlds, length), np.float32)
        has_final = (shared["final_obs"] or judge is not None) and self.autoreset_mode == AutoresetMode.SAME_STEP
        self._final = np.zeros((worlds, length), np.float32) if has_final else None
        self._is_fresh = copy and layout.has_pictures
        self._reward = np.zeros(worlds, np.float32)
        self._terms = np.zeros((worlds, len(layout.reward_terms)), np.float32)
        self._terminated, self._truncated, self._success = (np.zeros(worlds, np.bool_) for _ in range(3))
        self.reward_weights: dict[str, float] = dict(zip(layout.reward_terms, batch.spec["reward_weights"]))
        self._is_closed = self._begun = False
        # How often each world was put into another state than its own; who follows worlds looks at it.
        self._jumps = np.zeros(worlds, np.int64)

    def reset(
        self, *, seed: int | list[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begins an episode in every world; with a seed, everything after it is as in a new batch with that seed: each world draws its
        starts and all else from a stream of its own, which the seed and its number give. The rooms stay those of ``seeds``.

        ``options={"reset_mask": mask}``, a boolean array with a number for each world, resets the marked worlds alone. Without it,
        ``info["drawn"]`` is what :meth:`drawn` returns.
        """
        self._check_open()
        if isinstance(seed, (list, tuple, np.ndarray)):
            raise ValueError("seed: give one number for all worlds; each draws from a stream of its own")
        seed = None if seed is None else seed_of(seed)
        unknown = [name for name in options or {} if name != "reset_mask"]
        if unknown:
            raise ValueError(f"options has no {unknown[0]!r}; the one known key is 'reset_mask'")
        mask = (options or {}).get("reset_mask")
        marks = np.ones(self.num_envs, np.bool_) if mask is None else self._marks("reset_mask", mask)
        with _Done(self._jump, np.False_, mask is None):
            self._observe(lambda observation: self._batch.reset(marks, observation, seed))
        return self._layout.show(self._observation, self.copies), {"drawn": self.drawn()} if mask is None else {}

    def reset_worlds(self, mask: Any, like: int | Mapping[str, Any] | None = None) -> Any:
        """Begins an episode in the marked worlds, and returns the observation of all.

        ``like`` says where: without it, at a start of the world's own; with the number of a world, at the present row of that one;
        with a dictionary, at the marked world's own row with these parts in place of its own. The parts are those of :meth:`row`;
        each is one array for all worlds, or has a leading axis of worlds. Worlds that share a row share nothing else: each draws
        from its own stream, and mass, friction and light are those of one of its starts. What :meth:`copy_world` copies is exact.
        """
        self._check_open()
        marks = self._marks("mask", mask)
        world = parts = None
        if isinstance(like, Mapping):
            parts = {name: self._part(name, numbers) for name, numbers in like.items() if name != "step"}
        elif like is not None:
            world = whole("like", like, 0, self.num_envs - 1)
        self._observe(lambda observation: self._batch.reset(marks, observation, None, world, parts))
        return self._layout.show(self._observation, self.copies)

    def copy_world(self, world: int, worlds: Any) -> Any:
        """Lets the marked ``worlds`` continue exactly from the state of ``world``, and returns the observation of all.

        With the same actions they do what it does, to the last bit, from then on: a copy goes on with the same random stream, and its
        next episodes are the same too, until ``reset(seed=...)``. Worlds in another room are refused.
        """
        self._check_open()
        marks = self._marks("worlds", worlds)
        number = whole("world", world, 0, self.num_envs - 1)
        with _Done(self._jump, marks, False):
            self._observe(lambda observation: self._batch.copy_world(number, marks, observation))
        return self._layout.show(self._observation, self.copies)

    def terminate(self, mask: Any) -> Any:
        """Ends the episodes of the marked worlds; returns the observation of all. The next ones begin as the autoreset mode says: at
        once, in the next step, or with ``reset``."""
        self._check_open()
        marks = self._marks("mask", mask)
        self._observe(lambda observation: self._batch.end_episodes(marks, observation))
        return self._layout.show(self._observation, self.copies)

    def look(self, sensors: Sequence[Sensor | str], worlds: Any = None) -> Any:
        """Computes these sensors of the marked ``worlds`` (all by default) again, whatever their rate, and returns the observation of all,
        as :meth:`fiatlux.Env.look` does for one."""
        self._check_open()
        marks = np.ones(self.num_envs, np.bool_) if worlds is None else self._marks("worlds", worlds)
        names = names_of("sensors", sensors)
        self._observe(lambda observation: self._batch.look(names, marks, observation))
        return self._layout.show(self._observation, self.copies)

    def stagger(self, steps: Any = None) -> None:
        """Lets the present episode of each world end by time-out ``steps`` earlier, so that worlds which began together do not end
        together. Without a list of steps, they are drawn at random, the same ones in every vector of as many worlds.
        """
        self._check_open()
        if steps is None:
            steps = np.random.default_rng(0).integers(0, self.horizon_steps, self.num_envs)
        steps = [whole("steps", number, 0, MAX_SEED) for number in steps]
        if len(steps) != self.num_envs:
            raise ValueError(f"steps has {len(steps)} numbers; give one for each of {self.num_envs} worlds")
        self._batch.shorten_episodes(steps)

    def _observe(self, write: Callable[[NDArray[np.float32]], None]) -> None:
        """Lets the simulator write all observations. Pictures are returned as they lie there, so a vector that returns copies takes a new
        array each time; the old one stays where the simulator refuses."""
        observation = np.empty_like(self._observation) if self._is_fresh else self._observation
        with _Done(self._take, observation):
            write(observation)

    def _take(self, observation: NDArray[np.float32]) -> None:
        self._observation = observation

    def _jump(self, marks: NDArray[np.bool_] | np.bool_, begins: bool) -> None:
        """Takes note that the marked worlds are in another state than their own, and that all begin."""
        self._begun |= begins
        self._jumps += marks

    def _marks(self, name: str, mask: Any) -> NDArray[np.bool_]:
        """A boolean for each world, some of them true."""
        marks: NDArray[Any] = np.ascontiguousarray(mask)
        if marks.shape != (self.num_envs,) or marks.dtype != np.bool_ or not marks.any():
            found = f"shape {marks.shape}, {marks.dtype}"
            raise ValueError(f"{name}: {found}; give a boolean for each of {self.num_envs} worlds, some of them true")
        return marks

    def _part(self, name: str, numbers: Any) -> NDArray[np.float64]:
        """A part of a row as an array with an axis of worlds."""
        try:
            array = real(numbers)
        except (TypeError, ValueError) as error:
            raise ValueError(f"like: {name} cannot be read as numbers ({error})") from error
        if array.ndim == 1:
            array = np.broadcast_to(array, (self.num_envs, *array.shape))
        if array.ndim != 2 or len(array) != self.num_envs:
            raise ValueError(f"like: {name} has shape {array.shape}; give a list of numbers, or one for each world")
        return np.ascontiguousarray(array)

    def step(
        self, actions: Any
    ) -> tuple[Any, NDArray[np.float32], NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Takes a control step of 20 ms in every world.

        Actions count as ``float64``, as those of :class:`fiatlux.Env` do. ``info`` has ``reward_terms`` (worlds x terms, named by
        :attr:`reward_terms`), ``success``, and ``final_obs`` if any episode ended. Where a task of the benchmark ended by its judges or by
        time-out, ``info`` also has what :meth:`fiatlux.Env.step` says of the verdict, by the same names (``steps``, ``end``, ``strict_success``
        and so on): an array each. Its values count in the worlds that ``info["_end"]`` marks (``_steps`` and so on are the same).
        ``success`` is of the judge in force. Ctrl-C is raised when the step is done, and the next one can follow.
        """
        self._check_begun()
        array = as_actions(actions, self.action_space.shape or ())
        if self._final is not None and self._layout.has_pictures:
            # Memory that nobody has written to costs nothing, and few worlds end in a step.
            self._final = np.zeros(self._final.shape, np.float32)
        final, others = self._final, (self._reward, self._terms, self._terminated, self._truncated, self._success)
        own = np.copy if self.copies else np.asarray
        info: dict[str, Any] = {}
        # Worlds in which this step only begins the next episode.
        waited = np.array(self._batch.ended()) if self._judge is not None else None
        with _Done(self._conclude, info, waited):
            self._observe(lambda observation: self._batch.step(array, observation, final, *others))
        ended = self._terminated | self._truncated
        if self._final is not None and ended.any():
            info["final_obs"] = self._layout.show(self._final, self.copies)
            info["_final_obs"] = ended
        observation = self._layout.show(self._observation, self.copies)
        return observation, own(self._reward), own(self._terminated), own(self._truncated), info

    def _conclude(self, info: dict[str, Any], waited: NDArray[np.bool_] | None) -> None:
        """The rest of a step: the judge of the caller's."""
        own = np.copy if self.copies else np.asarray
        info |= {"reward_terms": own(self._terms), "success": own(self._success)}
        if (self._terminated | self._truncated).any():
            self._add_verdicts(info)
        if self._judge is not None and waited is not None:
            self._apply(self._judge, info, waited)

    def _add_verdicts(self, info: dict[str, Any]) -> None:
        """Adds the judges' verdicts on the episodes that ended, as Gymnasium's vectors have it: an array for each name, and which worlds count."""
        counts = np.zeros(self.num_envs, np.bool_)
        for world, summary in self._batch.verdicts():
            verdict = in_force(summary)
            if verdict["end"] is None and self._truncated[world]:
                # A horizon of the caller's, which no judge knows.
                verdict |= {"end": "time-out", "causes": ["time-out"]}
            counts[world] = True
            for name, value in verdict.items():
                if name == "success":
                    continue
                if name not in info:
                    dtype = type(value) if isinstance(value, (bool, int, float)) else object
                    info[name] = np.full(self.num_envs, None) if dtype is object else np.zeros(self.num_envs, dtype)
                    info[f"_{name}"] = counts
                info[name][world] = value

    def _apply(self, judge: Judgement, info: dict[str, Any], waited: NDArray[np.bool_]) -> None:
        """Pays and ends as a judge of the caller's says."""
        ended = self._terminated | self._truncated
        last = self._observation.copy()
        if self._final is not None:
            last[ended] = self._final[ended]
        reward, ends = judge(self._layout.show(last, copy=False), info)
        if reward is not None:
            paid = self._judged("reward", reward, np.float32)
            if not np.isfinite(paid).all():
                world = int(np.argmin(np.isfinite(paid)))
                raise ValueError(f"judge: the reward of world {world} is {paid[world]}; give finite numbers")
            self._reward[:] = paid
            self._reward[waited] = 0.0
        if ends is not None:
            ends = self._judged("end", ends, np.bool_) & ~ended & ~waited
            if ends.any():
                self._observe(lambda observation: self._batch.end_episodes(ends, observation))
                self._terminated |= ends
                if self._final is not None:
                    self._final[ends] = last[ends]

    def _judged(self, what: str, values: Any, dtype: Any) -> NDArray[Any]:
        array = np.asarray(values, dtype)
        if array.shape != (self.num_envs,):
            raise ValueError(f"judge: {what} has shape {array.shape}; give one for each of {self.num_envs} worlds")
        return array

    def rollout(self, actions: Any, *, observations: bool = False) -> "Rollout":
        """Takes a control step for each list of actions, in one call: for planners, which would spend their time in Python.

        What it does is what :meth:`step` does with one list after the other. Where an episode ends, the next one begins as the
        autoreset mode says.

        Args:
            actions: Shape (steps, worlds, numbers of an action), or (steps, numbers) for the same in all worlds.
            observations: Whether to return the observation of each step, and not of the last one alone.

        Raises:
            ValueError: A wrong shape, or an action that is refused; no step was taken then. The vector has a judge of its own, or
                the autoreset mode ``"disabled"``, in which a step may be refused.
        """
        self._check_begun()
        if self._judge is not None:
            raise ValueError(
                "rollout: a judge of your own is called after each step; use step, or make the vector without it"
            )
        if self.autoreset_mode == AutoresetMode.DISABLED:
            raise ValueError(
                "rollout: with autoreset_mode='disabled' an ended episode waits for reset; use another mode"
            )
        worlds, width = self.num_envs, self._layout.words
        array = np.asarray(actions)
        single = self.single_action_space.shape or ()
        if array.ndim == 2:
            array = np.broadcast_to(array[:, None], (len(array), worlds, *array.shape[1:]))
        if array.ndim != 3 or not len(array):
            raise ValueError(f"action: shape {array.shape} instead of (steps, {worlds}, {single[0]})")
        steps = len(array)
        array = as_actions(array, (steps, worlds, *single))
        shape = (steps, worlds)
        seen = np.zeros((steps, worlds, width), np.float32) if observations else self._observation
        rollout = Rollout(
            None,
            np.zeros(shape, np.float32),
            np.zeros((*shape, len(self.reward_terms)), np.float32),
            *(np.zeros(shape, np.bool_) for _ in range(3)),
        )
        self._batch.rollout(
            steps,
            array,
            seen,
            rollout.reward,
            rollout.reward_terms,
            rollout.terminated,
            rollout.truncated,
            rollout.success,
        )
        return replace(rollout, observation=self._layout.show(seen, self.copies and not observations))

    def render(self) -> tuple[Picture, ...] | None:
        """A picture of each world, height x width x 3; ``None`` without ``render_mode="rgb_array"``."""
        self._check_begun()
        if self.render_mode is None:
            return None
        return tuple(self.render_world(world) for world in range(self.num_envs))

    def render_world(self, world: int) -> Picture:
        """A picture of one world, height x width x 3, from where ``render_camera`` says."""
        self._check_begun()
        width, height = self._render_size
        number = whole("world", world, 0, self.num_envs - 1)
        pixels = self._batch.render(number, width, height, self._render_camera)
        return picture(pixels, width, height)

    @property
    def action_names(self) -> list[str]:
        """Name of each number of an action."""
        return self._layout.action_names

    @property
    def joint_groups(self) -> dict[str, NDArray[np.int64]]:
        """Where the joints of legs, waist, arms and hands are in an action, as of :attr:`fiatlux.Env.joint_groups`."""
        return joint_groups(self.action_names)

    def __repr__(self) -> str:
        form = "closed" if self._is_closed else f"{self._layout.form} observation of {self._layout.length} numbers"
        return f"<fiatlux.{type(self).__name__} {self._made_for}: {self.num_envs} worlds, {form}>"

    @property
    def reward_terms(self) -> list[str]:
        """Name of each term of the reward."""
        return self._layout.reward_terms

    @property
    def fields(self) -> dict[str, tuple[slice, tuple[int, ...]]]:
        """Place of each field of an observation in the flat vector, and its shape."""
        return self._layout.fields

    def save(self, world: int | None = None) -> _native.Snapshot:
        """The state of all worlds, or of one, for :meth:`restore`; what follows from it repeats to the last bit. It can be pickled."""
        self._check_open()
        return self._batch.save(None if world is None else whole("world", world, 0, self.num_envs - 1))

    def restore(self, snapshot: _native.Snapshot, worlds: Any = None) -> Any:
        """Goes back to a saved state of all worlds, or puts that of one into the marked ``worlds``; returns the observation of all.

        Only ``seed`` and ``num_threads`` may differ from those of the vector that saved it, and the number of worlds where the
        snapshot is of one; any other difference raises ``ValueError`` with its name.
        """
        self._check_open()
        marks = None if worlds is None else self._marks("worlds", worlds)
        with _Done(self._jump, np.True_ if marks is None else marks, marks is None):
            self._observe(lambda observation: self._batch.restore(snapshot, observation, marks))
        return self._layout.show(self._observation, self.copies)

    def row(self, world: int) -> dict[str, Any]:
        """A world's present state as arrays, as in :meth:`fiatlux.Env.row`."""
        self._check_open()
        return self._batch.row(whole("world", world, 0, self.num_envs - 1))

    def drawn(self) -> dict[str, NDArray[Any]]:
        """Values drawn for the present episodes, arrays over all worlds by name.

        ``seed`` and ``episode`` are those of the start; names that begin with ``light.`` are its light. The others are the keys of
        ``ranges``, with an axis of bodies or drives where each has its own number, and ``noise`` and ``action_delay`` (ms). What a
        world did not draw is NaN.
        """
        self._check_open()
        worlds = self._batch.drawn()
        table: dict[str, NDArray[Any]] = {"seed": np.array([seed for seed, _ in worlds], np.uint64)}
        for name in sorted({name for _, drawn in worlds for name in drawn}):
            width = max(len(drawn.get(name, ())) for _, drawn in worlds)
            rows = np.array([drawn.get(name, [np.nan] * width) for _, drawn in worlds])
            table[name] = rows[:, 0] if width == 1 else rows
        return table

    def contacts(self) -> Contacts:
        """Contact points of the last step of all worlds, with their forces; ``state`` is the world. Make the vector with
        ``contacts=True``.

        They are those of the last physics step of 5 ms. The step that ends an episode has its own; after a reset, a copy or a
        restore a world has none.
        """
        self._check_open()
        if not self._has_contacts:
            raise ValueError("contacts are not kept; make the vector with contacts=True")
        return Contacts.of_numbers(*self._batch.contacts())

    def close_extras(self, **kwargs: Any) -> None:
        """Ends the worlds and their threads."""
        self._is_closed = True
        if hasattr(self, "_batch"):
            del self._batch

    def _check_open(self) -> None:
        if self._is_closed:
            raise ClosedEnvironmentError("the environment is closed; make another one")

    def _check_begun(self) -> None:
        self._check_open()
        if not self._begun:
            raise ResetNeeded("no episode has begun; call reset() first")


def check_trainer(env: _Batch, wrapper: str) -> None:
    """Refuses a vector that a library for training would misread: it keeps observations, and knows one autoreset mode."""
    if not env.copies:
        raise ValueError(
            f"{wrapper}: observations that the next step overwrites would be learned from; make env with copy=True"
        )
    if env.autoreset_mode != AutoresetMode.SAME_STEP:
        raise ValueError(
            f"{wrapper}: autoreset_mode is {env.autoreset_mode.value}; make env with autoreset_mode='same_step'"
        )


class VectorEnv(_Batch):
    """Many worlds of a task of the benchmark.

    Args:
        task: Short id of the task, such as ``"S07"``, or its environment id.
        num_envs: Number of worlds.
        seeds: The benchmark's seeds of the rooms. The worlds are spread over the rooms and stay in them, so there must be at
            least as many worlds as rooms. By default the rooms are 1000 to 1015, or as many of them as there are worlds.
        episodes: Number of start states in each room; each episode draws one of them.
        starts: Where episodes begin, mixed by weight; by default at the task's own starts.
        horizon_steps: Control steps until time-out, at most the task's own.
        reward_weights: Weights of the reward's terms where they are not to be the usual ones; :attr:`reward_weights` has all.
        settings: See :class:`SharedSettings` and :class:`EpisodeSettings`.
    """

    @spelt_out(SharedSettings, EpisodeSettings, **{**_SHARED, "observation": "dict", "variations": 16})
    def __init__(
        self,
        task: str,
        num_envs: int = 1,
        *,
        seeds: Sequence[int] | None = None,
        episodes: int = EPISODES,
        starts: Sequence[Start] | None = None,
        horizon_steps: int | None = None,
        reward_weights: Mapping[str, float] | None = None,
        **settings: "Unpack[VectorSettings]",
    ) -> None:
        task, num_envs = _native.task_of(task), whole("num_envs", num_envs, 1, _native.MAX_WORLDS)
        shared: dict[str, Any] = {"observation": "dict", "variations": 16}
        shared |= {name: value for name, value in settings.items() if name in _SHARED}
        rooms = seeds_of(ROOMS[:num_envs] if seeds is None else seeds, num_envs)
        episodes = whole("episodes", episodes, 1, _native.MAX_STARTS // max(len(rooms), 1))
        own = {name: value for name, value in settings.items() if name not in _SHARED}
        arguments = ("num_envs", "seeds", "episodes", "starts", "horizon_steps", "reward_weights", *_SHARED)
        given = complete(task, shared["observation"], own, arguments)
        given["horizon_steps"] = None if horizon_steps is None else whole("horizon_steps", horizon_steps, 1, MAX_SEED)
        given["reward_weights"] = dict(reward_weights or {})
        expanded = _expanded(task, rooms, episodes, [Start()] if starts is None else starts)
        self.action_form: str = given["action_form"]
        super().__init__("rulebook", (task, expanded, given), num_envs, shared)


class WalkingVectorEnv(_Batch):
    """Many worlds of walking by velocity command. Arguments not listed here are those of :class:`SharedSettings`.

    Fields of the observation whose names begin with ``privileged.`` are for a critic.

    Args:
        frames: Number of frames in an observation, the newest last.
        horizon_steps: Control steps until time-out.
        command: Ranges of the commanded velocities: forwards and left, m/s, and about the vertical, rad/s.
        height: Range of the pelvis's commanded height while walking, m.
        stand_height: Range of the pelvis's commanded height while standing, m.
        torso: Ranges of the torso's commanded roll, pitch and yaw, rad.
        arm_range: Share of their joints' ranges that the arms, which are driven from outside, go through.
        load_kg: Largest load in a hand, kg.
        hand_force_n: Largest force that pulls at a hand along each of the world's axes, N.
        reward_weights: Weights of the reward's terms, a second, where they are not to be the usual ones.
        scene: ``floor``, or ``room`` for a task's whole scene with ladder, bulbs and furniture. There the robot walks outside
            the walls, since 20 s are longer than the room; it can have its fingers (``robot=fiatlux.ROBOTS[0]``).

    :attr:`reward_weights` has the weight of each term.
    """

    @spelt_out(SharedSettings, **_SHARED)
    def __init__(
        self,
        num_envs: int = 1,
        *,
        frames: int = 4,
        horizon_steps: int = 1000,
        command: Sequence[tuple[float, float]] = ((-0.5, 1.0), (-0.4, 0.4), (-1.0, 1.0)),
        height: tuple[float, float] = (0.65, 0.79),
        stand_height: tuple[float, float] = (0.55, 0.79),
        torso: Sequence[tuple[float, float]] = ((-0.3, 0.3), (-0.1, 0.6), (-0.5, 0.5)),
        arm_range: float = 1.0,
        load_kg: float = 1.0,
        hand_force_n: float = 20.0,
        reward_weights: Mapping[str, float] | None = None,
        noise: bool = True,
        scene: Literal["floor", "room"] = "floor",
        robot: Robot = "g1_bare",
        gains: Gains = "fiatlux",
        **shared: "Unpack[SharedSettings]",
    ) -> None:
        settings: dict[str, Any] = {
            "scene": scene,
            "robot": robot,
            "gains": gains,
            "frames": whole("frames", frames, 1, 1000),
            "noise": noise,
            "horizon_steps": whole("horizon_steps", horizon_steps, 1, MAX_SEED),
            "command": [list(pair) for pair in command],
            "height": list(height),
            "stand_height": list(stand_height),
            "torso": [list(pair) for pair in torso],
            "arm_range": arm_range,
            "load_kg": load_kg,
            "hand_force_n": hand_force_n,
            "reward_weights": dict(reward_weights or {}),
        }
        super().__init__("walking", (settings,), num_envs, shared)


class ClimbingVectorEnv(_Batch):
    """Many worlds in which a robot follows the plan of the ladder. Arguments not listed here are those of :class:`SharedSettings`.

    The policy corrects the targets of legs and waist. Fields of the observation whose names begin with ``privileged.`` are for a
    critic.

    Args:
        horizon_steps: Control steps until time-out.
        until: End of the part of the plan that is followed, s.
        starts: Ranges of the plan's times at which episodes begin, s, each as likely as the others.
        rates: Range of the plan's seconds in a second.
        backwards: Share of the episodes that go backwards.
        holds: Share of the episodes that hold the pose at which they begin.
        arms: Postures of the arms, 14 angles in rad each, in place of the plan's.
        carries: Share of the episodes that have one of them.
        reward_weights: Weights of the reward's terms, a second, where they are not to be the usual ones.

    :attr:`reward_weights` has the weight of each term.
    """

    @spelt_out(SharedSettings, **_SHARED)
    def __init__(
        self,
        num_envs: int = 1,
        *,
        horizon_steps: int = 500,
        until: float = 1000.0,
        starts: Sequence[tuple[float, float]] = ((0.0, 1000.0),),
        rates: tuple[float, float] = (0.8, 2.2),
        backwards: float = 0.5,
        holds: float = 0.2,
        arms: Sequence[Sequence[float]] = (),
        carries: float = 0.0,
        reward_weights: Mapping[str, float] | None = None,
        noise: bool = True,
        robot: Robot = "g1_bare",
        gains: Gains = "fiatlux",
        **shared: "Unpack[SharedSettings]",
    ) -> None:
        settings: dict[str, Any] = {
            "robot": robot,
            "gains": gains,
            "noise": noise,
            "horizon_steps": whole("horizon_steps", horizon_steps, 1, MAX_SEED),
            "until": until,
            "starts": [list(pair) for pair in starts],
            "rates": list(rates),
            "backwards": backwards,
            "holds": holds,
            "arms": [list(posture) for posture in arms],
            "carries": carries,
            "reward_weights": dict(reward_weights or {}),
        }
        super().__init__("climbing", (settings,), num_envs, shared)
