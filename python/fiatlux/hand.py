"""Actions of one hand on top of the whole-body controller, for policies that take things: twist of the right palm, grip, and steps."""

from collections.abc import Mapping
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .baseline import Baseline, Network, format_of
from .poses import conjugate, heading, multiply, of_vector, rotate, to_vector
from .whole_body import ARMS, LEGS_AND_WAIST, WholeBodies

FORMAT = "fiatlux-hand/1"
"""Name and version of the contract's layout."""

REPEAT = 4
"""Control steps of a decision."""
ACTIONS = 10
"""Numbers of an action: where the palm goes and how it turns, relative to the grasp; rates of thumb and fingers; where the bulb is
wanted before the robot, forwards and to the left."""
CONTROL_DT = 0.02
PALM_RANGE, PALM_TURN = 0.08, 0.2
"""Distance of the palm's goal from the grasp at an action of 1, along each axis of the palm, m, and its turn, rad."""
PALM_SPEED, TURN_SPEED = 0.2, 1.0
"""Fastest that the palm's goal moves, m/s and rad/s."""
LEAD, TURN_LEAD = 0.06, 0.4
"""Farthest that the goal is from the palm, m and rad."""
GRIP_STEP = 0.15
"""Change of the grip in a decision at an action of 1: 0 is open, 1 is closed."""
PLACE_RANGE = 0.05
"""Change of the place at an action of 1, m."""
NEAR, FAR = 0.04, 0.09
"""The robot steps where it is farther from its place than the second number, until it is nearer than the first, m."""
SPEED, MIN_SPEED, TURN_GAIN = 0.2, 0.1, 1.0
"""Of the steps, m/s, and rate of turning for an error of the heading, 1/s."""
HEIGHT = 0.77
"""Of the pelvis, m."""
CLEARANCE = 0.05
"""Height above the bulb's origin on the bench below which the palm is low, m."""
OUT, ASIDE = 0.22, (0.15, -0.40)
"""A low palm that is farther ahead than this goes back before it goes up, and where it comes up, in the pelvis's frame, m."""
LEFT = np.array([0.12, 0.25, 0.02])
"""Where the left palm is kept: in front, it would hold the robot off the bench, m."""
LIFTED = 0.01
"""Height above the bench from which the bulb is off it, m."""
LARGEST_ACTION = 3.0
SENSORS = ["proprioception", "hand_contact", "privileged"]

Array = NDArray[np.float64]


def _limited(v: Array, length: float) -> Array:
    """Vectors no longer than that."""
    return v * np.minimum(1.0, length / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-9))


