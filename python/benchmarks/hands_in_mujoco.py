"""Plays the policy `hands` in Fiatlux's physics and in MuJoCo's, from the same start states.

    python python/benchmarks/hands_in_mujoco.py --tasks S08 S06 --rooms 16

MuJoCo gets the exported scene under the options that are nearest to Fiatlux's laws (elliptic cones), without noise; the bulb is held
by contact alone. The policy is the same program, `cargo run -p fiatlux-policies --example hands -- TASK drive`, asked for targets in
each control step; `--program FILE` names it where it is built already. Fiatlux plays the rooms as an evaluation does, with noise.

S08: *grasped* is a bulb with forces above 1 N on two bodies of the right hand, *lifted* one whose lowest point is 3 cm above the
bench for a second. S06: *placed* is a bulb that lies still within the crate's walls while no hand touches it and the robot stands, for
two seconds.
"""

import argparse
import json
import re
import subprocess

import fiatlux
import mujoco
import numpy as np

STEPS = 3000
PHYSICS_STEPS = 4
SECOND = 50
TOUCH_N, LIFT_M, REST_M_S = 1.0, 0.03, 0.05
# Of the bulb and the crate: `[bulb]` and `[crate]` of crates/world/scene.toml.
AXIS = np.array([[0, 0, 0.0363], [0, 0, 0.1531]])
RADII = np.array([0.0076, 0.0396])
CRATE_HALF, CRATE_RIM, BENCH = np.array([0.2873, 0.1876]), 0.17, 0.9941
BULB = {"S06": "old_bulb", "S08": "fresh_bulb"}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tasks", nargs="+", choices=sorted(BULB), default=["S08", "S06"])
    parser.add_argument("--first", type=int, default=1000, help="first room")
    parser.add_argument("--rooms", type=int, default=16)
    parser.add_argument("--program", help="the example `hands`, built")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()

    cargo = ["cargo", "run", "--quiet", "-p", "fiatlux-policies", "--example", "hands", "--"]
    program = [args.program] if args.program else cargo
    rooms = range(args.first, args.first + args.rooms)
    report = {"fiatlux": fiatlux.__version__, "mujoco": mujoco.__version__, "rooms": [rooms[0], rooms[-1]]}
    for task in args.tasks:
        played = [play(task, room, program) for room in rooms]
        found = {name: sum(end[name] for end in played) for name in played[0] if name != "room"}
        failed = [end["room"] for end in played if not end["succeeded"]]
        report[task] = {"mujoco": found, "mujoco failed in": failed, "fiatlux": play_ours(task, rooms, program)}
        if not args.json:
            print(f"{task}, {len(rooms)} rooms:", json.dumps(report[task]), flush=True)
    if args.json:
        print(json.dumps(report))


def play_ours(task, rooms, program):
    """Successes in Fiatlux, strict."""
    seen = subprocess.run([*program, task, f"{rooms[0]}..{rooms[-1]}"], check=True, capture_output=True, text=True)
    return int(re.search(r"^(\d+) of \d+;", seen.stdout, re.MULTILINE)[1])


