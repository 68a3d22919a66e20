"""Plays one episode at a time, by the benchmark's own rules."""

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import gymnasium
import numpy as np
from gymnasium.error import ClosedEnvironmentError, ResetNeeded
from numpy.typing import NDArray

from . import _native
from ._numbers import seed_of, size_of
from ._pictures import Picture, picture
from .kinematics import Contacts
from .settings import RenderMode, Sensor, Settings, complete, names_of, spelt_out
from .spaces import Layout, ObservationForm, as_actions, joint_groups
from .tasks import TASKS, Task

if TYPE_CHECKING:
    from typing_extensions import Unpack

TRAINING_SEEDS: tuple[int, int] = _native.TRAINING_SEEDS
"""Seeds for training, from the first up to but not including the second. All others are for fixtures, tests and judging."""


_JUDGED = {"success": "success", "clean": "clean", "gate_progress": "progress", "steps": "steps", "end": "end"}
"""The verdicts of each judge on an episode, and how its name goes on after ``strict_`` and ``published_``."""


def in_force(summary: dict[str, Any]) -> dict[str, Any]:
    """A summary whose plain names are of the judge that ended the episode."""
    made = dict(summary)
    for name, ending in _JUDGED.items():
        made[f"published_{ending}"] = summary[name]
        if summary["strict_success"] is not None:
            made[name] = summary[f"strict_{ending}"]
    if summary["strict_success"] is not None and made["end"] is not None and made["end"] not in made["causes"]:
        made["causes"] = [made["end"]]
    return made


def check_camera(name: str | None, robot: str) -> None:
    """Refuses the name of a camera that a robot does not have."""
    if name is None:
        return
    cameras = _native.camera_names(robot)
    if name not in [known for pair in cameras for known in pair]:
        known = ", ".join(f"{mount!r} (sensor {sensor!r})" if sensor else repr(mount) for mount, sensor in cameras)
        raise ValueError(f"render_camera is {name!r}; the cameras of {robot} are {known}, and None shows the robot")


@dataclass(frozen=True)
class EpisodeState:
    """A saved episode; it names its task and settings."""

    task: str
    settings: dict[str, Any]
    seed: int | None
    index: int
    episode: _native.Episode


