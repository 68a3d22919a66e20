"""Lets a policy play the same rooms in Fiatlux's physics and in MuJoCo's.

    python python/benchmarks/policy_in_mujoco.py climb --tasks S02 S12 --rooms 16

MuJoCo gets the exported start state: with elliptic cones under the options that are nearest to Fiatlux's laws, with pyramids under its own
defaults. `--impratio` sets how much stiffer friction is than the normal force, which MuJoCo has at 1 by default. Bulbs are held by contact alone; the socket's hold is the law of `crates/world/src/attach.rs`, once per
control step. The policy is one program for all simulators, `cargo run -p fiatlux-policies --example drive -- POLICY TASK ROOM`, asked for
targets in each control step; `--program FILE` names it where it is built already. Both sides have the benchmark's noise of sensors, without
which a robot that walks slowly may stop short of its place.

Fiatlux's judge says *succeeded* by the strict gate. In MuJoCo it is the gate's conditions as `is_done` has them, for a second (S06: two).
*Grasped* is a bulb with forces above 1 N on two bodies of one hand, *lifted* one of S08 that is grasped 3 cm above the bench, *pulled* one
that the socket let go of. A bulb that fell to the floor is *dropped*, and ends the episode, as in Fiatlux. *Bore* counts the rooms in
which a foot bore 20 N on the floor, each tread and the platform, and *tilt* is the ladder's largest, rad.
"""

import argparse
import functools
import json
import pathlib
import subprocess

import fiatlux
import mujoco
import numpy as np
import tomllib

STEPS, PHYSICS_STEPS, SECOND = 6000, 4, 50
SENSORS = ["proprioception", "hand_contact", "last_action", "privileged"]
POSES = ("robot", "ladder", "socket", "fresh_bulb", "old_bulb", "crate")
BULBS = ("old_bulb", "fresh_bulb")
# Half-widths of the uniform noise of sensors, as in `crates/sensing/src/observer.rs`.
NOISE = {
    "base_angular_velocity": 0.2,
    "projected_gravity": 0.05,
    "base_linear_velocity": 0.1,
    "base_height": 0.05,
    "joint_position": 0.01,
    "joint_velocity": 1.5,
}
BULB = {
    "S03": "old_bulb",
    "S04": "old_bulb",
    "S06": "old_bulb",
    "S08": "fresh_bulb",
    "S10": "fresh_bulb",
    "S11": "fresh_bulb",
}
TASKS = ("S01", "S02", "S03", "S04", "S06", "S08", "S10", "S11", "S12", "climb")
FEET = ("left_ankle_roll_link", "right_ankle_roll_link")
LEVELS = ("room_floor", *(f"ladder_tread_{tread}" for tread in range(4)), "ladder_platform")
TREADS = slice(2, None)  # from 0.47 m
TOUCH_N, LOADED_N, LIFT_M, REST_M_S, TILT, FALLEN_M, FLOOR_M = 1.0, 20.0, 0.03, 0.05, 0.5, 0.35, 0.02
SCENE = tomllib.loads((pathlib.Path(__file__).parents[2] / "crates/world/scene.toml").read_text())
HOLD, BENCH, SHAPE = SCENE["attachment"], SCENE["bench"]["surface_height"], SCENE["bulb"]
# Bottom of the cap and centre of the glass on the bulb's axis, and their radii.
(GLASS, _, WIDEST), (_, CAP) = SHAPE["solids"][-1], SHAPE["outline"][0]
AXIS, RADII = np.array([[0, 0, SHAPE["seat_z"]], [0, 0, GLASS]]), np.array([CAP, WIDEST])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("policy", help="such as climb")
    parser.add_argument("--tasks", nargs="+", choices=TASKS, required=True)
    parser.add_argument("--first", type=int, default=1000, help="first room")
    parser.add_argument("--rooms", type=int, default=16)
    parser.add_argument("--steps", type=int, default=STEPS, help="control steps of an episode at most")
    parser.add_argument("--simulators", nargs="+", choices=SIMULATORS, default=list(SIMULATORS))
    parser.add_argument(
        "--impratio", nargs="+", type=float, default=[1.0, 100.0], help="values for each of MuJoCo's cones"
    )
    parser.add_argument("--time-constant", type=float, help="of MuJoCo's contacts, s [default: its own, 0.02]")
    parser.add_argument("--program", help="the example `drive`, built")
    parser.add_argument("--each", action="store_true", help="also print each episode")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()

    cargo = ["cargo", "run", "--quiet", "-p", "fiatlux-policies", "--example", "drive", "--"]
    program = [args.program] if args.program else cargo
    rooms = range(args.first, args.first + args.rooms)
    report = {"fiatlux": fiatlux.__version__, "mujoco": mujoco.__version__, "rooms": [rooms[0], rooms[-1]]}
    worlds = {}
    for name in args.simulators:
        if name == "fiatlux":
            worlds[name] = Fiatlux
        else:
            for ratio in args.impratio:
                worlds[f"{name} {ratio:g}"] = functools.partial(
                    Mujoco, nearest=name == "elliptic", impratio=ratio, time_constant=args.time_constant
                )
    for task in args.tasks:
        report[task] = {}
        for name, world in worlds.items():
            ends = []
            for room in rooms:
                ends.append(play(world, [*program, args.policy, task, str(room)], task, room, args.steps))
                if args.each:
                    print(task, name, json.dumps(ends[-1]), flush=True)
            report[task][name] = summary(ends)
            if not args.json:
                print(f"{task}, {name}, {len(rooms)} rooms:", json.dumps(report[task][name]), flush=True)
    if args.json:
        print(json.dumps(report))


