"""Compares Fiatlux's batch with MuJoCo's own threaded `rollout`, one after the other: same machine, states and targets.

    python python/benchmarks/mujoco_rollout.py --worlds 64 --threads 2

Both take control steps of four physics steps of 5 ms from the same start states of one room, with the robot's joint targets held
as they are there. What each computes besides: Fiatlux judges each row, pays the reward and writes the observation of the robot's
body, and holds bulbs in hand and socket; `rollout` writes states, and lets the bulbs fall. MuJoCo runs under its own default
options, and under those that are nearest to Fiatlux's laws.
"""

import argparse
import json
import platform
import time

import fiatlux
import mujoco
import mujoco.rollout
import numpy as np

PHYSICS_STEPS = 4
ROOM = 1000
STARTS = 8


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--worlds", type=int, default=64)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--steps", type=int, default=20, help="control steps from the start states")
    parser.add_argument("--rounds", type=int, default=5, help="measurements, taken in turns; the best of each counts")
    parser.add_argument("--task", default="S07")
    parser.add_argument("--robot", default=fiatlux.ROBOTS[0])
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()

    ours = Batch(args)
    nearest, defaults = Rollout(args, True), Rollout(args, False)
    check_states(ours, nearest)
    runners = {"fiatlux": ours, "mujoco, nearest options": nearest, "mujoco, its defaults": defaults}
    rates = dict.fromkeys(runners, 0.0)
    for _ in range(args.rounds):
        for name, runner in runners.items():
            runner.start()
            begun = time.perf_counter()
            runner.play(args.steps)
            rates[name] = max(rates[name], args.worlds * args.steps / (time.perf_counter() - begun))
    heights = {name: float(np.mean(runner.pelvis_heights())) for name, runner in runners.items()}
    report = {
        "machine": platform.processor() or platform.machine(),
        "mujoco": mujoco.__version__,
        "fiatlux": fiatlux.__version__,
        "task": args.task,
        "robot": args.robot,
        "worlds": args.worlds,
        "threads": args.threads,
        "control_steps": args.steps,
        "control_steps_per_s": {name: round(rate) for name, rate in rates.items()},
        "mean_pelvis_height_after_m": heights,
    }
    if args.json:
        print(json.dumps(report))
        return
    print(
        f"{args.worlds} worlds of {args.task} with {args.robot} on {args.threads} threads, {args.steps} control steps from the start"
    )
    print(f"{'':<26} {'control steps/s':>16} {'of fiatlux':>11} {'pelvis after, m':>16}")
    for name, rate in rates.items():
        print(f"{name:<26} {rate:>16.0f} {rate / rates['fiatlux']:>11.2f} {heights[name]:>16.3f}")


class Batch:
    def __init__(self, args):
        self.env = fiatlux.VectorEnv(
            args.task,
            args.worlds,
            seeds=[ROOM],
            episodes=STARTS,
            num_threads=args.threads,
            robot=args.robot,
            action_form="joint_target",
            observation="flat",
            noise=False,
            copy=False,
            final_obs=False,
        )
        self.start()
        self.first = self.env.save()
        rows = [self.env.row(world) for world in range(args.worlds)]
        self.positions = np.array([row["joint_position"] for row in rows])
        self.targets = np.array([row["joint_target"] for row in rows], np.float32)

    def start(self):
        self.env.reset(seed=0)

    def play(self, steps):
        for _ in range(steps):
            self.env.step(self.targets)

    def pelvis_heights(self):
        return [self.env.row(world)["robot_pose"][2] for world in range(self.env.num_envs)]


class Rollout:
    """Worlds of the exported scene, each in the start state of the batch's world."""

    def __init__(self, args, nearest):
        starts = {}
        self.model = None
        for episode in range(STARTS):
            env = fiatlux.Env(args.task, robot=args.robot, noise=False)
            env.reset(seed=ROOM, options={"episode": episode})
            model = mujoco.MjModel.from_xml_string(env.to_mjcf(nearest))
            self.model = self.model or model
            starts[env.row()["joint_position"].tobytes()] = model
        batch = Batch(args)
        data = mujoco.MjData(self.model)
        size = mujoco.mj_stateSize(self.model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        self.states, self.controls = np.zeros((args.worlds, size)), np.zeros((args.worlds, self.model.nu))
        for world in range(args.worlds):
            model = starts[batch.positions[world].tobytes()]
            data.qpos[:], data.qvel[:] = model.key_qpos[0], model.key_qvel[0]
            mujoco.mj_getState(self.model, data, self.states[world], mujoco.mjtState.mjSTATE_FULLPHYSICS)
            self.controls[world] = model.key_ctrl[0]
        self.joint_positions = np.array([starts[numbers.tobytes()].key_qpos[0] for numbers in batch.positions])
        self.data = [mujoco.MjData(self.model) for _ in range(args.threads)]
        self.pool = mujoco.rollout.Rollout(nthread=args.threads)
        pelvis = self.model.body("pelvis").id
        self.height = 1 + self.model.jnt_qposadr[self.model.body_jntadr[pelvis]] + 2
        self.last = None

    def start(self):
        pass

    def play(self, steps):
        controls = np.repeat(self.controls[:, None, :], steps * PHYSICS_STEPS, axis=1)
        self.last, _ = self.pool.rollout(self.model, self.data, self.states, controls)

    def pelvis_heights(self):
        return self.last[:, -1, self.height]


def check_states(ours, rollout):
    """Checks that the joint angles of all worlds are the same on both sides."""
    for world, positions in enumerate(ours.positions):
        theirs = rollout.joint_positions[world]
        if not np.isin(positions, theirs).all():
            raise SystemExit(f"world {world}: the exported state is not the batch's")


if __name__ == "__main__":
    main()
