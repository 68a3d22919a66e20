"""Fixtures of falls on the floor."""

import mujoco
import numpy as np
from scene import Scene, numbers

FALLEN_HEIGHT = 0.35


def free_ankles(scene):
    """Switches the four ankle drives off and names them."""
    m = scene.m
    off = [a for a in range(m.nu) if "ankle" in m.actuator(a).name]
    if len(off) != 4:
        raise RuntimeError(f"expected 4 ankle drives, found {len(off)}")
    m.actuator_gainprm[off] = 0.0
    m.actuator_biasprm[off] = 0.0
    return [m.actuator(a).name for a in off]


def fall_ankles_off(path=None, duration=6.0):
    """Rest poses after a fall from standing with free ankles, and how far MuJoCo's own ones lie apart."""
    scene = Scene.export(path, "--robot-only", "--floor")
    m, d = scene.m, scene.d
    drives_off = free_ankles(scene)
    rng = np.random.default_rng(22)
    scene.reset()
    start = scene.qpos()
    shifts = [np.zeros(m.nv - 6), *rng.uniform(-1e-6, 1e-6, (10, m.nv - 6))]
    runs = []

    elliptic, pyramids = mujoco.mjtCone.mjCONE_ELLIPTIC, mujoco.mjtCone.mjCONE_PYRAMIDAL
    default_solref = m.geom_solref.copy()

    def roll(timestep, shift, cone=elliptic, impratio=1.0, stiff=False):
        scene.reset()
        m.opt.timestep, m.opt.cone, m.opt.impratio = timestep, cone, impratio
        m.geom_solref[:] = [0.005, 1.0] if stiff else default_solref
        scene.set_state(np.concatenate([start[:7], start[7:] + shift]), np.zeros(m.nv))
        mujoco.mj_step(m, d, round(duration / timestep))
        scene.check_sane()
        speed = float(np.abs(scene.qvel()).max().round(6))
        return {"timestep": timestep, "perturbed": bool(shift.any()), "qpos": numbers(scene.qpos(), 9), "speed": speed}

    for timestep in [5e-3, 2e-3, 1e-3]:
        runs += [roll(timestep, shift) for shift in shifts]
    # MuJoCo's default contact creeps, so the hands that the robot landed on unwind for seconds. Its other laws of contact
    # move the rest pose far more than step and perturbation do: they show how much of a gap is a matter of the law.
    # All at 1 ms: stiff contact is unstable at 5 ms.
    laws = [{"cone": pyramids}, {"impratio": 100.0}, {"stiff": True}, {"impratio": 100.0, "stiff": True}]
    other_laws = [roll(1e-3, shifts[0], **law) for law in laws]
    rest = np.array([run["qpos"] for run in runs])
    nominal, others = rest[0], rest[1:]
    # q and -q are one rotation.
    others[:, 3:7] *= np.sign(others[:, 3:7] @ nominal[3:7])[:, None]
    gap = np.abs(others - nominal)
    angle = 2 * np.arccos(np.clip(others[:, 3:7] @ nominal[3:7], -1, 1))
    print(
        f"fall_ankles_off: rests at {np.round(nominal[:3], 3)}, fastest dof {runs[0]['speed']}, "
        f"under other laws of contact at {[np.round(run['qpos'][:3], 3).tolist() for run in other_laws]}; "
        f"spread {gap[:, :3].max():.3f} m, {angle.max():.3f} rad, joints {gap[:, 7:].max():.3f} rad"
    )
    return {
        "bodies": scene.names,
        "duration": duration,
        "drives_off": drives_off,
        "start_qpos": numbers(start),
        "targets": numbers(m.key_ctrl[0]),
        "nominal": 0,
        "runs": runs,
        "other_laws": other_laws,
    }