def summary(ends):
    """Sums over rooms, the largest tilt, and the rooms that failed."""
    names = [name for name in ends[0] if name not in ("room", "seconds")]
    sums = {name: (max if name == "tilt" else sum_of)([end[name] for end in ends]) for name in names}
    return {**sums, "failed in": [end["room"] for end in ends if not end["succeeded"]]}


def sum_of(numbers):
    return np.sum(numbers, axis=0).tolist()


def play(simulator, command, task, room, steps):
    """Plays a room in a simulator."""
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as policy:
        session = json.loads(policy.stdout.readline())
        world = simulator(task, room, session)
        step = 0
        while step < steps and not world.is_over:
            policy.stdin.write(json.dumps({"step": step, **world.seen()}) + "\n")
            policy.stdin.flush()
            world.step(np.array(json.loads(policy.stdout.readline())["targets"]))
            step += 1
        policy.stdin.close()
    return {"room": room, "seconds": step / SECOND, **world.end()}


class Fiatlux:
    """A room in Fiatlux, as far as the policy sees it."""

    def __init__(self, task, room, session):
        self.env = fiatlux.Env(task, sensors=SENSORS)
        self.q0 = np.array([q0 for _, q0 in session["joints"]])
        self.observation, _ = self.env.reset(seed=room)
        self.is_over = False

    def seen(self):
        seen = {name: np.asarray(field, float).ravel().tolist() for name, field in self.observation.items()}
        of = {name: seen.pop(name) for name in list(seen) if "." in name}
        # `climb` has robot and ladder only.
        position, turn = "privileged.{}_position", "privileged.{}_quaternion"
        poses = {
            name: of.get(position.format(name), [0.0] * 3) + of.get(turn.format(name), [1.0, 0.0, 0.0, 0.0])
            for name in POSES
        }
        force = seen.pop("right_hand_contact") + seen.pop("left_hand_contact")
        seated = [held > 0 for held in of.get("privileged.seated", [0.0, 0.0])]
        return {**seen, "base_height": seen["base_height"][0], "hand_contact_force": force, **poses, "seated": seated}

    def step(self, targets):
        self.observation, _, terminated, truncated, _ = self.env.step((targets - self.q0) / 0.5)
        self.is_over = terminated or truncated

    def end(self):
        found = self.env.summary()
        self.env.close()
        return {"succeeded": bool(found["strict_success"])}


