"""Poses, Jacobians and dynamics of the robot by MuJoCo and Pinocchio: writes fixtures/kinematics.json.

    python3 tests/oracle/kinematics.py [--scene F.xml] [--states N]

The random states are made here and in the Rust test by the same integer generator, so that the fixture holds only results.
Each is one number: the projection of all poses, of a matrix or of a vector on fixed vectors, which every entry takes part in.
Makes its own virtual environment in target/ on the first run.

Ours, MuJoCo's and Pinocchio's terms for a free root (see scene.py for MuJoCo's):

- ours: `qvel` has the velocity of the root's origin and the angular velocity, both in world axes; quaternions w first;
- Pinocchio: both in the root's own axes, quaternions w last. Its acceleration is that of the twist, so that of the origin is
  R (a + w x v); with the joints' order of its own.

Rotor inertias: on the diagonal of the mass matrix in all three, and in their inverse dynamics.
"""

import argparse
from pathlib import Path

import environment

HERE = Path(__file__).resolve().parent
VENV = HERE.parents[1] / "target" / "kinematics-venv"

environment.enter(__file__, VENV, HERE / "kinematics.requirements.txt")

import mujoco  # noqa: E402
import numpy as np  # noqa: E402
import pinocchio  # noqa: E402
from scene import Scene, numbers, write_fixture  # noqa: E402

QUANTITIES = ("poses", "velocities", "jacobians", "com", "mass", "bias", "inverse", "contacts")
# Forces act at these sites, N.
LOADED = ("left_palm", "right_palm", "left_sole", "right_sole")
FORCE = 100.0
TOLERANCE = 1e-10


class Draws:
    """SplitMix64: numbers in [-1, 1)."""

    def __init__(self, seed):
        self.state = seed

    def one(self):
        mask = (1 << 64) - 1
        self.state = (self.state + 0x9E3779B97F4A7C15) & mask
        z = self.state
        z = ((z ^ (z >> 30)) * 0xBF58476D1CE4E5B9) & mask
        z = ((z ^ (z >> 27)) * 0x94D049BB133111EB) & mask
        return ((z ^ (z >> 31)) >> 11) * 2.0**-52 - 1.0

    def many(self, count, scale=1.0):
        return scale * np.array([self.one() for _ in range(count)])


def probe(count):
    """A fixed vector that no entry of what it is multiplied with escapes."""
    return Draws(2026).many(count)


class Case:
    """A state with its accelerations and forces, in our terms."""

    def __init__(self, seed, low, high):
        draws = Draws(seed)
        quaternion = draws.many(4)
        position = draws.many(3)
        joints = low + (high - low) * (draws.many(len(low)) + 1.0) / 2.0
        self.qpos = np.concatenate([position, quaternion / np.linalg.norm(quaternion), joints])
        self.qvel = np.concatenate([draws.many(3, 2.0), draws.many(3, 4.0), draws.many(len(low), 5.0)])
        self.acceleration = draws.many(6 + len(low), 10.0)
        self.forces = draws.many(3 * len(LOADED), FORCE).reshape(-1, 3)


def project(bodies, sites, com, mass, bias, inverse, loaded):
    """One number for each quantity. `bodies`: position, rotation and velocity of each; `sites`: Jacobians by name."""
    nv = len(bias)
    p, other = probe(nv), probe(2 * nv)[nv:]
    poses = np.concatenate([np.concatenate([position, rotation.ravel()]) for position, rotation, _ in bodies])
    velocities = np.concatenate([velocity for _, _, velocity in bodies])
    spatial = np.concatenate([jacobian @ p for jacobian in sites.values()])
    where, jacobian = com
    of_com = np.concatenate([where, jacobian @ p])
    forces = inverse - sum(sites[name][:3].T @ force for name, force in zip(LOADED, loaded))
    vectors = (poses, velocities, spatial, of_com, mass @ other)
    return [float(probe(len(v)) @ v) for v in vectors] + [float(p @ v) for v in (bias, inverse, forces)]


class Mujoco:
    def __init__(self, scene):
        self.scene, self.m, self.d = scene, scene.m, scene.d
        self.m.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
        self.sites = [self.m.site(i).name for i in range(self.m.nsite)]

    def read(self, case):
        m, d, scene = self.m, self.d, self.scene
        scene.set_state(case.qpos, case.qvel)
        mujoco.mj_forward(m, d)
        turn = scene.turn()
        bodies = []
        for name in scene.names:
            velocity = np.zeros(6)
            mujoco.mj_objectVelocity(m, d, mujoco.mjtObj.mjOBJ_XBODY, m.body(name).id, velocity, 0)
            body = d.body(name)
            bodies.append((body.xpos.copy(), body.xmat.reshape(3, 3).copy(), np.roll(velocity, 3)))
        sites = {}
        for name in self.sites:
            linear, angular = np.zeros((3, m.nv)), np.zeros((3, m.nv))
            mujoco.mj_jacSite(m, d, linear, angular, m.site(name).id)
            sites[name] = np.vstack([linear, angular]) @ turn.T
        jacobian = np.zeros((3, m.nv))
        mujoco.mj_jacSubtreeCom(m, d, jacobian, m.body("pelvis").id)
        com = (d.subtree_com[m.body("pelvis").id].copy(), jacobian @ turn.T)
        mass, bias = scene.mass_matrix(), scene.bias()
        d.qacc[:] = turn.T @ case.acceleration
        mujoco.mj_inverse(m, d)
        return project(bodies, sites, com, mass, bias, turn @ d.qfrc_inverse, case.forces)


