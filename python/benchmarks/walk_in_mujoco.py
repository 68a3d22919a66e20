"""Runs the whole-body controller in Fiatlux's physics and in MuJoCo's, on the same commands, side by side.

    python python/benchmarks/walk_in_mujoco.py --episodes 64

Each episode draws a command of velocity every 3 to 8 s, as training does, arms at rest and no noise. MuJoCo gets the exported
robot on a floor, under the options that are nearest to Fiatlux's laws (elliptic cones) and under its own defaults (pyramids), and
the commands that the Fiatlux episode of the same number had. Both start upright in the standing posture. Errors are of one-second
means that begin 1.5 s or more after a command; slip is the mean speed of soles that bear more than 20 N.
"""

import argparse
import json
import xml.etree.ElementTree as ElementTree

import fiatlux
import mujoco
import numpy as np

STEPS = 1000
PHYSICS_STEPS = 4
SECOND, SETTLES = 50, 75
MOVED = 15
SCALES = np.array([0.5] * 12 + [0.25] * 3)
FEET = ("left_ankle_roll_link", "right_ankle_roll_link")
LOADED_N = 20.0


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=64)
    parser.add_argument("--seed", type=int, default=7)
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()

    ours, commands = play_ours(args.episodes, args.seed)
    found = {"fiatlux": ours}
    for name, nearest in (("mujoco, elliptic cones", True), ("mujoco, its defaults", False)):
        model = bare_scene(nearest)
        found[name] = summary([play_theirs(model, commands[:, episode]) for episode in range(args.episodes)])
    report = {"fiatlux": fiatlux.__version__, "mujoco": mujoco.__version__, "episodes": args.episodes, "found": found}
    if args.json:
        print(json.dumps(report))
        return
    columns = list(next(iter(found.values())))
    print(f"{args.episodes} episodes of 20 s; MuJoCo {mujoco.__version__}")
    print(f"{'':<24}" + "".join(f"{name:>12}" for name in columns))
    for name, row in found.items():
        print(f"{name:<24}" + "".join(f"{row[column]:>12.3f}" for column in columns))


class Track:
    """Sums over an episode, and its results."""

    def __init__(self):
        self.errors, self.slips, self.loads = [], [], []
        self.sums, self.since, self.command = np.zeros(3), 0, None
        self.steps = 0
        self.survived = True

    def take(self, command, velocity, foot_speeds, foot_loads):
        """Adds a control step: commanded and actual velocity (m/s, m/s, rad/s), and speed and load of the feet."""
        is_new = self.command is None or np.abs(command - self.command).max() > 1e-6
        self.command = command
        self.since = 0 if is_new else self.since + 1
        if self.since > SETTLES:
            self.sums += velocity - command
            if (self.since - SETTLES) % SECOND == 0:
                self.errors.append(np.abs(self.sums / SECOND))
                self.sums = np.zeros(3)
        else:
            self.sums = np.zeros(3)
        loaded = foot_loads > LOADED_N
        self.slips.extend(foot_speeds[loaded])
        self.loads.append(foot_loads.sum())
        self.steps += 1


def summary(tracks):
    errors = np.concatenate([np.array(track.errors).reshape(-1, 3) for track in tracks])
    slips = np.concatenate([track.slips for track in tracks])
    loads = np.concatenate([track.loads for track in tracks])
    names = ("vx m/s", "vy m/s", "wz rad/s")
    return {
        "survived": float(np.mean([track.survived for track in tracks])),
        **dict(zip(names, errors.mean(axis=0).tolist())),
        "slip m/s": float(slips.mean()),
        "slip p95": float(np.quantile(slips, 0.95)),
        "load N": float(loads.mean()),
        "load p99": float(np.quantile(loads, 0.99)),
    }


def play_ours(episodes, seed):
    """Plays the episodes in Fiatlux; returns them with their commands, an array of steps x episodes x numbers."""
    upright = {"height": (0.75, 0.75), "stand_height": (0.75, 0.75), "torso": ((0.0, 0.0),) * 3}
    env = fiatlux.WalkingVectorEnv(
        episodes,
        seed=seed,
        observation="dict",
        noise=False,
        arm_range=0.0,
        load_kg=0.0,
        hand_force_n=0.0,
        horizon_steps=STEPS + 1,
        **upright,
    )
    observation, _ = env.reset()
    bodies = [fiatlux.WholeBody() for _ in range(episodes)]
    tracks = [Track() for _ in range(episodes)]
    commands = np.zeros((STEPS, episodes, 7))
    actions = np.zeros((episodes, MOVED), np.float32)
    for step in range(STEPS):
        newest = {name: field[:, -1] if field.ndim == 3 else field for name, field in observation.items()}
        commands[step] = newest["command"]
        for world, body in enumerate(bodies):
            if tracks[world].survived:
                seen = {name: field[world] for name, field in newest.items()}
                seen["joint_position"] = np.concatenate((seen["joint_position"], seen["arm_position"]))
                targets = body(seen, **command_of(commands[step, world]))
                actions[world] = (targets - body.q0[:MOVED]) / SCALES
        observation, _, terminated, _, _ = env.step(actions)
        for world, track in enumerate(tracks):
            track.survived &= not terminated[world]
            if track.survived:
                moving = observation["privileged.velocity"][world]
                feet = observation["privileged.foot_velocity"][world].reshape(2, 3)
                loads = observation["privileged.foot_load"][world]
                track.take(commands[step, world, :3], moving[[0, 1, 5]], np.linalg.norm(feet[:, :2], axis=1), loads)
    env.close()
    return summary(tracks), commands


