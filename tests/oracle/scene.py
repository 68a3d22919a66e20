"""One of our scenes in MuJoCo, read and written in our order and terms.

Ours: bodies as in the tuple `bodies` of the export; `qpos` of a free joint is position and quaternion (w first), its
`qvel` the velocity of the origin and the angular velocity, both in world axes. MuJoCo's: depth first, and the angular
velocity in body axes. With v_ours = T v and T orthogonal, forces turn as T f and the mass matrix as T M T'. T's time
derivative contributes nothing, because a body's spin is parallel to its own angular velocity.
"""

import json
import subprocess
import tempfile
from pathlib import Path

import mujoco
import numpy as np

HERE = Path(__file__).resolve().parent
WARNINGS: list[str] = []
mujoco.set_mju_user_warning(WARNINGS.append)


class Scene:
    """A loaded model with one `MjData` and the maps between the two orders."""

    def __init__(self, model):
        self.m, self.d = model, mujoco.MjData(model)
        m = model
        order = next(i for i in range(m.ntuple) if m.tuple(i).name == "bodies")
        start = m.tuple_adr[order]
        bodies = [int(b) for b in m.tuple_objid[start : start + m.tuple_size[order]] if b != 0]
        self.names = [m.body(b).name for b in bodies]
        q, v = [], []
        self.free = []
        for body in bodies:
            joint = m.body_jntadr[body]
            free = m.jnt_type[joint] == mujoco.mjtJoint.mjJNT_FREE
            qa, va = m.jnt_qposadr[joint], m.jnt_dofadr[joint]
            if free:
                self.free.append((len(v), int(qa)))
            q += range(qa, qa + (7 if free else 1))
            v += range(va, va + (6 if free else 1))
        self.q, self.v = np.array(q), np.array(v)
        self.hinge = [m.body_jntadr[b] for b in bodies if m.jnt_type[m.body_jntadr[b]] != mujoco.mjtJoint.mjJNT_FREE]
        self.hinge_names = [m.joint(j).name for j in self.hinge]
        self.hinge_q = m.jnt_qposadr[self.hinge]
        self.reset()

    @classmethod
    def load(cls, path):
        """Loads an MJCF file. Any warning is an error."""
        WARNINGS.clear()
        scene = cls(mujoco.MjModel.from_xml_path(str(path)))
        # Fixtures and times are of MuJoCo's default, where they do not say otherwise.
        scene.m.opt.impratio = 1.0
        scene.d.qvel[:] = scene.m.key_qvel[0]
        mujoco.mj_forward(scene.m, scene.d)
        if WARNINGS:
            raise RuntimeError(f"{path}: MuJoCo warns: {'; '.join(WARNINGS)}")
        return scene

    @classmethod
    def export(cls, path, *flags):
        """Loads `path`, or where it is None what `sim-server export` writes."""
        if path is not None:
            return cls.load(path)
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "scene.xml"
            command = ["cargo", "run", "--release", "--quiet", "-p", "sim-server", "--bin", "sim-server", "--"]
            command += ["export", "--format", "mjcf", *flags, "-o", str(file)]
            subprocess.run(command, check=True, cwd=HERE.parent.parent)
            return cls.load(file)

    def summary(self):
        """The loaded scene, at its start state."""
        m = self.m
        self.reset()
        mujoco.mj_forward(m, self.d)
        return (
            f"{m.nbody - 1} bodies, {m.nv} dofs, {m.nu} drives, {m.ngeom} geoms, {m.nexclude} exclusions, "
            f"{m.body_mass.sum():.4f} kg, {self.d.ncon} contacts at the start, no warnings"
        )

    def reset(self):
        """Back to the exported start state."""
        mujoco.mj_resetDataKeyframe(self.m, self.d, 0)

    def turn(self, qpos=None):
        """T of the module's docstring, with rows in our order, at MuJoCo's `qpos` (default: the present one)."""
        qpos = self.d.qpos if qpos is None else qpos
        t = np.zeros((self.m.nv, self.m.nv))
        t[np.arange(self.m.nv), self.v] = 1.0
        for dof, adr in self.free:
            world_from_body = np.zeros(9)
            mujoco.mju_quat2Mat(world_from_body, qpos[adr + 3 : adr + 7])
            t[dof + 3 : dof + 6, self.v[dof + 3 : dof + 6]] = world_from_body.reshape(3, 3)
        return t

    def qpos(self):
        return self.d.qpos[self.q]

    def qvel(self):
        return self.turn() @ self.d.qvel

    def set_state(self, qpos, qvel):
        """Sets a state given in our terms."""
        self.d.qpos[self.q] = qpos
        self.d.qvel[:] = self.turn().T @ np.asarray(qvel)

    def mass_matrix(self):
        full = np.zeros((self.m.nv, self.m.nv))
        mujoco.mj_fullM(self.m, self.d, full)
        t = self.turn()
        return t @ full @ t.T

    def bias(self):
        return self.turn() @ self.d.qfrc_bias

    def saturated(self):
        """True when a drive is at its effort limit."""
        limit = self.m.actuator_forcerange[:, 1]
        return bool(np.any(np.abs(self.d.actuator_force) >= limit * (1 - 1e-9)))

    def check_sane(self):
        """Raises if MuJoCo met trouble since the last reset."""
        trouble = [mujoco.mjtWarning(i).name for i in range(len(self.d.warning)) if self.d.warning[i].number]
        if trouble:
            raise RuntimeError(f"MuJoCo reports {', '.join(trouble)}")


