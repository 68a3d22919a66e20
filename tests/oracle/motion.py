"""Fixtures of motion without contact."""

import mujoco
import numpy as np
from scene import TASKS, Scene, numbers
from timing import default_options

# Bulbs that sit in the socket at the start: its hold is not part of the physics, so they are taken out of the way.
SEATED = {"S01": "old_bulb", "S02": "old_bulb", "S03": "old_bulb", "replace": "old_bulb", "S12": "fresh_bulb"}


def random_rotation(rng):
    """Uniform quaternion, w first."""
    q = rng.normal(size=4)
    return q / np.linalg.norm(q)


def dynamics(path=None):
    """Mass matrix (armature included) and bias force (gravity, Coriolis, centrifugal) of 20 random states."""
    return dynamics_of(Scene.export(path, "--robot-only"))


def dynamics_bare(path=None):
    """The same of the G1 with welded fingers."""
    return dynamics_of(Scene.export(path, "--robot-only", "--robot", "g1_bare"))


def dynamics_dex3(path=None):
    """The same of the G1 with Dex3 hands."""
    return dynamics_of(Scene.export(path, "--robot-only", "--robot", "g1_dex3"))


def dynamics_of(scene):
    m, nv = scene.m, scene.m.nv
    rng = np.random.default_rng(20)
    probes = np.round(rng.uniform(-1, 1, (4, nv)), 3)
    states = []
    for index in range(20):
        qpos = np.zeros(m.nq)
        qpos[:3] = rng.uniform(-1, 1, 3)
        qpos[3:7] = random_rotation(rng)
        qpos[7:] = rng.uniform(*m.jnt_range[scene.hinge].T)
        qvel = np.concatenate([rng.uniform(-2, 2, 3), rng.uniform(-4, 4, 3), rng.uniform(-5, 5, nv - 6)])
        scene.set_state(qpos, qvel)
        mujoco.mj_forward(m, scene.d)
        matrix = scene.mass_matrix()
        state = {
            "qpos": numbers(scene.qpos()),
            "qvel": numbers(scene.qvel()),
            "bias": numbers(scene.bias()),
            "mass_times_probe": numbers(probes @ matrix),
        }
        if index < 3:
            state["mass_lower"] = numbers(matrix[np.tril_indices(nv)])
        states.append(state)
    print(f"dynamics: {scene.summary()}")
    return {"bodies": scene.names, "nv": nv, "probes": numbers(probes), "states": states}


def tumble(path=None):
    """One second in free fall with a tumbling root, drives on; nothing saturates, touches or meets a limit."""
    scene = Scene.export(path, "--robot-only")
    m, d = scene.m, scene.d
    rng = np.random.default_rng(21)
    qpos, targets = scene.qpos(), np.zeros(m.nu)
    qpos[3:7] = random_rotation(rng)
    low, high = m.jnt_range[scene.hinge].T
    # Arms away from the body, all joints well inside their ranges.
    middle = np.clip(qpos[7:], low + 0.25 * (high - low), high - 0.25 * (high - low))
    for index, name in enumerate(scene.hinge_names):
        if "shoulder_roll" in name:
            middle[index] = 0.7 if name.startswith("left") else -0.7
    qpos[7:] = middle
    qvel = np.concatenate([[0.5, -0.3, 2.0], [2.0, -1.5, 1.0], np.zeros(m.nv - 6)])
    of_joint = {int(j): i for i, j in enumerate(scene.hinge)}
    for drive in range(m.nu):
        index = of_joint[int(m.actuator_trnid[drive, 0])]
        kp, kv, limit = m.actuator_gainprm[drive, 0], -m.actuator_biasprm[drive, 2], m.actuator_forcerange[drive, 1]
        offset = min(0.1, 0.1 * (high - low)[index], 0.3 * limit / kp)
        targets[drive] = middle[index] + offset * rng.uniform(-1, 1)
        qvel[6 + index] = min(0.5, 0.3 * limit / kv) * rng.uniform(-1, 1)

    def roll(timestep):
        scene.reset()
        m.opt.timestep = timestep
        scene.set_state(qpos, qvel)
        d.ctrl[:] = targets
        rows = []
        steps = round(0.1 / timestep)
        for row in range(11):
            for _ in range(steps if row else 0):
                mujoco.mj_step(m, d)
                if d.nefc or scene.saturated():
                    raise RuntimeError(
                        f"tumble: {d.nefc} constraints, saturated: {scene.saturated()} at {d.time:.3f} s"
                    )
            rows.append(
                {"time": round(0.1 * row, 3), "qpos": numbers(scene.qpos(), 12), "qvel": numbers(scene.qvel(), 12)}
            )
        scene.check_sane()
        return rows

    rows, fine = roll(1e-3), roll(1e-3 / 32)
    error = np.abs(np.array(rows[-1]["qpos"]) - fine[-1]["qpos"])
    print(f"tumble: at 1 ms MuJoCo is {error[:3].max():.1e} m and {error[7:].max():.1e} rad from its own limit at 1 s")
    return {
        "bodies": scene.names,
        "timestep": 1e-3,
        "targets": numbers(targets),
        "rows": rows,
        "fine_timestep": 1e-3 / 32,
        "fine_rows": fine,
    }