class Scene:
    """The exported start state of a room, and what the policy sees of it."""

    def __init__(self, task, room, joints, hand_bodies):
        env = fiatlux.Env(task, noise=False)
        env.reset(seed=room)
        self.model = mujoco.MjModel.from_xml_string(env.to_mjcf(True))
        env.close()
        self.data = mujoco.MjData(self.model)
        if self.model.nkey:
            mujoco.mj_resetDataKeyframe(self.model, self.data, 0)
        names = [name for name, _ in joints]
        self.q0 = np.array([q0 for _, q0 in joints])
        ids = [self.model.joint(name).id for name in names]
        self.places, self.rates = self.model.jnt_qposadr[ids], self.model.jnt_dofadr[ids]
        actuators = {self.model.actuator_trnid[index, 0]: index for index in range(self.model.nu)}
        self.drives = [actuators[joint] for joint in ids]
        self.pelvis = self.model.body("pelvis")
        free = self.model.body_jntadr[self.pelvis.id]
        self.base = self.model.jnt_dofadr[free]
        self.hands = {self.model.body(self.merged(name)).id: index for index, name in enumerate(hand_bodies)}
        self.bulb = self.model.body(BULB[task]).id
        self.hand_count = len(hand_bodies)
        mujoco.mj_forward(self.model, self.data)
        self.staged = (self.data.ctrl[self.drives] - self.q0) / 0.5
        self.crate = self.crate_pose()

    def merged(self, name):
        """The body that a link became a part of: palms are welded to wrists."""
        known = {self.model.body(index).name for index in range(self.model.nbody)}
        side = "right" if name.startswith(("right", "R_")) else "left"
        return name if name in known else f"{side}_wrist_yaw_link"

    def crate_pose(self):
        """Of the middle of its base; the crate's sides are along the room's."""
        geoms = [self.model.geom(index) for index in range(self.model.ngeom)]
        walls = np.array([self.data.geom_xpos[geom.id] for geom in geoms if geom.name.startswith("crate")])
        middle = (walls.min(axis=0) + walls.max(axis=0)) / 2
        return [middle[0], middle[1], 0.0, 1.0, 0.0, 0.0, 0.0]

    def forces(self):
        """Of the bulb on each sensed hand body, world axes, N."""
        forces, force = np.zeros((self.hand_count, 3)), np.zeros(6)
        for index in range(self.data.ncon):
            contact = self.data.contact[index]
            first, second = self.model.geom_bodyid[[contact.geom1, contact.geom2]]
            for hand, other, sign in ((first, second, -1.0), (second, first, 1.0)):
                if other == self.bulb and hand in self.hands:
                    mujoco.mj_contactForce(self.model, self.data, index, force)
                    forces[self.hands[hand]] += sign * contact.frame.reshape(3, 3).T @ force[:3]
        return forces

    def pose(self, body):
        return [*self.data.xpos[body], *self.data.xquat[body]]

    def seen(self, step, action):
        world_from_pelvis = self.data.xmat[self.pelvis.id].reshape(3, 3)
        velocity = self.data.qvel[self.base : self.base + 6]
        body = self.model.body
        return {
            "step": step,
            "base_angular_velocity": velocity[3:].tolist(),
            "projected_gravity": (-world_from_pelvis[2]).tolist(),
            "base_linear_velocity": (world_from_pelvis.T @ velocity[:3]).tolist(),
            "base_height": float(self.data.xpos[self.pelvis.id, 2]),
            "joint_position": (self.data.qpos[self.places] - self.q0).tolist(),
            "joint_velocity": self.data.qvel[self.rates].tolist(),
            "hand_contact_force": self.forces().ravel().tolist(),
            "last_action": list(action),
            "robot": self.pose(self.pelvis.id),
            "ladder": self.pose(body("ladder").id),
            "socket": [0.0, 0.0, 2.2, 1.0, 0.0, 0.0, 0.0],
            "fresh_bulb": self.pose(body("fresh_bulb").id),
            "old_bulb": self.pose(body("old_bulb").id),
            "crate": self.crate,
        }

    def bulb_points(self):
        """Bottom of the cap and centre of the glass, and the height of the lowest point."""
        turned = self.data.xmat[self.bulb].reshape(3, 3)
        points = self.data.xpos[self.bulb] + AXIS @ turned.T
        # The cap's bottom is flat, the glass round.
        below = RADII * [np.linalg.norm(turned[:2, 2]), 1.0]
        return points, float((points[:, 2] - below).min())


def play(task, room, program):
    """Plays a room in MuJoCo."""
    with subprocess.Popen(
        [*program, task, "drive"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as policy:
        session = json.loads(policy.stdout.readline())
        scene = Scene(task, room, session["joints"], session["hand_bodies"])
        end = {"room": room, "grasped": False, "succeeded": False}
        action, sustained = scene.staged, 0
        for step in range(STEPS):
            policy.stdin.write(json.dumps(scene.seen(step, action)) + "\n")
            policy.stdin.flush()
            targets = np.array(json.loads(policy.stdout.readline())["targets"])
            action = (targets - scene.q0) / 0.5
            scene.data.ctrl[scene.drives] = targets
            mujoco.mj_step(scene.model, scene.data, nstep=PHYSICS_STEPS)
            mujoco.mj_forward(scene.model, scene.data)
            if scene.data.xpos[scene.pelvis.id, 2] < 0.35:
                break
            end["grasped"] |= bool((np.linalg.norm(scene.forces(), axis=1) > TOUCH_N).sum() >= 2)
            sustained = sustained + 1 if is_done(task, scene) else 0
            if sustained == (2 * SECOND if task == "S06" else SECOND):
                end["succeeded"] = True
                break
        policy.stdin.close()
    return end


def is_done(task, scene):
    points, lowest = scene.bulb_points()
    forces = np.linalg.norm(scene.forces(), axis=1)
    if task == "S08":
        return lowest > BENCH + LIFT_M and (forces > TOUCH_N).sum() >= 2
    free = scene.model.jnt_dofadr[scene.model.body_jntadr[scene.bulb]]
    inside = (np.abs(points[:, :2] - scene.crate[:2]) + RADII[:, None] < CRATE_HALF + 0.003).all()
    below = (points[:, 2] + RADII).max() < CRATE_RIM
    rests = np.linalg.norm(scene.data.qvel[free : free + 3]) < REST_M_S
    return inside and below and rests and (forces < TOUCH_N).all()


if __name__ == "__main__":
    main()
