"""MuJoCo under the violence of `bench violence`: energy in flight, random starts, and how far both engines lie apart.

    cargo run --release -p fiatlux-bench -- violence --starts 1000 --export target/violence
    python3 tests/oracle/violence.py flight target/violence
    python3 tests/oracle/violence.py starts target/violence
    python3 tests/oracle/violence.py errors target/violence

Prints tables; docs/notes/physics.md keeps them. Works in the environment of `oracle.py`.
"""

import argparse
import json
import sys
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

import environment

HERE = Path(__file__).resolve().parent

# As the engine's: a run that passes one of these has diverged (crates/rules/src/divergence.rs), rad/s and m/s.
RATED_JOINT_SPEED, JOINT_SPEED, BODY_SPEED, BULB_SPEED = 200.0, 1000.0, 20.0, 100.0
# A run is deep that has some contact point deeper than this in more control steps on end than these (0.1 s).
DEEP, DEEP_ROWS = 5e-3, 5
STEP, SUBSTEPS = 5e-3, 4

# Time constant of contacts, s, and how much stiffer they are along the tangents than along the normal, in place of the
# exported 0.02 and 1: the laws of `holding` in motion.py, and the shortest time that MuJoCo allows at a step of 5 ms.
RIGID, FIRM = (0.005, 100.0), (0.01, 1.0)


class Player:
    """A scene with drives that fade out towards their rated speed, as ours do."""

    def __init__(self, path, names, integrator, timestep=STEP, fade=True, law=None):
        import mujoco
        import numpy as np
        from scene import Scene

        self.scene = Scene.load(path)
        self.mujoco, self.np = mujoco, np
        m = self.m = self.scene.m
        self.d = self.scene.d
        m.opt.integrator, m.opt.timestep = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator.upper()}"), timestep
        # A state that is no longer a number would start anew otherwise.
        m.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        if law:
            m.geom_solref[:], m.opt.impratio = [law[0], 1.0], law[1]
        joints = m.actuator_trnid[:, 0]
        self.q, self.v = m.jnt_qposadr[joints], m.jnt_dofadr[joints]
        self.limit = m.actuator_forcerange[:, 1].copy()
        self.rated = np.array([np.inf if s is None else s for s in names["speed_limits"]])
        self.corner, self.fade = names["corner"], fade
        velocity = lambda body: int(m.jnt_dofadr[m.body_jntadr[m.body(body).id]])
        self.pelvis = velocity(names["pelvis"])
        self.bodies = [velocity(names[name]) for name in ("pelvis", "ladder") if names[name]]
        self.bulbs = [velocity(name) for name in names["bulbs"] if name]

    def steps(self, count):
        """MuJoCo reads a drive's limits at the start of a step; ours fade within it."""
        for _ in range(count):
            if self.fade:
                speed = self.d.qvel[self.v]
                left = lambda v: self.np.clip((1 - v / self.rated) / (1 - self.corner), 0.0, 1.0)
                self.m.actuator_forcerange[:, 1] = self.limit * left(speed)
                self.m.actuator_forcerange[:, 0] = -self.limit * left(-speed)
            self.mujoco.mj_step(self.m, self.d)


def fast(speeds, most):
    """True where a speed is beyond its bound or is not a number."""
    return not (speeds <= most).all()


def flight(folder, _workers):
    """The largest change of kinetic energy at any step of 5 ms."""
    import mujoco
    import numpy as np
    from scene import Scene

    data = json.loads((folder / "flight.json").read_text())
    scene = Scene.load(folder / "flight.xml")
    m, d = scene.m, scene.d
    m.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    m.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY

    def energy():
        mujoco.mj_forward(m, d)
        return d.energy[1]

    def change(start, integrator, substeps):
        m.opt.integrator, m.opt.timestep = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator.upper()}"), STEP / substeps
        scene.reset()
        scene.set_state(start["qpos"], start["qvel"])
        before, most = energy(), 0.0
        for _ in range(data["steps"]):
            mujoco.mj_step(m, d, substeps)
            most = max(most, np.nan_to_num(abs(energy() / before - 1), nan=np.inf))
        return most

    speeds = " | ".join(f"{case['joint_speed']:.0f} rad/s" for case in data["speeds"])
    print(f"| MuJoCo | {speeds} |\n|---|---:|---:|")
    for integrator in ["Euler", "implicitfast", "implicit", "RK4"]:
        for substeps in [1, 2, 5]:
            worst = [max(change(start, integrator, substeps) for start in case["starts"]) for case in data["speeds"]]
            cells = [f"{100 * part:.3g} %" if part < 10 else "unlimited" for part in worst]
            print(f"| {integrator}, {substeps} substeps | {' | '.join(cells)} |", flush=True)