def closing(path=None):
    """A second in the air in which hands close whose outer joints follow: the left one within its range, the right one to its stops."""
    scene = Scene.export(path, "--robot-only", "--robot", "g1_inspire6")
    m, d = scene.m, scene.d
    m.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    low, high = m.jnt_range[scene.hinge].T
    follows = {int(m.eq_obj1id[equality]) for equality in range(m.neq)}
    targets, of_joint = np.zeros(m.nu), {int(j): i for i, j in enumerate(scene.hinge)}
    start, fingers = scene.qpos(), []
    for drive in range(m.nu):
        joint = int(m.actuator_trnid[drive, 0])
        index = of_joint[joint]
        name, targets[drive] = scene.hinge_names[index], start[7 + index]
        if name.startswith(("L_", "R_")):
            fingers.append(7 + index)
            if joint not in follows:
                targets[drive] = 0.6 * high[index] if name.startswith("L_") else high[index] + 0.3
    softness = m.jnt_solref.copy(), m.jnt_solimp.copy(), m.eq_solref.copy()

    def roll(timestep, stiff=True):
        """Hard stops and equalities, as stiff as the step allows, or MuJoCo's usual ones."""
        scene.reset()
        m.opt.timestep = timestep
        m.jnt_solref[:], m.jnt_solimp[:], m.eq_solref[:] = softness
        if stiff:
            m.jnt_solref[:] = m.eq_solref[:] = [2 * timestep, 1.0]
            m.jnt_solimp[:, :3] = [0.9999, 0.9999, 0.001]
        d.ctrl[:] = targets
        rows = [numbers(scene.qpos()[fingers], 12)]
        for _ in range(20):
            mujoco.mj_step(m, d, round(0.05 / timestep))
            rows.append(numbers(scene.qpos()[fingers], 12))
        scene.check_sane()
        return rows

    fine, coarse, soft = roll(1e-3 / 64), roll(1e-3), roll(1e-3, stiff=False)
    apart = [float(np.abs(np.array(run) - fine).max()) for run in (roll(1e-3 / 32), coarse, soft)]
    print(
        f"closing: from 16 us, MuJoCo at 31 us {apart[0]:.1e}, at 1 ms {apart[1]:.1e}, with its usual stops {apart[2]:.1e} rad"
    )
    return {
        "bodies": scene.names,
        "fingers": fingers,
        "targets": numbers(targets),
        "fine_timestep": 1e-3 / 64,
        "fine_rows": fine,
        "coarse_error": apart[1],
        "soft_error": apart[2],
    }


FINE = 2.5e-4
# Joints of the fingers begin so, by the kind of hand.
FINGERS = ("L_", "R_", "left_hand_", "right_hand_")


