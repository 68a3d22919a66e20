"""Kinematics and dynamics of many states at once, by the code that steps the worlds."""

import difflib
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _native
from ._memory import check_memory
from ._numbers import real, seed_of
from .poses import rotate
from .settings import ROBOTS, Gains, Robot
from .spaces import joint_groups

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Solution:
    """Result of inverse kinematics, for each state."""

    qpos: Array
    """The configurations, the best that were found."""
    reached: NDArray[np.bool_]
    """True where all goals are reached and all clearances kept."""
    position_error: Array
    """Largest error of a position, m."""
    rotation_error: Array
    """Largest error of a rotation, rad."""
    clearance_error: Array
    """Most that two shapes are nearer than their margin, m."""
    limit_distance: Array
    """Least distance of a joint that may move from the ends of its range, rad."""
    angles: Array
    """Of the joints that may move, rad, shape (..., joints)."""


@dataclass(frozen=True)
class SupportForces:
    """Forces of supports, for each state; NaN where they cannot bear the robot."""

    borne: NDArray[np.bool_]
    """True where such forces exist, within friction and the drives' efforts."""
    forces: Array
    """On the robot, world, N, shape (..., supports, 3)."""
    efforts: Array
    """Of the drives, N m, by joint."""
    targets: Array
    """With which the drives make these efforts, rad, by joint: angle plus effort over stiffness."""


@dataclass(frozen=True)
class Support:
    """A point of the robot that bears on something firm."""

    site: str
    """Site or link of the robot, such as ``left_sole``."""
    point: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Where it touches, in the site's frame, m."""
    normal: tuple[float, float, float] = (0.0, 0.0, 1.0)
    """Direction in which the surface pushes, world."""
    friction: float = 1.0
    """Coefficient of friction."""
    most: float = float("inf")
    """Most that it bears along the normal, N."""


@dataclass(frozen=True)
class Nearest:
    """Where pairs of shapes are nearest to each other, for each state."""

    distance: Array
    """Gaps, m, negative where shapes overlap, shape (..., pairs)."""
    points: Array
    """The nearest point of each surface, world, m, shape (..., pairs, 2, 3)."""
    normal: Array
    """Unit vectors from the first shape to the second, shape (..., pairs, 3)."""


@dataclass(frozen=True)
class Contacts:
    """Contact points of states, one after the other."""

    state: NDArray[np.int64]
    """Index of the state, where its leading axes count as one; of a vector of worlds, the world."""
    shapes: list[tuple[str, str]]
    """Names of the two shapes."""
    distance: Array
    """Gap, m; negative where the shapes overlap."""
    point: Array
    """Half-way between the surfaces, world, m, shape (contacts, 3)."""
    normal: Array
    """Unit vector from the first shape to the second, shape (contacts, 3)."""
    force: Array
    """Force of the first shape on the second, world, N, shape (contacts, 3); NaN where no step was taken."""

    @classmethod
    def of_numbers(cls, shapes: list[tuple[str, str]], numbers: Array) -> "Contacts":
        """From 11 numbers for each point: state, distance, point, normal, force."""
        made = numbers.reshape(-1, 11)
        return cls(made[:, 0].astype(np.int64), shapes, made[:, 1], made[:, 2:5], made[:, 5:8], made[:, 8:])


_PART = 1024
"""States of one call of the library, which takes some tenths of a second at most."""
_SAMPLED = 256
"""States that say how many contact points all of them have."""
_POINT_BYTES = 700
"""Of a contact point while it is read: two names of shapes, twice, and its numbers."""