def play_start(player, start, hold):
    """One second from a random start: the largest of everything until it diverges, and whether it is lost then."""
    np, scene, d = player.np, player.scene, player.d
    scene.reset()
    scene.set_state(start["qpos"], start["qvel"])
    # The lamp's socket is not part of MuJoCo's scene: what it holds floats.
    held = scene.m.body("old_bulb").id
    d.xfrc_applied[held, 2] = scene.m.body_mass[held] * -scene.m.opt.gravity[2]
    result = {"diverged": 0, "lost": 0, "joint": 0.0, "pelvis": 0.0, "deepest": 0.0, "deep": 0}
    rated = player.v[np.isfinite(player.rated)]
    body = lambda dofs: np.array([np.linalg.norm(d.qvel[dof : dof + 3]) for dof in dofs])
    rows_deep = 0
    for row in range(len(start["targets"]) * hold // SUBSTEPS):
        d.ctrl[:] = start["targets"][row * SUBSTEPS // hold]
        depth = joint = 0.0
        for _ in range(SUBSTEPS):
            player.steps(1)
            depth = max(depth, -d.contact.dist.min()) if d.ncon else depth
            joint = max(joint, np.nan_to_num(np.abs(d.qvel[rated]), nan=np.inf).max())
        result["lost"] |= int(fast(body(player.bodies), BODY_SPEED))
        result["diverged"] |= int(
            joint > RATED_JOINT_SPEED
            or fast(np.abs(d.qvel[player.v]), JOINT_SPEED)
            or fast(body(player.bulbs), BULB_SPEED)
            or not np.isfinite(d.qpos).all()
            or result["lost"]
        )
        if result["lost"]:
            break
        if not result["diverged"]:
            result["joint"], result["deepest"] = max(result["joint"], joint), max(result["deepest"], depth)
            result["pelvis"] = max(result["pelvis"], body([player.pelvis])[0])
            rows_deep = rows_deep + 1 if depth > DEEP else 0
            result["deep"] |= int(rows_deep > DEEP_ROWS)
    return result


def starts_of(folder, variant, part):
    """Results of a part of the starts: from the `first` on, one in `every`."""
    integrator, fade, law = variant
    data = json.loads((folder / "starts.json").read_text())
    player = Player(folder / "starts.xml", data["scene"], integrator, STEP, fade, law)
    first, every = part
    return [play_start(player, start, data["hold"]) for start in data["starts"][first::every]]


def starts(folder, workers):
    variants = {
        "`implicit`": ("implicit", True, None),
        "`implicitfast`": ("implicitfast", True, None),
        "`implicit`, firm contacts": ("implicit", True, FIRM),
        "`implicit`, no rated speed": ("implicit", False, None),
    }
    print(
        "| MuJoCo at 5 ms | diverged | lost | fastest joint, rad/s | fastest pelvis, m/s | deepest contact, mm | deep runs |"
    )
    print("|---|---:|---:|---:|---:|---:|---:|")
    with ProcessPoolExecutor(workers) as pool:
        for name, variant in variants.items():
            parts = pool.map(partial(starts_of, folder, variant), [(i, workers) for i in range(workers)])
            results = [result for part in parts for result in part]
            total = lambda key: sum(result[key] for result in results)
            most = lambda key: max(result[key] for result in results)
            middle = sorted(result["deepest"] for result in results)[len(results) // 2]
            print(
                f"| {name} | {total('diverged')} of {len(results)} | {total('lost')} | {most('joint'):.0f} | {most('pelvis'):.1f} | "
                f"{1e3 * most('deepest'):.1f} (median {1e3 * middle:.1f}) | {total('deep')} |",
                flush=True,
            )


PAIRS = [
    ("ours, 5 ms", "ours, 0.25 ms"),
    ("ours, 5 ms", "MuJoCo, 0.25 ms, rigid"),
    ("ours, 0.25 ms", "MuJoCo, 0.25 ms, rigid"),
    ("ours, 5 ms", "MuJoCo, 0.25 ms"),
    ("MuJoCo, 0.25 ms", "MuJoCo, 0.25 ms, rigid"),
    ("MuJoCo, 5 ms", "MuJoCo, 0.25 ms"),
]


def errors_of(folder, index):
    """By pattern, pair and time of one start: distance of the pelvis, m, of all joints and of those but the fingers, rad."""
    data = json.loads((folder / "replays.json").read_text())
    replay = data["replays"][index]
    names, states = replay["scene"], {}
    methods = {
        "MuJoCo, 0.25 ms": (data["finer"], None),
        "MuJoCo, 0.25 ms, rigid": (data["finer"], RIGID),
        "MuJoCo, 5 ms": (1, None),
    }
    for method, (finer, law) in methods.items():
        player = Player(folder / replay["file"], names, "implicit", STEP / finer, True, law)
        scene, np = player.scene, player.np
        for pattern, case in replay["patterns"].items():
            of = states.setdefault(pattern, {"ours, 5 ms": case["coarse"], "ours, 0.25 ms": case["fine"]})
            scene.reset()
            of[method] = []
            for step, targets in enumerate(case["targets"]):
                player.d.ctrl[:] = targets
                player.steps(data["hold"] * finer)
                if step + 1 in data["after"]:
                    of[method].append(scene.qpos())
    driven = set(player.q.tolist())
    hinges = {int(q): name for q, name in zip(scene.hinge_q, scene.hinge_names) if int(q) in driven}
    at = {int(q): index for index, q in enumerate(scene.q)}
    joints = [at[q] for q in hinges]
    body = [at[q] for q, name in hinges.items() if not name.startswith(("L_", "R_"))]
    root = at[int(scene.m.jnt_qposadr[scene.m.body_jntadr[scene.m.body(names["pelvis"]).id]])]

    def distance(a, b):
        gap = np.subtract(a, b)
        mean = lambda group: float(np.sqrt(np.mean(gap[group] ** 2)))
        return float(np.linalg.norm(gap[root : root + 3])), mean(joints), mean(body)

    return {
        pattern: {pair: [distance(a, b) for a, b in zip(of[pair[0]], of[pair[1]])] for pair in PAIRS}
        for pattern, of in states.items()
    }


def errors(folder, workers):
    count = len(json.loads((folder / "replays.json").read_text())["replays"])
    with ProcessPoolExecutor(workers) as pool:
        replays = list(pool.map(partial(errors_of, folder), range(count)))
    for pattern in replays[0]:
        print(f"\n{pattern}, median of {count} starts: pelvis, mm; joints, mrad; the same without fingers\n")
        print("| of | from | 0.1 s | 0.2 s | 0.5 s | 1 s |\n|---|---|---:|---:|---:|---:|")
        for pair in PAIRS:
            median = lambda at, part: 1e3 * sorted(replay[pattern][pair][at][part] for replay in replays)[count // 2]
            text = lambda value: f"{value:.0f}" if value >= 100 else f"{value:.1f}"
            cells = ["; ".join(text(median(at, part)) for part in range(3)) for at in range(4)]
            print(f"| {' | '.join(pair)} | {' | '.join(cells)} |", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=["flight", "starts", "errors"])
    parser.add_argument("folder", type=Path, help="what `bench violence --export` wrote")
    parser.add_argument("--workers", type=int, default=2, help="processes")
    args = parser.parse_args()
    {"flight": flight, "starts": starts, "errors": errors}[args.what](args.folder, args.workers)


if __name__ == "__main__":
    environment.enter(__file__, HERE / ".venv", HERE / "requirements.txt")
    try:
        main()
    except (RuntimeError, ValueError, OSError) as error:
        sys.exit(f"error: {error}")