def numbers(array, digits=17):
    """A list (of lists) of numbers rounded to significant digits; whole ones are written short."""
    if np.ndim(array):
        return [numbers(x, digits) for x in array]
    value = float(f"{array:.{digits}g}")
    return int(value) if value.is_integer() else value


def write_fixture(name, data):
    """Writes fixtures/NAME.json, innermost arrays on one line each."""
    path = HERE / "fixtures" / f"{name}.json"
    path.parent.mkdir(exist_ok=True)
    data = {"mujoco": mujoco.__version__, **data}
    path.write_text(layout(data) + "\n")
    print(f"{name}: wrote fixtures/{path.name}, {path.stat().st_size / 1000:.0f} kB")


def layout(value, indent=0):
    pad = " " * (indent + 1)
    if isinstance(value, dict) and value:
        items = [f"{pad}{json.dumps(k)}: {layout(v, indent + 1)}" for k, v in value.items()]
        return "{\n" + ",\n".join(items) + "\n" + " " * indent + "}"
    if isinstance(value, list) and value and isinstance(value[0], (list, dict)):
        items = [
            pad + (layout(v, indent + 1) if isinstance(v, list) else json.dumps(v, separators=(",", ":")))
            for v in value
        ]
        return "[\n" + ",\n".join(items) + "\n" + " " * indent + "]"
    return json.dumps(value, separators=(",", ":"), allow_nan=False)


TASKS = [*(f"S{number:02}" for number in range(1, 13)), "replace", "climb"]


def tasks_dex3():
    """The same of the G1 with Dex3 hands."""
    return tasks("--robot", "g1_dex3")


def tasks(*robot):
    """Every task's start state, loaded without a warning: what MuJoCo counts in it."""
    scenes = []
    for task in TASKS:
        scene = Scene.export(None, "--task", task, "--seed", "0", *robot)
        m = scene.m
        print(f"tasks: {task}: {scene.summary()}")
        counts = {"bodies": m.nbody - 1, "dofs": m.nv, "drives": m.nu, "shapes": m.ngeom, "mass": m.body_mass.sum()}
        scenes.append({"task": task, **{name: round(float(count), 6) for name, count in counts.items()}})
    return {"scenes": scenes}