class Env(gymnasium.Env[Any, NDArray[np.float32]]):
    """A task of the benchmark.

    The same seed, episode and actions give the same rows, rewards, ends and digest as in every other Fiatlux program. Actions
    count as ``float64``, to the last bit. A copy or a pickle continues where the episode is; unpickling plays its actions again.

    Args:
        task: Short id or environment id.
        observation: Form of the observation, see :data:`fiatlux.spaces.ObservationForm`.
        render_mode: ``"rgb_array"`` or ``None``.
        render_size: Width and height of rendered pictures, pixels.
        render_camera: Name of one of the robot's cameras, or of the sensor that it takes pictures for: ``"head_camera"`` or
            ``"camera"``, ``"chest_camera"``. ``None`` shows the robot from its side.
        settings: See :class:`fiatlux.Settings`.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 50}

    @spelt_out(Settings)
    def __init__(
        self,
        task: str,
        *,
        observation: ObservationForm = "dict",
        render_mode: RenderMode | None = None,
        render_size: tuple[int, int] = (640, 480),
        render_camera: str | None = None,
        **settings: "Unpack[Settings]",
    ) -> None:
        if render_mode is not None and render_mode not in self.metadata["render_modes"]:
            raise ValueError(f"render_mode is {render_mode!r}; known ones are None, 'rgb_array'")
        self.render_mode = render_mode
        self._render_size, self._render_camera = size_of("render_size", render_size), render_camera
        self._task = task = _native.task_of(task)
        arguments = ("observation", "render_mode", "render_size", "render_camera")
        self._settings = complete(task, observation, settings, arguments)
        check_camera(render_camera, self._settings["robot"])
        self._seed: int | None = None
        self._index = 0
        self._closed = False
        self._begun = False
        # Names and sizes are the same in every episode.
        self._episode = _native.Episode(task, 0, 0, self._settings)
        self._layout = Layout(self._episode.spec, observation)
        self.observation_space = self._layout.space
        self.action_space = self._layout.action_space

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        """Begins an episode: with a seed, its episode 0; without one, the next episode of the last seed.

        The seed is the benchmark's: it draws the room and, together with the episode, everything else. If none was ever given,
        one is drawn from the seeds for training. ``options`` may have ``"episode"``, the index of an episode of the seed.
        ``info["drawn"]`` is what was drawn, as the header of a bag has it.
        """
        self._check_open()
        seed = None if seed is None else seed_of(seed)
        options = dict(options or {})
        asked = seed_of(options.pop("episode"), "episode") if "episode" in options else None
        if options:
            raise ValueError(f"options has no {next(iter(options))!r}; known keys are 'episode'")
        super().reset(seed=seed)
        index = 0
        if seed is None:
            seed, index = self._seed, self._index + 1
        if seed is None:
            seed, index = int(self.np_random.integers(*TRAINING_SEEDS)), 0
        index = index if asked is None else asked
        # Until the new episode is there, the old one goes on: Ctrl-C may end the call.
        episode = _native.Episode(self._task, seed, index, self._settings)
        self._seed, self._index, self._episode, self._begun = seed, index, episode, True
        info = {"seed": self._seed, "episode": self._index, "drawn": self._episode.drawn()}
        return self._observation(), info

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Takes a control step of 20 ms. A wrong shape, NaN or a step after the end raises ``ValueError``.

        ``info`` has ``reward_terms``. At the end of an episode it has the fields of :meth:`summary`, where ``success``, ``clean``,
        ``gate_progress``, ``steps`` and ``end`` are of the judge in force, the one that ``protocol`` names. Those of the
        published judge are then ``published_success`` and so on, those of the strict one ``strict_success`` and so on. A
        :class:`fiatlux.VectorEnv` has the verdicts by the same names.
        """
        self._check_begun()
        array = as_actions(action, self.action_space.shape or ())
        reward, terminated, truncated = self._episode.step(array)
        info: dict[str, Any] = {"reward_terms": self._episode.reward_terms()}
        if terminated or truncated:
            info |= in_force(self._episode.summary())
        return self._observation(), reward, terminated, truncated, info

    def look(self, sensors: Sequence[Sensor | str]) -> Any:
        """Computes these sensors of the present row again, whatever their rate, and returns the observation; see
        :class:`fiatlux.Settings`. A look takes no time, as in a session in lockstep.

        Raises:
            ValueError: The environment was made without a sensor.
        """
        self._check_begun()
        self._episode.look(names_of("sensors", sensors))
        return self._observation()

    def render(self) -> Picture | None:
        """Renders the present row as height x width x 3, an array that notebooks show; returns ``None`` without a render mode."""
        self._check_begun()
        return None if self.render_mode is None else self._picture()

    def _picture(self) -> Picture:
        width, height = self._render_size
        return picture(self._episode.render(width, height, self._render_camera), width, height)

    def _repr_png_(self) -> bytes | None:
        """The present row in a notebook."""
        return self._picture()._repr_png_() if self._begun and not self._closed else None

    def close(self) -> None:
        """Closes the environment; every later call raises an error."""
        self._closed = True

    @property
    def digest(self) -> str:
        """Digest of the episode's rows so far, hexadecimal."""
        self._check_begun()
        return self._episode.digest

    def summary(self) -> dict[str, Any]:
        """Summary of the episode so far: the fields of ``results.json`` that follow from its rows.

        As in ``results.json``, plain names are of the published judge, those with ``strict_`` of the strict one, ``None`` if the
        protocol is published. ``info`` of the last step has plain names of the judge in force.
        """
        self._check_begun()
        return self._episode.summary()

    def row(self) -> dict[str, Any]:
        """The present state as arrays: SI units, world axes; poses are x, y, z, then the quaternion w, x, y, z."""
        self._check_begun()
        return self._episode.row()

    def contacts(self) -> Contacts:
        """Contact points of the last physics step, with their forces; before the first step those of the staging."""
        self._check_begun()
        return Contacts.of_numbers(*self._episode.contacts())

    def to_mjcf(self, nearest: bool = True) -> str:
        """The scene as MJCF for MuJoCo; its keyframe is the present state with the present joint targets.

        With ``nearest`` it has the options of MuJoCo that are closest to this simulator, otherwise MuJoCo's defaults. It does not
        model how the socket holds a bulb. Sites have the names of :attr:`Kinematics.sites`; links are bodies, but for those that are
        fixed to another one. Cameras have those of the robot's, joints and actuators those of :attr:`action_names`.
        """
        self._check_begun()
        return self._episode.mjcf(nearest)

    def save(self) -> EpisodeState:
        """The episode as it is now, for :meth:`restore`. It can be pickled; that plays its actions again when it is read."""
        self._check_begun()
        return EpisodeState(self.task.short_id, self._settings, self._seed, self._index, copy.deepcopy(self._episode))

    def restore(self, state: EpisodeState) -> Any:
        """Goes back to a saved episode, of this environment or another one of the same task and settings; returns its observation."""
        self._check_open()
        ours = {"task": self.task.short_id, **self._settings}
        theirs = {"task": state.task, **state.settings}
        for name, value in ours.items():
            if theirs[name] != value:
                raise ValueError(f"state: {name} is {theirs[name]!r}, but the environment has {value!r}")
        self._seed, self._index, self._begun = state.seed, state.index, True
        self._episode = copy.deepcopy(state.episode)
        return self._observation()

    @property
    def task(self) -> Task:
        """The task of this environment."""
        return TASKS[self._task]

    @property
    def looks(self) -> bool:
        """True if a sensor is seen only when somebody looks, such as ``"camera@look"``."""
        return any(name.endswith("@look") for name in self._settings["sensors"] or ())

    @property
    def action_names(self) -> list[str]:
        """Name of each number of an action."""
        return self._layout.action_names

    @property
    def joint_groups(self) -> dict[str, NDArray[np.int64]]:
        """Where the joints of legs, waist, arms and hands are in an action, by the names of :data:`fiatlux.spaces.JOINT_GROUPS`."""
        return joint_groups(self.action_names)

    def __repr__(self) -> str:
        episode = f"seed {self._seed}, episode {self._index}" if self._begun else "no episode has begun"
        if self._closed:
            episode = "closed"
        task, robot, protocol = self.task.short_id, self._settings["robot"], self._settings["protocol"]
        return f"<fiatlux.Env {task}, {robot}, {protocol} judge: {episode}>"

    def _observation(self) -> Any:
        numbers = np.empty(self._layout.words, np.float32)
        self._episode.observe(numbers)
        return self._layout.show(numbers, copy=False)

    def _check_open(self) -> None:
        if self._closed:
            raise ClosedEnvironmentError("the environment is closed; make another one")

    def _check_begun(self) -> None:
        self._check_open()
        if not self._begun:
            raise ResetNeeded("no episode has begun; call reset() first")