class Pinocchio:
    def __init__(self, path, mujoco_sites, scene):
        self.model = pinocchio.buildModelFromMJCF(str(path))
        self.data = self.model.createData()
        model = self.model
        self.names, self.sites = scene.names, mujoco_sites
        root, *hinges = scene.names
        self.q = [model.joints[model.getJointId(name)].idx_q for name in hinges]
        self.v = [model.joints[model.getJointId(name)].idx_v for name in hinges]
        self.root = model.joints[model.getJointId(root)]

    def turn(self, rotation):
        """T with v_ours = T v."""
        t = np.zeros((self.model.nv, self.model.nv))
        at = self.root.idx_v
        t[:3, at : at + 3] = t[3:6, at + 3 : at + 6] = rotation
        t[6 + np.arange(len(self.v)), self.v] = 1.0
        return t

    def read(self, case):
        model, data = self.model, self.data
        q, at = np.zeros(model.nq), self.root.idx_q
        q[at : at + 3] = case.qpos[:3]
        q[at + 3 : at + 7] = np.roll(case.qpos[3:7], -1)
        q[self.q] = case.qpos[7:]
        rotation = pinocchio.Quaternion(q[at + 3 : at + 7]).matrix()
        turn = self.turn(rotation)
        v, dof = turn.T @ case.qvel, self.root.idx_v
        # Of the twist, where ours is that of the origin.
        drift = np.zeros(model.nv)
        drift[dof : dof + 3] = np.cross(v[dof + 3 : dof + 6], v[dof : dof + 3])
        acceleration = turn.T @ case.acceleration - drift

        pinocchio.computeJointJacobians(model, data, q)
        pinocchio.forwardKinematics(model, data, q, v)
        pinocchio.updateFramePlacements(model, data)
        axes = pinocchio.ReferenceFrame.LOCAL_WORLD_ALIGNED
        bodies = []
        for name in self.names:
            joint = model.getJointId(name)
            pose = data.oMi[joint]
            velocity = pinocchio.getVelocity(model, data, joint, axes).vector
            bodies.append((pose.translation.copy(), pose.rotation.copy(), velocity.copy()))
        jacobian = lambda name: pinocchio.getFrameJacobian(model, data, model.getFrameId(name), axes) @ turn.T  # noqa: E731
        sites = {name: jacobian(name) for name in self.sites}
        of_com = pinocchio.jacobianCenterOfMass(model, data, q) @ turn.T
        com = (data.com[0].copy(), of_com)
        half = pinocchio.crba(model, data, q)
        full = np.triu(half) + np.triu(half, 1).T
        mass = turn @ full @ turn.T
        bias = turn @ pinocchio.rnea(model, data, q, v, -drift)
        inverse = turn @ pinocchio.rnea(model, data, q, v, acceleration)
        return project(bodies, sites, com, mass, bias, inverse, case.forces)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scene", type=Path, help="MJCF file to use in place of our own export")
    parser.add_argument("--states", type=int, default=1000, help="number of random states")
    args = parser.parse_args()
    if args.scene is None:
        raise SystemExit("error: --scene is missing; write one with `sim-server export --robot-only -o F.xml`")
    scene = Scene.load(args.scene)
    low, high = scene.m.jnt_range[scene.hinge].T
    judges = [Mujoco(scene)]
    judges.append(Pinocchio(args.scene, judges[0].sites, scene))
    results = np.array([[judge.read(Case(i, low, high)) for i in range(args.states)] for judge in judges])
    largest = np.abs(results).max(axis=(0, 1))
    gaps = np.abs(results[0] - results[1]).max(axis=0) / largest
    for name, gap, size in zip(QUANTITIES, gaps, largest):
        print(f"{name}: MuJoCo and Pinocchio differ by {gap:.1e} of {size:.3g}")
    if gaps.max() > TOLERANCE:
        raise SystemExit("error: the two judges disagree; nothing is written")
    rows = dict(zip(("by_mujoco", "by_pinocchio"), numbers(results, 13)))
    names = {"quantities": list(QUANTITIES), "sites": judges[0].sites, "largest": numbers(largest, 3)}
    write_fixture("kinematics", {"pinocchio": pinocchio.__version__, **names, **rows})


if __name__ == "__main__":
    main()