class HandActions:
    """Turns decisions into joint targets, and observations into what a policy sees; for one world or many.

    Args:
        task: What there is to be known of the hand and the bulb, as :func:`fiatlux.train.hand.grasp` finds it: ``closed`` (targets of
            the closed right hand, rad), ``thumb`` (which of them are the thumb's), ``height`` (of the bulb's origin on the bench,
            m), ``glass`` (height of the glass above the bulb's origin, m), ``centre`` (of the glass in the palm's frame when it is
            grasped, m), ``turn`` (quaternion of the palm in the pelvis's frame then), and ``place`` (of the bulb before the pelvis
            then, m).
        num_envs: Number of worlds.
        num_threads: Number of threads.
    """

    def __init__(self, task: Mapping[str, Any], num_envs: int = 1, num_threads: int = 1) -> None:
        self.closed = np.asarray(task["closed"], np.float64)
        self.thumb = np.asarray(task["thumb"], np.bool_)
        self.height, self.glass = float(task["height"]), float(task["glass"])
        self.centre, self.turn, self.place = (
            np.asarray(task[name], np.float64) for name in ("centre", "turn", "place")
        )
        self.bodies = WholeBodies(num_envs, num_threads)
        self.num_envs = num_envs
        self.goal, self.left = np.zeros((num_envs, 7)), np.zeros((num_envs, 7))
        self.grip = np.zeros((num_envs, 2))
        self.anchor = np.zeros((num_envs, 3))
        self.heading = np.zeros(num_envs)
        self.steps = np.zeros(num_envs, np.bool_)
        self.velocity = np.zeros((num_envs, 3))
        self.last = np.zeros((num_envs, ACTIONS))
        self.seen: dict[str, Array] = {}

    def __repr__(self) -> str:
        return f"<fiatlux.HandActions: {self.num_envs} worlds, {ACTIONS} numbers a decision>"

    def observe(self, fields: Mapping[str, Any]) -> None:
        """Takes an observation of all worlds, field by field."""
        names = ("base_angular_velocity", "projected_gravity", "base_linear_velocity", "base_height")
        read = lambda name: np.asarray(fields[name], np.float64).reshape(self.num_envs, -1)  # noqa: E731
        seen = {name: read(name) for name in (*names, "joint_position", "joint_velocity")}
        self.sensed = np.concatenate([*seen.values()], axis=1)
        seen["pelvis"], seen["turn"] = read("privileged.robot_position"), read("privileged.robot_quaternion")
        bulb, bulb_turn = read("privileged.fresh_bulb_position"), read("privileged.fresh_bulb_quaternion")
        force = read("right_hand_contact").reshape(self.num_envs, -1, 3)
        seen["force"] = np.linalg.norm(force, axis=2)
        seen["left"], palm = np.moveaxis(self.bodies.palms(self.sensed), 1, 0)
        seen["palm"], seen["palm_turn"] = palm[:, :3], palm[:, 3:]
        seen["palm_height"] = seen["pelvis"][:, 2] + rotate(seen["turn"], seen["palm"])[:, 2]
        up = rotate(bulb_turn, np.broadcast_to([0.0, 0.0, 1.0], bulb.shape))
        back = conjugate(seen["turn"])
        seen["up"], seen["bulb"] = rotate(back, up), rotate(back, bulb - seen["pelvis"])
        glass = rotate(back, bulb + self.glass * up - seen["pelvis"])
        into = conjugate(seen["palm_turn"])
        seen["centre"], seen["axis"] = rotate(into, glass - seen["palm"]), rotate(into, seen["up"])
        seen["twist"] = to_vector(multiply(np.broadcast_to(self.turn, palm[:, 3:].shape), into))
        seen["risen"] = bulb[:, 2:] - self.height
        seen["place"] = bulb[:, :2]
        seen["heading"] = heading(seen["turn"])
        rests = seen["risen"][:, 0] < LIFTED
        self.anchor[rests] = np.concatenate((bulb[:, :2], np.full((self.num_envs, 1), self.height + self.glass)), 1)[
            rests
        ]
        seen["upright"] = up[:, 2:]
        self.seen = seen

    def begin(self, marks: NDArray[np.bool_]) -> None:
        """Begins an episode in the marked worlds, of which the last observation is the first."""
        self.bodies.reset(marks)
        seen = self.seen
        goal = np.concatenate(self._world(seen["palm"], seen["palm_turn"]), axis=1)
        self.goal[marks], self.left[marks] = goal[marks], seen["left"][marks]
        hand = seen["joint_position"][:, -len(self.closed) :]
        for part, fingers in enumerate((self.thumb, ~self.thumb)):
            closed = self.closed[fingers]
            share = hand[:, fingers] @ closed / (closed @ closed)
            # A hand that feels the bulb presses.
            held = seen["force"].max(axis=1) > 0.3
            self.grip[marks, part] = np.where(held, 1.0, share.clip(0.0, 1.0))[marks]
        # A bulb that is off the bench already was lifted straight up.
        self.anchor[marks] = np.concatenate((seen["place"], np.full((self.num_envs, 1), self.height + self.glass)), 1)[
            marks
        ]
        self.heading[marks] = seen["heading"][marks]
        self.steps[marks] = False
        self.last[marks] = 0.0

    def _world(self, position: Array, turn: Array) -> tuple[Array, Array]:
        """A pose in the pelvis frame as one in the world."""
        return self.seen["pelvis"] + rotate(self.seen["turn"], position), multiply(self.seen["turn"], turn)

    def decide(self, action: NDArray[Any]) -> None:
        """Takes a decision, for the control steps that follow."""
        action = np.clip(
            np.asarray(action, np.float64).reshape(self.num_envs, ACTIONS), -LARGEST_ACTION, LARGEST_ACTION
        )
        self.last = action
        self.grip = np.clip(self.grip + GRIP_STEP * action[:, 6:8], 0.0, 1.0)

    def _walk(self) -> Array:
        """Velocities that bring the bulb to its place before the robot."""
        seen = self.seen
        apart = self._flat() - self.place - PLACE_RANGE * self.last[:, 8:10]
        distance = np.linalg.norm(apart, axis=1)
        self.steps = np.where(self.steps, distance > NEAR, distance > FAR) & ~self._is_low()
        speed = np.clip(distance, MIN_SPEED, SPEED) / np.maximum(distance, 1e-9)
        turned = (self.heading - seen["heading"] + np.pi) % (2 * np.pi) - np.pi
        velocity = np.concatenate((apart * speed[:, None], TURN_GAIN * turned[:, None]), axis=1)
        return np.where(self.steps[:, None], velocity, 0.0)

    def _is_low(self) -> NDArray[np.bool_]:
        """True where the palm is not clear of the bench's top."""
        low: NDArray[np.bool_] = self.seen["palm_height"] < self.height + CLEARANCE
        return low

    def _flat(self) -> Array:
        """Where the bulb stands, or stood, before the pelvis on the level, m."""
        apart = self.anchor[:, :2] - self.seen["pelvis"][:, :2]
        cos, sin = np.cos(self.seen["heading"]), np.sin(self.seen["heading"])
        return np.stack((cos * apart[:, 0] + sin * apart[:, 1], cos * apart[:, 1] - sin * apart[:, 0]), 1)

    def targets(self) -> Array:
        """Joint targets of the next control step, rad, for the last observation."""
        seen = self.seen
        self.velocity = velocity = self._walk()
        back = conjugate(seen["turn"])
        # The grasp, and the goal beside it.
        wanted_turn = multiply(of_vector(PALM_TURN * self.last[:, 3:6]), np.broadcast_to(self.turn, (self.num_envs, 4)))
        offset = rotate(wanted_turn, PALM_RANGE * self.last[:, :3] - self.centre)
        wanted = rotate(back, self.anchor - seen["pelvis"]) + offset
        # A hand below the bench's top goes back first, then up beside the robot, or it would catch on the bench's edge.
        low = self._is_low()
        up = np.where(
            seen["palm"][:, 0] > OUT, seen["palm"][:, 2], self.anchor[:, 2] - seen["pelvis"][:, 2] + CLEARANCE
        )
        wanted[low, :2], wanted[low, 2] = ASIDE, up[low]
        position = rotate(back, self.goal[:, :3] - seen["pelvis"])
        turn = multiply(back, self.goal[:, 3:])
        position += _limited(wanted - position, PALM_SPEED * CONTROL_DT)
        turn = multiply(
            of_vector(_limited(to_vector(multiply(wanted_turn, conjugate(turn))), TURN_SPEED * CONTROL_DT)), turn
        )
        # A hand that is blocked does not wind up.
        position = seen["palm"] + _limited(position - seen["palm"], LEAD)
        twist = _limited(to_vector(multiply(turn, conjugate(seen["palm_turn"]))), TURN_LEAD)
        turn = multiply(of_vector(twist), seen["palm_turn"])
        self.goal = np.concatenate(self._world(position, turn), axis=1)
        self.goal[:, 3:] /= np.linalg.norm(self.goal[:, 3:], axis=1, keepdims=True)
        self.left[:, :3] += _limited(LEFT - self.left[:, :3], PALM_SPEED * CONTROL_DT)
        goals = np.stack((self.left, np.concatenate((position, turn), axis=1)), axis=1)
        commands = np.zeros((self.num_envs, 7))
        commands[:, :3], commands[:, 3] = velocity, HEIGHT
        joints = seen["joint_position"].shape[1]
        targets = np.zeros((self.num_envs, joints))
        targets[:, : LEGS_AND_WAIST + ARMS] = self.bodies(self.sensed, commands, goals)
        share = np.where(self.thumb, self.grip[:, :1], self.grip[:, 1:])
        targets[:, -len(self.closed) :] = share * self.closed
        return targets

    def features(self) -> NDArray[np.float32]:
        """The policy's view of the last observation, worlds x numbers."""
        seen = self.seen
        goal = rotate(conjugate(seen["turn"]), self.goal[:, :3] - seen["pelvis"]) - seen["palm"]
        turn = to_vector(multiply(multiply(conjugate(seen["turn"]), self.goal[:, 3:]), conjugate(seen["palm_turn"])))
        arm = seen["joint_position"][:, LEGS_AND_WAIST + ARMS // 2 : LEGS_AND_WAIST + ARMS]
        axes = [rotate(seen["palm_turn"], np.broadcast_to(axis, (self.num_envs, 3))) for axis in np.eye(3)[:2]]
        parts = (
            5.0 * (seen["centre"] - self.centre),
            np.exp(-np.linalg.norm(seen["centre"] - self.centre, axis=1, keepdims=True) / 0.05),
            seen["axis"],
            seen["up"],
            2.0 * seen["twist"],
            5.0 * (self._flat() - self.place),
            5.0
            * rotate(
                conjugate(seen["palm_turn"]),
                rotate(conjugate(seen["turn"]), self.anchor - seen["pelvis"]) - seen["palm"],
            ),
            5.0 * rotate(seen["palm_turn"], seen["centre"] - self.centre),
            seen["bulb"],
            seen["palm"],
            *axes,
            20.0 * goal,
            5.0 * turn,
            seen["projected_gravity"],
            seen["base_angular_velocity"],
            seen["base_linear_velocity"],
            10.0 * (seen["base_height"] - HEIGHT),
            arm,
            seen["joint_position"][:, -len(self.closed) :],
            np.tanh(seen["force"] / 3.0),
            20.0 * seen["risen"],
            self.grip,
            self.velocity / SPEED,
            self.last / LARGEST_ACTION,
        )
        return np.concatenate(parts, axis=1).astype(np.float32).clip(-10.0, 10.0)


class HandPolicy:
    """The policy of a file that ``python -m fiatlux.train export`` wrote from a run of ``hand``; it sees exact poses::

        fiatlux.evaluate(fiatlux.hand.HandPolicy("s08.safetensors"), tasks=["S08"])

    Args:
        file: The file.

    Raises:
        ValueError: It is not such a file, or it is damaged.
    """

    action_form = "joint_target"
    sensors = SENSORS

    def __init__(self, file: str | PathLike[str]) -> None:
        self._network = Network(file, FORMAT, "hand")
        self.contract = self._network.contract
        try:
            HandActions(self.contract["grasp"])
        except (KeyError, TypeError) as error:
            raise ValueError(f"{file}: its contract lacks {error}; export a checkpoint of hand again") from error
        self.__name__ = f"hand:{self._network.name}"
        self._hand: HandActions | None = None
        self._step = 0

    def __repr__(self) -> str:
        return f"<fiatlux.hand.HandPolicy {self.__name__}>"

    def reset(self, info: Mapping[str, Any]) -> None:
        """Begins an episode."""
        self._hand = None

    def __call__(self, observation: Any) -> Array:
        """The joint targets that answer an observation, rad."""
        if not isinstance(observation, Mapping):
            raise ValueError("HandPolicy: give the observation as a dictionary of fields")
        begins = self._hand is None
        if self._hand is None:
            self._hand, self._step = HandActions(self.contract["grasp"]), 0
        self._hand.observe(observation)
        if begins:
            self._hand.begin(np.ones(1, np.bool_))
        if self._step % REPEAT == 0:
            self._hand.decide(self._network(self._hand.features()[0]))
        self._step += 1
        return self._hand.targets()[0]


def load_policy(file: str | PathLike[str]) -> Baseline | HandPolicy:
    """The policy of an exported file: of a run of ``ppo`` or of ``hand``, as its contract says.

    Raises:
        ValueError: It is neither, or it is damaged.
    """
    return HandPolicy(file) if format_of(file) == FORMAT else Baseline(file)