def holding(*robot):
    """A second from every task's start state with its joint targets held, and how far MuJoCo's own laws lead apart."""
    return {"timestep": FINE, "tasks": [hold(task, *robot) for task in TASKS]}


def holding_dex3():
    """The same of the G1 with Dex3 hands."""
    return holding("--robot", "g1_dex3")


def hold(task, *robot):
    """MuJoCo at 0.25 ms under the laws nearest to ours, and the gaps of its variants to that."""
    export = ["--task", task, "--seed", "0", *robot]
    nearest, defaults = Scene.export(None, *export), Scene.export(None, *export)
    default_options(defaults.m)
    nearest.reset()
    start = nearest.qpos()
    free, seated = free_bodies(nearest), SEATED.get(task)
    if seated:
        start[free[seated] + 2] += 100.0
    bodies = {name: at for name, at in free.items() if name != seated}

    def roll(scene, timestep=FINE, firm=None, lift=0.0):
        m, d = scene.m, scene.d
        scene.reset()
        solref, m.opt.timestep = m.geom_solref.copy(), timestep
        # Under the usual soft contacts a bulb slips out of the hand within the second; here none does.
        if firm:
            m.geom_solref[:], m.opt.impratio = [0.005, 1.0], firm
        qpos = start.copy()
        qpos[free["pelvis"] + 2] += lift
        scene.set_state(qpos, np.zeros(m.nv))
        rows = []
        for _ in range(10):
            mujoco.mj_step(m, d, round(0.1 / timestep))
            rows.append(scene.qpos())
        scene.check_sane()
        m.geom_solref[:], m.opt.impratio = solref, 1.0
        return np.array(rows)

    rows = roll(nearest, firm=100.0)
    variants = {
        "robot 0.1 mm higher": roll(nearest, firm=100.0, lift=1e-4),
        "friction that creeps": roll(nearest, firm=1.0),
        "soft contacts": roll(nearest),
        "soft contacts, 5 ms": roll(nearest, 5e-3),
        "defaults": roll(defaults),
        "defaults, 5 ms": roll(defaults, 5e-3),
    }
    gaps = {name: [gap(nearest, bodies, row, other) for row, other in zip(rows, run)] for name, run in variants.items()}
    widest = np.max(list(gaps.values()), axis=(0, 1))
    print(f"holding {task}: largest gaps of body, fingers, {', '.join(bodies)}: {[f'{g:.1e}' for g in widest]}")
    return {
        "task": task,
        "left_out": seated,
        "bodies": list(bodies),
        "start_qpos": numbers(start),
        "rows": numbers(rows, 7),
        "gaps": {name: numbers(run, 3) for name, run in gaps.items()},
    }


def free_bodies(scene):
    """Where the pose of each free body begins in our `qpos`."""
    m = scene.m
    name = {int(m.jnt_qposadr[j]): m.body(m.jnt_bodyid[j]).name for j in range(m.njnt)}
    free = {int(adr) for _, adr in scene.free}
    return {name[int(q)]: at for at, q in enumerate(scene.q) if int(q) in free}


def gap(scene, bodies, a, b):
    """Largest difference of the body's joints and of the fingers', rad, then of each body's place, m, and rotation, rad."""
    fingers = {int(q) for q, name in zip(scene.hinge_q, scene.hinge_names) if name.startswith(FINGERS)}
    hinges = {int(q) for q in scene.hinge_q}
    largest = lambda group: max(abs(a[at] - b[at]) for at, q in enumerate(scene.q) if int(q) in group)
    gaps = [largest(hinges - fingers), largest(fingers)]
    for at in bodies.values():
        cosine = min(1.0, abs(a[at + 3 : at + 7] @ b[at + 3 : at + 7]))
        gaps += [np.linalg.norm(a[at : at + 3] - b[at : at + 3]), 2 * np.arccos(cosine)]
    return gaps