class Mujoco:
    """The exported start state of a room."""

    def __init__(self, task, room, session, nearest, impratio, time_constant):
        ours = Fiatlux(task, room, session)
        self.fixed = ours.seen()
        self.model = mujoco.MjModel.from_xml_string(ours.env.to_mjcf(nearest))
        ours.env.close()
        self.model.opt.impratio = impratio
        if time_constant is not None:
            self.model.geom_solref[:] = [time_constant, 1.0]
        self.task, self.data, self.noise = task, mujoco.MjData(self.model), np.random.default_rng(room)
        mujoco.mj_resetDataKeyframe(self.model, self.data, 0)
        body = {self.model.body(index).name: index for index in range(self.model.nbody)}
        self.q0 = ours.q0
        joints = [self.model.joint(name).id for name, _ in session["joints"]]
        self.places, self.rates = self.model.jnt_qposadr[joints], self.model.jnt_dofadr[joints]
        actuators = {self.model.actuator_trnid[index, 0]: index for index in range(self.model.nu)}
        self.drives = [actuators[joint] for joint in joints]
        self.bodies = {
            name: body[name if name != "robot" else "pelvis"] for name in POSES if name in body or name == "robot"
        }
        self.pelvis = body["pelvis"]
        self.base = self.model.jnt_dofadr[self.model.body_jntadr[self.pelvis]]
        self.robot = set(np.flatnonzero(self.model.body_rootid == self.pelvis))
        self.hand_count = len(session["hand_bodies"])
        # Palms are welded to wrists.
        wrist = {True: "right_wrist_yaw_link", False: "left_wrist_yaw_link"}
        names = [name if name in body else wrist[name.startswith(("right", "R_"))] for name in session["hand_bodies"]]
        self.hands = {body[name]: index for index, name in enumerate(names)}
        self.feet = [body[name] for name in FEET]
        geoms = {self.model.geom(index).name: index for index in range(self.model.ngeom)}
        self.levels = {geoms[name]: level for level, name in enumerate(LEVELS)}
        self.bulbs = [body[name] for name in BULBS if name in body]
        self.bulb = body.get(BULB.get(task))
        self.held = [int(self.fixed["seated"].index(True)) if any(self.fixed["seated"]) else None, 0]
        self.action = (self.data.ctrl[self.drives] - self.q0) / 0.5
        mujoco.mj_forward(self.model, self.data)
        self.sense()
        self.found = {"succeeded": False, "fell": False, "tilt": 0.0, "bore": np.zeros(len(LEVELS), int)}
        if self.bulb is not None:
            self.found |= {"grasped": False, "dropped": False}
        if task == "S08":
            self.found["lifted"] = False
        if task == "S03":
            self.found["pulled"] = False
        self.sustained, self.is_over = 0, False

    def sense(self):
        """Forces of all bulbs and of the task's own on the hands' bodies, world axes, and of each level on each foot upwards, N."""
        self.forces, self.pressed = np.zeros((self.hand_count, 3)), np.zeros((self.hand_count, 3))
        self.loads, force = np.zeros((2, len(LEVELS))), np.zeros(6)
        for index in range(self.data.ncon):
            contact = self.data.contact[index]
            pair = self.model.geom_bodyid[[contact.geom1, contact.geom2]]
            for side, sign in ((0, -1.0), (1, 1.0)):
                own, other = pair[side], pair[1 - side]
                if own not in self.robot or other in self.robot:
                    continue
                mujoco.mj_contactForce(self.model, self.data, index, force)
                world = sign * contact.frame.reshape(3, 3).T @ force[:3]
                if own in self.hands and other in self.bulbs:
                    self.forces[self.hands[own]] += world
                    if other == self.bulb:
                        self.pressed[self.hands[own]] += world
                level = self.levels.get((contact.geom2, contact.geom1)[side])
                if own in self.feet and level is not None:
                    self.loads[self.feet.index(own), level] += world[2]

    def seen(self):
        turned = self.data.xmat[self.pelvis].reshape(3, 3)
        velocity = self.data.qvel[self.base : self.base + 6]
        poses = {name: [*self.data.xpos[index], *self.data.xquat[index]] for name, index in self.bodies.items()}
        sensed = {
            "base_angular_velocity": velocity[3:],
            "projected_gravity": -turned[2],
            "base_linear_velocity": turned.T @ velocity[:3],
            "base_height": self.data.xpos[self.pelvis, 2],
            "joint_position": self.data.qpos[self.places] - self.q0,
            "joint_velocity": self.data.qvel[self.rates],
        }
        for name, width in NOISE.items():
            sensed[name] = (sensed[name] + self.noise.uniform(-width, width, np.shape(sensed[name]))).tolist()
        return {
            **self.fixed,
            **sensed,
            "hand_contact_force": self.forces.ravel().tolist(),
            "last_action": self.action.tolist(),
            "seated": [self.held[0] == bulb for bulb in range(2)],
            **poses,
        }

    def step(self, targets):
        self.action = (targets - self.q0) / 0.5
        self.data.ctrl[self.drives] = targets
        self.hold()
        mujoco.mj_step(self.model, self.data, nstep=PHYSICS_STEPS)
        mujoco.mj_forward(self.model, self.data)
        self.sense()
        found = self.found
        found["bore"] |= (self.loads > LOADED_N).any(axis=0)
        if "ladder" in self.bodies:
            found["tilt"] = max(found["tilt"], angle(self.data.xmat[self.bodies["ladder"]][8]))
        if self.bulb is not None:
            found["grasped"] |= self.in_grip()
            found["dropped"] = self.is_dropped()
        if self.task == "S08":
            found["lifted"] |= self.is_lifted()
        if self.task == "S03":
            found["pulled"] |= self.held[0] is None
        up = self.data.xmat[self.pelvis][8]
        found["fell"] = bool(up < 0.5 or self.data.xpos[self.pelvis, 2] < FALLEN_M)
        self.sustained = self.sustained + 1 if up > np.cos(TILT) and self.is_done() else 0
        found["succeeded"] = self.sustained >= (2 if self.task == "S06" else 1) * SECOND
        self.is_over = found["succeeded"] or found["fell"] or found.get("dropped", False)

    def hold(self):
        """The socket's hold over a control step, as in `crates/world/src/attach.rs`."""
        for bulb, name in enumerate(BULBS):
            if name not in self.bodies:
                continue
            body, site = self.bodies[name], self.model.site("socket_seat").id
            axis, bulb_axis = self.data.site_xmat[site].reshape(3, 3)[:, 2], self.data.xmat[body].reshape(3, 3)[:, 2]
            offset = self.data.site_xpos[self.model.site(f"{name}_plug").id] - self.data.site_xpos[site]
            gap = offset @ axis
            lateral = offset - gap * axis
            fits = np.linalg.norm(lateral) < HOLD["seat_lateral"]
            if self.held[0] == bulb:
                self.held[1] = self.held[1] + 1 if gap > HOLD["release_gap"] else 0
                if self.held[1] >= HOLD["release_steps"]:
                    self.held = [None, 0]
            elif self.held[0] is None and fits and abs(gap) <= HOLD["seat_gap"]:
                if angle(axis @ bulb_axis) < HOLD["seat_tilt"]:
                    self.held = [bulb, 0]
            self.data.xfrc_applied[body] = 0.0
            if self.held[0] == bulb and fits and gap < HOLD["hold_range"]:
                twist = np.zeros(6)
                mujoco.mj_objectVelocity(self.model, self.data, mujoco.mjtObj.mjOBJ_BODY, body, twist, 0)
                spin, velocity = twist[:3], twist[3:]
                pull = HOLD["hold_force"] * (1 - max(gap, 0) / HOLD["hold_range"])
                limit = HOLD["axial_limit"]
                axial = np.clip(-pull - HOLD["axial_damping"] * (velocity @ axis), -limit, limit)
                across = -HOLD["lateral_stiffness"] * lateral - HOLD["lateral_damping"] * (
                    velocity - velocity @ axis * axis
                )
                torque = HOLD["tilt_stiffness"] * np.cross(bulb_axis, axis) - HOLD["tilt_damping"] * (
                    spin - spin @ axis * axis
                )
                force = axial * axis + bounded(across, HOLD["lateral_limit"])
                self.data.xfrc_applied[body] = [*force, *bounded(torque, HOLD["torque_limit"])]

    def in_grip(self):
        # The right hand comes first.
        sides = (np.linalg.norm(self.pressed, axis=1) > TOUCH_N).reshape(2, -1)
        return bool((sides.sum(axis=1) >= 2).any())

    def is_done(self):
        """The conditions of the task's gate that MuJoCo's state tells."""
        pelvis, on_treads = self.data.xpos[self.pelvis], (self.loads[:, TREADS].sum(axis=1) > LOADED_N).all()
        if self.task == "climb":
            # Its ladder is a part of the room.
            return pelvis[2] > 1.82 and on_treads
        ladder = self.bodies["ladder"]
        top = self.data.xpos[ladder] + self.data.xmat[ladder].reshape(3, 3) @ SCENE["ladder"]["top_point"]
        speed = np.linalg.norm(self.data.cvel[ladder, 3:])
        on_floor = (self.loads[:, 0] > LOADED_N).all()
        held = None if self.held[0] is None else BULBS[self.held[0]]
        match self.task:
            case "S01":
                near = np.linalg.norm(top[:2] - self.fixed["socket"][:2]) < 0.67
                return near and abs(self.data.xpos[ladder, 2]) < 0.02 and speed < REST_M_S and on_floor
            case "S02" | "S10":
                near = np.linalg.norm((pelvis - top)[:2]) < 0.6 and pelvis[2] > 1.03
                return near and on_treads and (self.task == "S02" or self.in_grip())
            case "S12" | "S04":
                near = np.linalg.norm((pelvis - self.data.xpos[ladder])[:2]) < 0.6 and pelvis[2] < 0.94
                return near and on_floor and (held == "fresh_bulb" if self.task == "S12" else self.in_grip())
            case "S03":
                return held is None and self.in_grip() and on_treads
            case "S11":
                return held == "fresh_bulb" and (np.linalg.norm(self.pressed, axis=1) < TOUCH_N).all() and on_treads
        return self.is_lifted() if self.task == "S08" else self.is_placed()

    def bulb_points(self):
        """Bottom of the cap and centre of the glass, and the height of the lowest point."""
        turned = self.data.xmat[self.bulb].reshape(3, 3)
        points = self.data.xpos[self.bulb] + AXIS @ turned.T
        # The cap's bottom is flat, the glass round.
        below = RADII * [np.linalg.norm(turned[:2, 2]), 1.0]
        return points, float((points[:, 2] - below).min())

    def is_lifted(self):
        return self.bulb_points()[1] > BENCH + LIFT_M and self.in_grip()

    def is_in_crate(self):
        points, _ = self.bulb_points()
        crate, half = self.fixed["crate"], np.array(SCENE["crate"]["interior_half"])
        inside = (np.abs(points[:, :2] - crate[:2]) + RADII[:, None] < half + 0.003).all()
        return inside and (points[:, 2] + RADII).max() < SCENE["crate"]["rim_height"]

    def is_placed(self):
        free = self.model.jnt_dofadr[self.model.body_jntadr[self.bulb]]
        rests = np.linalg.norm(self.data.qvel[free : free + 3]) < REST_M_S
        return self.is_in_crate() and rests and (np.linalg.norm(self.pressed, axis=1) < TOUCH_N).all()

    def is_dropped(self):
        return self.bulb_points()[1] < FLOOR_M and not self.is_in_crate()

    def end(self):
        return {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in self.found.items()}


def angle(cosine):
    return float(np.arccos(np.clip(cosine, -1, 1)))


def bounded(vector, limit):
    norm = np.linalg.norm(vector)
    return vector * (limit / norm) if norm > limit else vector


SIMULATORS = ("fiatlux", "elliptic", "pyramids")

if __name__ == "__main__":
    main()
