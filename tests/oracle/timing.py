"""MuJoCo's time per step on an exported scene, stepped in C on one thread."""

import json
import platform
import sys
import time
from pathlib import Path

import mujoco
import numpy as np
from scene import Scene


def add_arguments(parser):
    parser.add_argument("--scene", required=True, help="MJCF export")
    parser.add_argument(
        "--states",
        help="JSON list of {name, qpos, qvel, targets, steps} in our terms; without it the scene's own start state",
    )
    parser.add_argument(
        "--targets", help="JSON {hold, targets}: sets of targets, each for `hold` steps, the last for good"
    )
    parser.add_argument("--steps", type=int, default=200, help="steps from each start where a state names none")
    parser.add_argument("--repeats", type=int, default=20, help="timed runs from the same start")


def run(args):
    scene = Scene.load(args.scene)
    print(f"timing: {scene.summary()}", file=sys.stderr)
    scene.reset()
    own = {"name": Path(args.scene).stem, "qpos": scene.qpos(), "qvel": scene.qvel(), "targets": scene.d.ctrl.copy()}
    states = json.loads(Path(args.states).read_text()) if args.states else [own]
    played = json.loads(Path(args.targets).read_text()) if args.targets else None
    cases = []
    for state in states:
        if played:
            state = {**state, **played}
        steps = state.get("steps", args.steps)
        case = {"name": state["name"], "steps": steps, "repeats": args.repeats}
        with_defaults = Scene.load(args.scene)
        default_options(with_defaults.m)
        for laws, variant in (("ours", scene), ("defaults", with_defaults)):
            try:
                case[laws] = time_case(variant, state, steps, args.repeats)
            except RuntimeError as error:
                raise RuntimeError(f"{state['name']}, laws {laws}: {error}") from None
        cases.append(case)
    machine = f"{platform.machine()}, one thread"
    print(
        json.dumps({"mujoco": mujoco.__version__, "machine": machine, "timestep": scene.m.opt.timestep, "cases": cases})
    )


def default_options(m):
    """The default integrator and friction pyramids, with the drives' damping as passive damping of the joints."""
    m.opt.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
    m.opt.integrator = mujoco.mjtIntegrator.mjINT_EULER
    for drive in range(m.nu):
        dof = m.jnt_dofadr[m.actuator_trnid[drive, 0]]
        m.dof_damping[dof] -= m.actuator_biasprm[drive, 2]
        m.actuator_biasprm[drive, 2] = 0.0


def time_case(scene, state, steps, repeats):
    """Microseconds per step (mean and best run), contacts and solver iterations per step."""
    m, d = scene.m, scene.d

    def start():
        scene.reset()
        scene.set_state(state["qpos"], state["qvel"])

    def play(begin, count):
        """Takes steps under the targets that hold at step `begin` and, where there are sets of them, later."""
        if "hold" not in state:
            d.ctrl[:] = state["targets"]
            mujoco.mj_step(m, d, count)
            return
        sets, hold = state["targets"], state["hold"]
        while count > 0:
            index = begin // hold
            if index < len(sets):
                d.ctrl[:] = sets[index]
            now = count if index >= len(sets) - 1 else min(count, hold - begin % hold)
            mujoco.mj_step(m, d, now)
            begin, count = begin + now, count - now

    contacts, rows, iterations = [], [], []
    start()
    for step in range(steps):
        play(step, 1)
        contacts.append(d.ncon)
        rows.append(d.nefc)
        iterations.append(d.solver_niter[: max(1, d.nisland)].sum())
    scene.check_sane()
    micros = []
    for _ in range(repeats):
        start()
        begin = time.perf_counter_ns()
        play(0, steps)
        micros.append((time.perf_counter_ns() - begin) / 1e3 / steps)
    return {
        "mean_us": round(float(np.mean(micros)), 3),
        "min_us": round(float(np.min(micros)), 3),
        "contacts": round(float(np.mean(contacts)), 2),
        "constraint_rows": round(float(np.mean(rows)), 2),
        "iterations": round(float(np.mean(iterations)), 2),
    }