class Kinematics:
    """Readings of a robot's states: poses, Jacobians, the equation of motion, distances, postures and contact forces.

    A state is ``qpos`` of length :attr:`nq` and, where speeds matter, ``qvel`` of length :attr:`nv`; every method takes one state
    or an array of them, and returns arrays with the same leading axes. Quaternions are w first. A free body's
    part of ``qvel`` is the velocity of its origin and its angular velocity, both in world axes::

        kinematics = fiatlux.Kinematics("S08", seed=64)
        qpos, qvel = kinematics.state(env.row())
        palm = kinematics.poses(qpos, ["left_palm"])[0]

    Args:
        task: A task, for the robot in its room with that seed; without it, the robot on a bare floor.
        seed: Seed of the room.
        robot: Name of the robot, one of ``fiatlux.ROBOTS``, or of its hands.
        gains: Drives, as of :class:`fiatlux.Settings`.

    Raises:
        ValueError: The task, the robot or the gains are unknown.
    """

    def __init__(
        self, task: str | None = None, *, seed: int = 0, robot: Robot = ROBOTS[0], gains: Gains = "fiatlux"
    ) -> None:
        self._native = _native.Kinematics(task, seed_of(seed), robot, gains)
        self._made_for = f"task={task!r}, seed={seed}, robot={robot!r}"
        layout = self._native.layout()
        self.nq: int = layout["nq"]
        """Length of ``qpos``."""
        self.nv: int = layout["nv"]
        """Length of ``qvel``."""
        self.joints: list[str] = [name for name, _, _ in layout["joints"]]
        """Names of the robot's joints, in the order of actions."""
        self.joint_groups: dict[str, NDArray[np.int64]] = joint_groups(self.joints)
        """Where the joints of legs, waist, arms and hands are in :attr:`joints`, as of :attr:`fiatlux.Env.joint_groups`."""
        self.joint_qpos: NDArray[np.int64] = np.array([at for _, at, _ in layout["joints"]])
        """Where their angles are in ``qpos``."""
        self.joint_dof: NDArray[np.int64] = np.array([at for _, _, at in layout["joints"]])
        """Where their speeds are in ``qvel``."""
        at, dof = layout["root"]
        self.pelvis_qpos = slice(at, at + 7)
        """Where the position and the quaternion of the pelvis are in ``qpos``."""
        self.pelvis_dof = slice(dof, dof + 6)
        """Where its velocity and its angular velocity are in ``qvel``."""
        self.q0: Array = np.array(layout["q0"])
        """Their angles in the standing posture, rad."""
        self.joint_limits: Array = np.array(layout["limits"]).reshape(-1, 2)
        """Lower and upper end of their ranges, rad, shape (joints, 2)."""
        drives = np.array(layout["drives"]).reshape(-1, 3)
        self.stiffness: Array = drives[:, 0]
        """Of their drives, N m/rad: a drive presses with this times what is left to its target, less damping times speed, at most with
        :attr:`effort_limit`."""
        self.damping: Array = drives[:, 1]
        """Of their drives, N m s/rad."""
        self.effort_limit: Array = drives[:, 2]
        """Largest torque of their drives, N m."""
        hands = layout["hand_bodies"]
        self.hand_bodies: dict[str, list[str]] = {"right": hands[: len(hands) // 2], "left": hands[len(hands) // 2 :]}
        """Names of the bodies whose forces the sensor ``hand_contact`` has, in its order: ``right_hand_contact[k]`` is of
        ``hand_bodies["right"][k]``."""
        self.sites: list[str] = layout["sites"]
        """Names of all sites and of the robot's links."""
        self.shapes: dict[str, str] = dict(layout["shapes"])
        """Names of all collision shapes, each with that of the body that carries it."""
        self.soles: dict[str, tuple[float, float]] = {name: tuple(half) for name, half in layout["soles"]}
        """Names of the sites of the soles, each with half its length and half its width, m."""
        self.reference: Array = np.array(layout["reference"])
        """``qpos`` with all angles 0 and all things where the room has them."""
        glass, grip = layout["grasp"] or (float("nan"), {})
        self.glass_height: float = glass
        """Height of the centre of a bulb's glass above its origin, on its axis, for bulbs of the published size, m."""
        self.grip: dict[str, float] = grip
        """Targets of the right hand's joints that hold a bulb, rad: as episodes begin with one in the hand. Empty without fingers."""
        self._free = {"robot": layout["root"]} | {name: (at, dof) for name, at, dof in layout["free_bodies"]}
        qpos, qvel, turns = layout["mujoco"]
        self._mujoco_qpos, self._mujoco_qvel = np.array(qpos), np.array(qvel)
        self._mujoco_turns: list[tuple[int, int]] = turns

    def __repr__(self) -> str:
        return f"<fiatlux.Kinematics {self._made_for}: {len(self.joints)} joints, nq {self.nq}, nv {self.nv}>"

    def state(self, row: Mapping[str, ArrayLike]) -> tuple[Array, Array]:
        """``qpos`` and ``qvel`` of rows, such as those of ``env.row()``: arrays by name, with any leading axes.

        It reads ``joint_position``, ``joint_velocity`` and, of the robot and of each thing, ``robot_pose`` (position and
        quaternion), ``robot_linear_velocity`` and ``robot_angular_velocity``. What is missing is as in :attr:`reference`, at rest.

        Raises:
            ValueError: An array has another shape, or a name is not one of a row.
        """
        fields = {name: np.asarray(field, np.float64) for name, field in row.items() if name != "step"}
        for name in fields:
            body = next((name.removesuffix(part) for part in _OF_BODIES if name.endswith(part)), None)
            if name not in _OF_JOINTS and body not in (*_BODIES, *self._free):
                close = difflib.get_close_matches(name, (*_OF_JOINTS, *(b + p for b in _BODIES for p in _OF_BODIES)), 1)
                hint = f"; did you mean {close[0]!r}?" if close else ""
                raise ValueError(f"state: a row has no part {name!r}{hint}")
        places: list[tuple[int, str, Any]] = [
            (0, "joint_position", self.joint_qpos),
            (1, "joint_velocity", self.joint_dof),
        ]
        for name, (at, dof) in self._free.items():
            places += [
                (0, f"{name}_pose", np.arange(at, at + 7)),
                (1, f"{name}_linear_velocity", np.arange(dof, dof + 3)),
                (1, f"{name}_angular_velocity", np.arange(dof + 3, dof + 6)),
            ]
        known = [(which, fields[name], place) for which, name, place in places if name in fields]
        lead = np.broadcast_shapes(*(field.shape[:-1] for _, field, _ in known))
        made = np.tile(self.reference, (*lead, 1)), np.zeros((*lead, self.nv))
        for which, field, place in known:
            made[which][..., place] = field
        return made

    @property
    def mujoco_joints(self) -> list[str]:
        """Names of the joints in the order of MuJoCo's ``qpos`` and ``qvel``; a free body's has the body's name."""
        names = {int(at): name for name, at in zip(self.joints, self.joint_qpos)}
        names |= {int(at): name for name, (at, _) in self._free.items()}
        return [names[at] for at in self._mujoco_qpos.tolist() if at in names]

    def to_mujoco(self, qpos: ArrayLike, qvel: ArrayLike | None = None, *, model: Any = None) -> tuple[Array, Array]:
        """``qpos`` and ``qvel`` of MuJoCo for the scene of :meth:`fiatlux.Env.to_mjcf`; without ``qvel``, at rest.

        The lengths are the same and the orders are not: MuJoCo goes through the bodies depth first, and a free body's angular velocity
        is in its own axes there, in the world's here. Positions, quaternions (w first) and velocities are the same.

        Args:
            qpos: States, with any leading axes.
            qvel: Their velocities.
            model: A ``mujoco.MjModel``. If it is given, its joints must be those of :attr:`mujoco_joints`, in this order.

        Raises:
            ValueError: An array has another shape, a quaternion's length is not 1, or the model has other joints or another order.
        """
        self._check_model(model)
        rows, lead = self._rows("qpos", qpos)
        speeds, of_speeds = self._rows("qvel", np.zeros((*lead, self.nv)) if qvel is None else qvel)
        if of_speeds != lead:
            raise ValueError(f"qvel: leading axes {of_speeds} are not those of qpos, {lead}")
        positions, speeds = rows[:, self._mujoco_qpos], speeds[:, self._mujoco_qvel]
        for turn, spin in self._mujoco_turns:
            quaternion = self._unit(positions[:, turn : turn + 4]) * [1.0, -1.0, -1.0, -1.0]
            speeds[:, spin : spin + 3] = rotate(quaternion, speeds[:, spin : spin + 3])
        return positions.reshape(*lead, self.nq), speeds.reshape(*lead, self.nv)

    def from_mujoco(self, qpos: ArrayLike, qvel: ArrayLike | None = None, *, model: Any = None) -> tuple[Array, Array]:
        """``qpos`` and ``qvel`` of MuJoCo in the order and the axes of this class: the reverse of :meth:`to_mujoco`.

        Raises:
            ValueError: As for :meth:`to_mujoco`.
        """
        self._check_model(model)
        rows, lead = self._rows("qpos", qpos)
        given, of_speeds = self._rows("qvel", np.zeros((*lead, self.nv)) if qvel is None else qvel)
        if of_speeds != lead:
            raise ValueError(f"qvel: leading axes {of_speeds} are not those of qpos, {lead}")
        given = given.copy()
        for turn, spin in self._mujoco_turns:
            quaternion = self._unit(rows[:, turn : turn + 4])
            given[:, spin : spin + 3] = rotate(quaternion, given[:, spin : spin + 3])
        positions, speeds = np.empty_like(rows), np.empty_like(given)
        positions[:, self._mujoco_qpos], speeds[:, self._mujoco_qvel] = rows, given
        return positions.reshape(*lead, self.nq), speeds.reshape(*lead, self.nv)

    @property
    def mujoco_actuators(self) -> list[str]:
        """Names of the actuators in the order of MuJoCo's ``ctrl``: neither that of actions nor that of its ``qpos``."""
        return [self.joints[joint] for joint in np.argsort(self.joint_qpos)]

    def to_mujoco_ctrl(self, targets: ArrayLike, *, model: Any = None) -> Array:
        """``ctrl`` of MuJoCo for the scene of :meth:`fiatlux.Env.to_mjcf`, of joint targets in the order of actions, rad.

        Args:
            targets: One for each of :attr:`joints`, with any leading axes.
            model: A ``mujoco.MjModel``. If it is given, its actuators must be those of :attr:`mujoco_actuators`, in this order.

        Raises:
            ValueError: The number of targets is another, or the model has other actuators or another order.
        """
        given = np.asarray(targets, np.float64)
        if given.shape[-1:] != (len(self.joints),):
            raise ValueError(
                f"targets: shape {given.shape} instead of (..., {len(self.joints)}); give one for each joint"
            )
        if model is not None:
            found = [model.actuator(actuator).name for actuator in range(model.nu)]
            if found != self.mujoco_actuators:
                raise ValueError(
                    f"model: its {len(found)} actuators are not those of mujoco_actuators; make it from to_mjcf() of the same task and "
                    "robot, or move the numbers by their names"
                )
        ctrl: Array = given[..., np.argsort(self.joint_qpos)]
        return ctrl

    def _check_model(self, model: Any) -> None:
        if model is None:
            return
        wanted = self.mujoco_joints
        found = [model.joint(joint).name for joint in range(model.njnt)]
        if (model.nq, model.nv) != (self.nq, self.nv) or found != wanted:
            at = next(
                (at for at, pair in enumerate(zip(found, wanted)) if pair[0] != pair[1]), min(len(found), len(wanted))
            )
            names = [f"{names[at]!r}" if at < len(names) else "none" for names in (found, wanted)]
            raise ValueError(
                f"model: nq {model.nq}, nv {model.nv}, joint {at} is {names[0]}, but here nq {self.nq}, nv {self.nv}, joint {at} "
                f"is {names[1]}; make it from to_mjcf() of the same task and robot, or move the numbers by their joints' names"
            )

    @staticmethod
    def _unit(quaternion: Array) -> Array:
        length = np.linalg.norm(quaternion, axis=-1)
        if (np.abs(length - 1.0) > 1e-6).any():
            raise ValueError(
                f"qpos: a quaternion has length {length[np.argmax(np.abs(length - 1.0))]:.6g}; is the state in the other order "
                "(to_mujoco, from_mujoco)?"
            )
        return quaternion

    def poses(self, qpos: ArrayLike, sites: Sequence[str]) -> Array:
        """Positions, m, and quaternions of sites or links, shape (..., sites, 7)."""
        _refuse_text("sites", sites)
        return self._call("poses", (len(sites), 7), [qpos], list(sites))

    def velocities(self, qpos: ArrayLike, qvel: ArrayLike, sites: Sequence[str]) -> Array:
        """Velocities, m/s, and angular velocities of sites or links, world axes, shape (..., sites, 6)."""
        _refuse_text("sites", sites)
        return self._call("velocities", (len(sites), 6), [qpos, qvel], list(sites))

    def jacobian(self, qpos: ArrayLike, site: str) -> Array:
        """Jacobian of a site, shape (..., 6, nv): times ``qvel`` it is the site's velocity, then its angular velocity."""
        return self._call("jacobian", (6, self.nv), [qpos], site)

    def center_of_mass(self, qpos: ArrayLike) -> Array:
        """Centre of mass of the robot, m, shape (..., 3)."""
        return self._call("center_of_mass", (3,), [qpos])

    def com_jacobian(self, qpos: ArrayLike) -> Array:
        """Jacobian of the centre of mass, shape (..., 3, nv)."""
        return self._call("com_jacobian", (3, self.nv), [qpos])

    def mass_matrix(self, qpos: ArrayLike) -> Array:
        """Mass matrix, rotors' inertias on its diagonal, shape (..., nv, nv)."""
        return self._call("mass_matrix", (self.nv, self.nv), [qpos])

    def bias_force(self, qpos: ArrayLike, qvel: ArrayLike | None = None) -> Array:
        """Coriolis, centrifugal and gravity terms, shape (..., nv); without ``qvel``, what holds the weight of a hanging robot."""
        at_rest = np.zeros((*np.shape(qpos)[:-1], self.nv))
        return self._call("bias_force", (self.nv,), [qpos, at_rest if qvel is None else qvel])

    def inverse_dynamics(self, qpos: ArrayLike, qvel: ArrayLike, qacc: ArrayLike) -> Array:
        """Generalised forces that give these accelerations, shape (..., nv)."""
        return self._call("inverse_dynamics", (self.nv,), [qpos, qvel, qacc])

    def shape_pairs(self, body: str = "") -> list[tuple[str, str]]:
        """Pairs of shapes that may touch; with a name, those of which one is carried by that body."""
        pairs = self._native.shape_pairs()
        return [pair for pair in pairs if not body or body in (self.shapes[pair[0]], self.shapes[pair[1]])]

    def nearest(self, qpos: ArrayLike, pairs: Iterable[tuple[str, str]]) -> Nearest:
        """Signed distances and nearest points of pairs of shapes, by name.

        Two half-spaces have none: NaN.
        """
        pairs = list(pairs)
        made = self._call("nearest", (len(pairs), 10), [qpos], pairs)
        return Nearest(made[..., 0], made[..., 1:7].reshape(*made.shape[:-1], 2, 3), made[..., 7:])

    def contacts(self, qpos: ArrayLike, margin: float = 0.0) -> Contacts:
        """Contact points with a gap of at most ``margin``, m; their forces follow only from a step: see :meth:`VectorEnv.contacts`."""
        states = self._rows("qpos", qpos)[0]
        if len(states) > _SAMPLED:
            sampled = states[:: len(states) // _SAMPLED]
            points = len(self._native.contacts(np.ascontiguousarray(sampled), margin)[0]) * len(states) // len(sampled)
            check_memory(_POINT_BYTES * points, f"qpos: no memory for about {points} contact points")
        shapes, numbers = self._native.contacts(states, margin)
        made = Contacts.of_numbers(shapes, numbers)
        made.force[:] = np.nan
        return made

    def inverse(
        self,
        qpos: ArrayLike,
        goals: Mapping[str, ArrayLike],
        *,
        joints: Sequence[str] | NDArray[np.integer[Any]] | None = None,
        floating: bool = False,
        center_of_mass: ArrayLike | None = None,
        clearances: Mapping[tuple[str, str], float] | None = None,
        rest: ArrayLike | None = None,
        rest_pull: float = 0.0,
        position_tolerance: float = 1e-4,
        rotation_tolerance: float = 1e-3,
        tries: int = 40,
        steps: int = 60,
        limit_margin: float = 0.0,
        spread: float = 1.0,
    ) -> Solution:
        """Configurations at which sites are where they are wanted; the search begins at ``qpos``.

        Args:
            qpos: Where the search begins.
            goals: For each site a pose (7 numbers) or a position (3), with or without the leading axes of ``qpos``.
            joints: Joints that may move, by name, or by place as in :attr:`joint_groups`; all of them if left out.
            floating: Whether the pelvis may move, too.
            center_of_mass: Where it is wanted: x and y, or all three, m.
            clearances: Pairs of shapes, each with the smallest gap, m.
            rest: Angles of ``joints`` to which they go where the goals leave them free, rad.
            rest_pull: Part of the way there that each step takes, from 0 to 1.
            position_tolerance: Largest position error that counts as reached, m.
            rotation_tolerance: Largest rotation error that counts as reached, rad.
            tries: Most postures that it starts from.
            steps: Most steps from each of them.
            limit_margin: Joints keep this distance from their limits, rad.
            spread: Part of each joint's range, about its rest, that these postures are spread over.

        Raises:
            ValueError: A name is unknown, an array has another shape, or a number is not finite.
        """
        states, lead = self._rows("qpos", qpos)
        given = self.joints if joints is None else joints
        names = [joint if isinstance(joint, str) else self.joints[joint] for joint in given]
        wanted: list[tuple[str | None, Array, list[float], list[float]]] = []
        for site, goal in goals.items():
            goal = np.asarray(goal, np.float64)
            is_pose = goal.shape[-1:] == (7,)
            wanted.append((site, self._goal(goal, lead, site), [1.0] * 3, [0.3 if is_pose else 0.0] * 3))
        if center_of_mass is not None:
            goal = np.asarray(center_of_mass, np.float64)
            weights = [1.0, 1.0, float(goal.shape[-1:] == (3,))]
            wanted.append((None, self._goal(goal, lead, "center_of_mass"), weights, [0.0] * 3))
        search = {
            "joints": names,
            "floating": floating,
            "clearances": [(a, b, margin) for (a, b), margin in (clearances or {}).items()],
            "rest": None if rest is None else np.asarray(rest, np.float64).tolist(),
            "rest_pull": rest_pull,
            "position_tolerance": position_tolerance,
            "rotation_tolerance": rotation_tolerance,
            "tries": tries,
            "steps": steps,
            "limit_margin": limit_margin,
            "spread": spread,
        }
        found, errors = self._native.inverse(states, wanted, search)
        reached, position, rotation, clearance = np.moveaxis(errors.reshape(*lead, 4), -1, 0)
        moved = np.array([self.joints.index(name) for name in names], np.int64)
        angles = found.reshape(-1, self.nq)[:, self.joint_qpos[moved]]
        ends = np.abs(angles[..., None] - self.joint_limits[moved])
        least, angles = ends.min(axis=(1, 2), initial=np.inf).reshape(lead), angles.reshape(*lead, len(moved))
        return Solution(found.reshape(*lead, self.nq), reached > 0.5, position, rotation, clearance, least, angles)

    def sole_supports(self, sole: str, friction: float = 1.0, most: float = float("inf")) -> list[Support]:
        """The corners of a sole as supports on level ground."""
        x, y = self.soles[sole]
        corners = ((x, y, 0.0), (x, -y, 0.0), (-x, y, 0.0), (-x, -y, 0.0))
        return [Support(sole, corner, friction=friction, most=most) for corner in corners]

    def supports(
        self,
        qpos: ArrayLike,
        qvel: ArrayLike,
        supports: Iterable[Support],
        *,
        com_acceleration: ArrayLike = (0.0, 0.0, 0.0),
        trunk_acceleration: ArrayLike = (0.0, 0.0, 0.0),
    ) -> SupportForces:
        """Forces of supports that bear the robot and accelerate it so, with the least efforts of the drives.

        Args:
            qpos: The states.
            qvel: Their velocities.
            supports: What bears it.
            com_acceleration: Of the centre of mass, m/s^2, with or without the leading axes of ``qpos``.
            trunk_acceleration: Angular, rad/s^2, likewise.

        Raises:
            ValueError: A name is unknown, an array has another shape, or a support makes no sense.
        """
        supports = list(supports)
        given = [(s.site, list(s.point), list(s.normal), s.friction, s.most) for s in supports]
        lead = np.shape(qpos)[:-1]
        accelerations = (com_acceleration, trunk_acceleration)
        parts = [np.broadcast_to(np.asarray(part, np.float64), (*lead, 3)) for part in accelerations]
        wanted = np.ascontiguousarray(np.concatenate(parts, axis=-1).reshape(-1, 6))
        count, joints = 3 * len(supports), len(self.joints)
        made = self._call("supports", (count + 2 * joints,), [qpos, qvel], given, wanted)
        forces, efforts, targets = np.split(made, [count, count + joints], axis=-1)
        return SupportForces(np.asarray(~np.isnan(efforts).any(-1)), forces.reshape(*lead, -1, 3), efforts, targets)

    def _rows(self, name: str, array: ArrayLike) -> tuple[Array, tuple[int, ...]]:
        """An array with a row for each state, and the leading axes."""
        width = self.nq if name == "qpos" else self.nv
        try:
            given = real(array)
        except (TypeError, ValueError) as error:
            raise ValueError(f"{name}: cannot be read as numbers ({error})") from error
        if given.shape[-1:] != (width,):
            raise ValueError(f"{name}: shape {given.shape} does not end with {width}, the length of a state's {name}")
        return np.ascontiguousarray(given.reshape(-1, width)), given.shape[:-1]

    def _call(self, method: str, shape: tuple[int, ...], states: Sequence[ArrayLike], *arguments: Any) -> Array:
        names = ("qpos", "qvel", "qacc")
        rows = [self._rows(name, state) for name, state in zip(names, states, strict=False)]
        for name, (_, lead) in zip(names, rows, strict=False):
            if lead != rows[0][1]:
                raise ValueError(f"{name}: leading axes {lead} are not those of qpos, {rows[0][1]}")
        numbers = math.prod((*rows[0][1], *shape))
        check_memory(8 * numbers, f"qpos: no memory for a result of {numbers} numbers")
        call, count = getattr(self._native, method), len(rows[0][0])
        made = np.empty((count, math.prod(shape)))
        # Ctrl-C is seen from one part to the next.
        for first in range(0, count, _PART):
            part = slice(first, first + _PART)
            given = (each[part] if isinstance(each, np.ndarray) else each for each in arguments)
            made[part] = call(*(row[part] for row, _ in rows), *given).reshape(made[part].shape)
        return made.reshape(*rows[0][1], *shape)

    @staticmethod
    def _goal(goal: Array, lead: tuple[int, ...], name: str) -> Array:
        """Poses, one for each state."""
        width = goal.shape[-1] if goal.ndim else 0
        if width not in ((2, 3) if name == "center_of_mass" else (3, 7)):
            raise ValueError(f"{name}: shape {goal.shape} does not end with 3 numbers of a position or 7 of a pose")
        whole = np.zeros((*lead, 7))
        whole[..., 3] = 1.0
        try:
            whole[..., :width] = goal
        except ValueError as error:
            raise ValueError(f"{name}: leading axes {goal.shape[:-1]} do not fit those of qpos, {lead}") from error
        if width == 7 and (np.linalg.norm(goal[..., 3:], axis=-1) < 1e-9).any():
            raise ValueError(f"{name}: the quaternion has length 0; give w, x, y, z, such as 1, 0, 0, 0")
        return whole.reshape(-1, 7)


_OF_JOINTS = ("joint_position", "joint_velocity", "joint_target", "joint_effort", "action")
_OF_BODIES = ("_pose", "_linear_velocity", "_angular_velocity", "_seated")
_BODIES = ("robot", "ladder", "old_bulb", "fresh_bulb")
"""Parts of a row: of the joints, and of bodies that may not be in every scene."""


def _refuse_text(name: str, value: Sequence[str]) -> None:
    if isinstance(value, str):
        raise ValueError(f"{name} is {value!r}; give a list of names, [{value!r}]")