def fall_zero_action(path=None):
    """When the pelvis passes 0.35 m and to which side, drives at the standing posture, for 8 reset noises."""
    scene = Scene.export(path, "--robot-only", "--floor")
    m = scene.m
    rng = np.random.default_rng(23)
    scene.reset()
    start = scene.qpos()
    low, high = m.jnt_range[scene.hinge].T
    cases = []
    for _ in range(8):
        x, y = np.round(rng.uniform(-0.05, 0.05, 2), 4)
        yaw = np.round(rng.uniform(-0.1, 0.1), 4)
        joints = np.round(rng.uniform(-0.05, 0.05, m.nv - 6), 4)
        qpos = start.copy()
        qpos[:2] += [x, y]
        qpos[3:7] = [np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)]
        qpos[7:] = np.clip(qpos[7:] + joints, low, high)
        qpos[2] += standing_gap(scene, qpos)
        case = {"noise": {"x": x, "y": y, "yaw": yaw, "joints": numbers(joints, 4)}, "start_qpos": numbers(qpos)}
        for timestep in [5e-3, 1e-3]:
            seconds, path_xy = fall(scene, qpos, timestep)
            forward = path_xy @ [np.cos(yaw), np.sin(yaw)]
            left = path_xy @ [-np.sin(yaw), np.cos(yaw)]
            case[f"step_{timestep * 1e3:.0f}ms"] = {
                "fall_seconds": round(seconds, 6),
                "direction": "forward" if forward > 0 else "backward",
                "forward": round(forward, 4),
                "left": round(left, 4),
            }
        cases.append(case)
    for step in ["step_5ms", "step_1ms"]:
        falls = [c[step] for c in cases]
        times = " ".join(f"{f['fall_seconds']:.3f}" for f in falls)
        print(f"fall_zero_action, {step}: {times} s, {sum(f['direction'] == 'forward' for f in falls)} of 8 forward")
    return {
        "bodies": scene.names,
        "fallen_height": FALLEN_HEIGHT,
        "targets": numbers(m.key_ctrl[0]),
        "cases": cases,
    }


def standing_gap(scene, qpos):
    """Height by which the root must rise so that the lowest point of the robot just touches the floor."""
    m, d = scene.m, scene.d
    scene.set_state(qpos, np.zeros(m.nv))
    mujoco.mj_kinematics(m, d)
    floor = m.geom("floor").id
    distances = [mujoco.mj_geomDistance(m, d, floor, g, 1.0, None) for g in range(m.ngeom) if m.geom_bodyid[g] != 0]
    return -min(distances)


def fall(scene, qpos, timestep, limit=5.0):
    """Seconds until the pelvis passes the fallen height, between steps by a straight line, and its way there, m."""
    m, d = scene.m, scene.d
    scene.reset()
    m.opt.timestep = timestep
    scene.set_state(qpos, np.zeros(m.nv))
    before = scene.qpos()[:3]
    while d.time < limit:
        mujoco.mj_step(m, d)
        now = scene.qpos()[:3]
        if now[2] < FALLEN_HEIGHT:
            scene.check_sane()
            part = (before[2] - FALLEN_HEIGHT) / (before[2] - now[2])
            return d.time - timestep * (1 - part), before[:2] + part * (now - before)[:2] - qpos[:2]
        before = now
    raise RuntimeError(f"the robot still stands after {limit} s")


def firm_ankles(path=None, factor=8.0, duration=10.0):
    """Ankles `factor` times as stiff and damped, as they are and told to lean back: who stays up, at a 1 ms step."""
    scene = Scene.export(path, "--robot-only", "--floor")
    m, d = scene.m, scene.d
    ankles = [a for a in range(m.nu) if "ankle" in m.actuator(a).name]
    m.actuator_gainprm[ankles] *= factor
    m.actuator_biasprm[ankles] *= factor
    m.opt.timestep = 1e-3
    cases = []
    for lean in [0.0, 0.06]:
        scene.reset()
        for a in ankles:
            if "ankle_pitch" in m.actuator(a).name:
                d.ctrl[a] += lean
        start, targets, lowest = scene.qpos().copy(), d.ctrl.copy(), np.inf
        for _ in range(round(duration / m.opt.timestep)):
            mujoco.mj_step(m, d)
            lowest = min(lowest, scene.qpos()[2])
        scene.check_sane()
        height = scene.qpos()[2]
        print(
            f"firm_ankles: leaning {lean} rad, pelvis at {height:.4f} m after {duration:.0f} s, lowest {lowest:.4f} m"
        )
        cases.append(
            {"lean": lean, "targets": numbers(targets), "height": round(height, 6), "lowest": round(lowest, 6)}
        )
    return {"bodies": scene.names, "factor": factor, "duration": duration, "start_qpos": numbers(start), "cases": cases}