def command_of(numbers):
    """A command from velocities only, at the standing height used in training."""
    return dict(zip(("vx", "vy", "wz"), map(float, numbers[:3])))


def bare_scene(nearest):
    """The exported robot on an empty floor."""
    env = fiatlux.Env("S05", noise=False)
    env.reset(seed=1000)
    root = ElementTree.fromstring(env.to_mjcf(nearest))
    world = root.find("worldbody")
    gone = set()
    for child in list(world):
        keeps = child.tag == "light" or child.get("name") in ("pelvis", "room_floor")
        if not keeps:
            gone.update(part.get("name") for part in child.iter() if part.get("name"))
            world.remove(child)
    for tag in ("keyframe", "custom"):
        for part in root.findall(tag):
            root.remove(part)
    for contact in root.findall("contact"):
        for pair in list(contact):
            if gone & {pair.get("body1"), pair.get("body2"), pair.get("geom1"), pair.get("geom2")}:
                contact.remove(pair)
    return mujoco.MjModel.from_xml_string(ElementTree.tostring(root, encoding="unicode"))


def play_theirs(model, commands):
    """Plays an episode in MuJoCo, from the standing posture."""
    data = mujoco.MjData(model)
    body = fiatlux.WholeBody()
    joints = [model.actuator_trnid[index, 0] for index in range(model.nu)]
    names = [model.joint(joint).name for joint in joints]
    places, rates = model.jnt_qposadr[joints], model.jnt_dofadr[joints]
    q0 = np.zeros(model.nu)
    own = [names.index(name) for name in body.joint_names]
    q0[own] = body.q0
    data.qpos[:7] = [0, 0, 0.79, 1, 0, 0, 0]
    data.qpos[places] = q0
    data.ctrl[:] = q0
    mujoco.mj_forward(model, data)
    pelvis, feet = model.body("pelvis").id, [model.body(name).id for name in FEET]
    track = Track()
    for command in commands:
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, data.qpos[3:7])
        world_from_pelvis = turn.reshape(3, 3)
        seen = {
            "base_angular_velocity": data.qvel[3:6],
            "projected_gravity": -world_from_pelvis[2],
            "base_linear_velocity": world_from_pelvis.T @ data.qvel[:3],
            "base_height": data.qpos[2:3],
            "joint_position": (data.qpos[places] - q0)[own],
            "joint_velocity": data.qvel[rates][own],
        }
        data.ctrl[own[:MOVED]] = body(seen, **command_of(command))
        before = data.xpos[feet].copy()
        mujoco.mj_step(model, data, nstep=PHYSICS_STEPS)
        mujoco.mj_forward(model, data)
        heading = np.arctan2(*data.xmat[pelvis].reshape(3, 3)[1::-1, 0])
        ahead, left = np.array([np.cos(heading), np.sin(heading)]), np.array([-np.sin(heading), np.cos(heading)])
        spin = data.xmat[pelvis].reshape(3, 3) @ data.qvel[3:6]
        moving = np.array([ahead @ data.qvel[:2], left @ data.qvel[:2], spin[2]])
        speeds = np.linalg.norm((data.xpos[feet] - before)[:, :2], axis=1) / (PHYSICS_STEPS * model.opt.timestep)
        track.survived = bool(np.isfinite(data.qpos).all() and data.qpos[2] > 0.45 and world_from_pelvis[2, 2] > 0.5)
        if not track.survived:
            break
        track.take(command[:3], moving, speeds, foot_loads(model, data, feet))
    return track


def foot_loads(model, data, feet):
    """Load of each foot on the floor, N."""
    loads = np.zeros(2)
    force = np.zeros(6)
    for index in range(data.ncon):
        contact = data.contact[index]
        bodies = model.geom_bodyid[[contact.geom1, contact.geom2]]
        for foot, link in enumerate(feet):
            if link in bodies and 0 in bodies:
                mujoco.mj_contactForce(model, data, index, force)
                loads[foot] += abs((contact.frame.reshape(3, 3).T @ force[:3])[2])
    return loads


if __name__ == "__main__":
    main()
