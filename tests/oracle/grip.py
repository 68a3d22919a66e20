"""The grasp with which tasks start, in MuJoCo: how far a shaken bulb creeps in it, and the search that found it.

    python3 tests/oracle/grip.py shake g1_inspire [--friction 0.5] [--timestep 0.005] [--impratio 10] [--noslip 0] [--down palm]
    python3 tests/oracle/grip.py shake g1_inspire --grasp crates/world/tests/grasps/g1_inspire.toml
    python3 tests/oracle/grip.py search g1_dex3 --minutes 10 [--tilt 0.1 0.3]

The right hand alone, its root held still, made from the robot's file with the shapes, drives and friction of our exports, around the
bulb of `crates/world/scene.toml`. It closes as starts are staged, with `--grasp` in slippery hands (`crates/world/src/start/hold.rs`); the motion is that of
`crates/world/tests/it/shaken.rs`. Works in the environment of `oracle.py`.
"""

import argparse
from pathlib import Path

import environment
import tomllib

HERE = Path(__file__).resolve().parent
SCENE = HERE.parents[1] / "crates/world/scene.toml"
ROBOTS = HERE.parents[1] / "crates/robot/robots"
# The body that holds each robot's hand, m/s^2, and where a bulb is lost, m.
ROOTS = {"g1_inspire": "right_hand_base_link", "g1_dex3": "right_hand_palm_link"}
GRAVITY, LOST = 9.81, 0.06
# In the search: friction of the hand, and displacement from which a bulb is not held, m.
SLIPPERY, HELD = 0.05, 0.025
# How a grasp from a file is staged, as in `crates/world/tests/it/shaken.rs`, s.
SETTLING = {"closing_time": 0.5, "settling_time": 2.0, "holding_time": 0.2}


def rotation(roll, pitch, yaw):
    import numpy as np

    (cr, sr), (cp, sp), (cy, sy) = ((np.cos(a), np.sin(a)) for a in (roll, pitch, yaw))
    about_x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    about_y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    return np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]]) @ about_y @ about_x


def quaternion(matrix):
    import mujoco
    import numpy as np

    found = np.zeros(4)
    mujoco.mju_mat2Quat(found, np.ascontiguousarray(matrix).ravel())
    return found


def text(values):
    return " ".join(repr(float(value)) for value in values)


class Hand:
    """A robot's right hand as MJCF."""

    def __init__(self, robot):
        self.file = tomllib.loads((ROBOTS / f"{robot}.toml").read_text())
        self.root = ROOTS[robot]
        self.joints = {joint["child"]: joint for joint in self.file["joint"]}
        self.parent = {tie["child"]: tie for tie in [*self.file["joint"], *self.file["fixed"]]}
        self.links = {link["name"]: link for link in self.file["link"]}
        self.below = self.descend(self.root)

    def descend(self, link):
        children = [child for child, tie in self.parent.items() if tie["parent"] == link]
        return [link, *(below for child in children for below in self.descend(child))]

    def body_of(self, link):
        """The link of the body that a link belongs to: links without a joint are a part of the body above."""
        while link not in self.joints and link != self.root:
            link = self.parent[link]["parent"]
        return link

    def geom(self, shape, friction):
        surface = f'friction="{friction}" priority="1" condim="3"'
        if shape["kind"] == "capsule":
            return f'<geom type="capsule" fromto="{text(shape["from"] + shape["to"])}" size="{shape["radius"]}" {surface}/>'
        place = f'pos="{text(shape.get("pos", [0, 0, 0]))}" quat="{text(quaternion(rotation(*shape.get("rpy", [0, 0, 0]))))}"'
        size = [shape["radius"]] if shape["kind"] == "sphere" else shape["half_extents"]
        return f'<geom type="{shape["kind"]}" {place} size="{text(size)}" {surface}/>'

    def body(self, link, friction):
        tie, data = self.parent[link], self.links[link]
        place = ""
        if link != self.root:
            turn = quaternion(rotation(*tie.get("rpy", [0, 0, 0])))
            place = f'pos="{text(tie.get("xyz", [0, 0, 0]))}" quat="{text(turn)}"'
        inside = ""
        if "mass" in data:
            com, inertia = text(data.get("com", [0, 0, 0])), text(data["inertia"])
            inside += f'<inertial pos="{com}" mass="{data["mass"]}" fullinertia="{inertia}"/>'
        if link in self.joints and link != self.root:
            limits = f'range="{tie["lower"]} {tie["upper"]}" armature="{tie["armature"]}"'
            inside += f'<joint name="{tie["name"]}" axis="{text(tie["axis"])}" {limits}/>'
        inside += "".join(self.geom(shape, friction) for shape in self.file["shape"] if shape["link"] == link)
        children = [child for child in self.below[1:] if self.parent[child]["parent"] == link]
        inside += "".join(self.body(child, friction) for child in children)
        return f'<body name="{link}" {place}>{inside}</body>'

    def excluded(self):
        """Pairs of links whose bodies never touch: joined by a joint, or in a row of the file."""
        apart = {
            frozenset((link, self.body_of(self.parent[link]["parent"]))) for link in self.joints if link in self.below
        }
        for row in self.file["exclude"]:
            bodies = [self.body_of(link) for link in row if link in self.below]
            apart |= {frozenset((a, b)) for a in bodies for b in bodies}
        pairs = {(a, b) for a in self.below for b in self.below if a < b}
        return [(a, b) for a, b in pairs if frozenset((self.body_of(a), self.body_of(b))) in apart]

    def mjcf(self, bulb, friction, timestep, impratio, noslip):
        solids = ""
        for low, high, radius in bulb["solids"]:
            ends = f'fromto="0 0 {low} 0 0 {high}"' if high > low else f'pos="0 0 {low}"'
            solids += f'<geom type="{"capsule" if high > low else "sphere"}" {ends} size="{radius}" condim="3"/>'
        across, along = bulb["transverse_inertia"], bulb["axial_inertia"]
        mass = f'mass="{bulb["mass"]}" diaginertia="{across} {across} {along}"'
        drives = ""
        for link in self.below[1:]:
            if link in self.joints:
                joint = self.joints[link]
                gains = f'kp="{joint["stiffness"]}" kv="{joint["damping"]}"'
                limit = f'forcerange="{-joint["effort_limit"]} {joint["effort_limit"]}"'
                drives += f'<position name="{joint["name"]}" joint="{joint["name"]}" {gains} {limit}/>'
        apart = "".join(f'<exclude body1="{a}" body2="{b}"/>' for a, b in self.excluded())
        law = f'integrator="implicitfast" cone="elliptic" impratio="{impratio}" noslip_iterations="{noslip}"'
        return (
            f'<mujoco><compiler angle="radian" balanceinertia="true"/><option timestep="{timestep}" {law}/><worldbody>'
            f'{self.body(self.root, friction)}<body name="bulb"><freejoint/><inertial pos="0 0 {bulb["com_z"]}" {mass}/>'
            f"{solids}</body></worldbody><contact>{apart}</contact><actuator>{drives}</actuator></mujoco>"
        )


class Rig:
    """A hand and a bulb in MuJoCo. A grasp is centre of the glass, tilt and the targets of the joints, in one array."""

    def __init__(self, robot, friction, timestep=0.005, impratio=10.0, noslip=0, file=None):
        import mujoco
        import numpy as np

        self.mujoco, self.np = mujoco, np
        scene = tomllib.loads(SCENE.read_text())
        hand = Hand(robot)
        self.carry = scene["start"]["carry"]
        grasp = hand.file.get("bulb_grasp", self.carry)
        if file:
            grasp, self.carry = tomllib.loads(file.read_text())["bulb_grasp"], {**self.carry, **SETTLING}
        self.height = grasp["glass_height"]
        self.m = mujoco.MjModel.from_xml_string(hand.mjcf(scene["bulb"], friction, timestep, impratio, noslip))
        self.d = mujoco.MjData(self.m)
        self.friction, self.timestep = friction, timestep
        self.hand_geoms = np.flatnonzero(self.m.geom_priority == 1)
        self.names = list(grasp["grip"])
        self.limits = np.array([self.m.joint(name).range for name in self.names]).T
        self.drives = [self.m.actuator(name).id for name in self.names]
        joint = self.m.body_jntadr[self.m.body("bulb").id]
        self.q, self.v = self.m.jnt_qposadr[joint], self.m.jnt_dofadr[joint]
        link = grasp.get("link", grasp.get("hand_link"))
        # The grasp's own frame in the root's; a palm is fixed to it.
        tie = {} if link == hand.root else hand.parent[link]
        self.offset, self.turn = np.array(tie.get("xyz", [0.0, 0.0, 0.0])), rotation(*tie.get("rpy", [0, 0, 0]))
        self.grasp = np.array([*grasp["glass_center"], *grasp["glass_tilt"], *grasp["grip"].values()])
        # In the grasp's frame the palm faces -x and the fingers are along -y.
        palm = self.turn @ np.array([GRAVITY, 0.0, 0.0])
        self.downs = {"palm": palm, "fingers": self.turn @ np.array([0.0, GRAVITY, 0.0]), "back": -palm}

    def clipped(self, grasp):
        return self.np.concatenate([grasp[:5], self.np.clip(grasp[5:], *self.limits)])

    def glass(self):
        """Centre of the glass and axis of the bulb in the grasp's frame."""
        turn = self.np.zeros(9)
        self.mujoco.mju_quat2Mat(turn, self.d.qpos[self.q + 3 : self.q + 7])
        axis = turn.reshape(3, 3)[:, 2]
        center = self.d.qpos[self.q : self.q + 3] + self.height * axis
        return self.turn.T @ (center - self.offset), self.turn.T @ axis

    def step(self, seconds):
        self.mujoco.mj_step(self.m, self.d, round(seconds / self.timestep))

    def stage(self, grasp, settle=None):
        """Closes the hand, first around the bulb held still, with slippery surfaces where the bulb is to settle."""
        np, m, d = self.np, self.m, self.d
        self.mujoco.mj_resetData(m, d)
        m.opt.gravity[:] = self.downs["palm"]
        settle = settle or self.carry["settling_time"]
        m.geom_friction[self.hand_geoms, 0] = self.carry["settling_friction"] if settle else self.friction
        turn = rotation(np.pi + grasp[3], grasp[4], 0.0)
        place = self.offset + self.turn @ (grasp[:3] - self.height * turn[:, 2])
        pose = np.concatenate([place, quaternion(self.turn @ turn)])
        d.qpos[self.q : self.q + 7] = pose
        d.ctrl[self.drives] = self.clipped(grasp)[5:]
        for _ in range(round(self.carry["closing_time"] / self.timestep)):
            self.mujoco.mj_step(m, d)
            d.qpos[self.q : self.q + 7], d.qvel[self.v : self.v + 6] = pose, 0.0
        self.step(settle)
        m.geom_friction[self.hand_geoms, 0] = self.friction
        self.step(self.carry["holding_time"])

    def shake(self, down, seconds):
        """Distance, m, and angle, rad, of the bulb's mean pose in the last second from that in the second one."""
        np = self.np
        gravity, windows = self.downs[down], ([], [])
        start = self.glass()[0]
        for step in range(round(seconds / 0.02)):
            time = 0.02 * step
            sine = lambda hz, phase, time=time: np.sin(2.0 * np.pi * hz * time + phase)
            turn = 0.3 * np.array([sine(0.37, 0.0), sine(0.5, 1.0), sine(0.43, 2.0)])
            shaken = 2.0 * np.array([sine(1.3, 0.0), sine(1.7, 0.5), sine(2.1, 1.1)])
            local = self.turn.T @ gravity
            self.m.opt.gravity[:] = self.turn @ (local + np.cross(turn, local) + shaken)
            self.step(0.02)
            center, axis = self.glass()
            if not np.linalg.norm(center - start) < LOST:
                return np.inf, np.inf
            for window, begins in zip(windows, (1.0, seconds - 1.0), strict=True):
                if begins <= time < begins + 1.0:
                    window.append([center, axis])
        (first, up), (last, turned) = (np.mean(window, axis=0) for window in windows)
        cosine = up @ turned / np.linalg.norm(up) / np.linalg.norm(turned)
        return float(np.linalg.norm(last - first)), float(np.arccos(np.clip(cosine, -1.0, 1.0)))


def enclosure(rig, grasp, usual, tilt_bound):
    """Movement of the bulb in a slippery hand as gravity points along each axis; much more where it is not held."""
    np = rig.np
    cost = 5.0 * np.sum((rig.clipped(grasp) - grasp) ** 2)
    rig.stage(grasp, settle=2.5)
    before = rig.glass()[0]
    if not np.linalg.norm(before - grasp[:3]) < 0.04:
        return 1e3
    # What still slides has not found its place.
    rig.step(1.0)
    center, axis = rig.glass()
    drift = np.linalg.norm(center - before)
    if not drift < HELD:
        return 5e2
    cost += 5e3 * drift
    tilt = np.array([np.arcsin(np.clip(axis[1], -1.0, 1.0)), np.arctan2(-axis[0], -axis[2])])
    cost += 400.0 * np.sum(np.maximum(0.0, np.abs(tilt - usual[3:5]) - tilt_bound) ** 2)
    cost += 2e4 * np.sum(np.maximum(0.0, np.abs(center - usual[:3]) - 0.01) ** 2)
    moves = []
    for down in (sign * GRAVITY * axis for axis in np.eye(3) for sign in (1.0, -1.0)):
        rig.m.opt.gravity[:] = down
        rig.step(0.35)
        at, turned = rig.glass()
        moved = np.linalg.norm(at - center)
        if not moved < HELD:
            return cost + 20.0 + 12.0 * (6 - len(moves))
        moves.append(1e3 * moved + 30.0 * np.arccos(np.clip(axis @ turned, -1.0, 1.0)))
    return cost + max(moves) + 0.3 * sum(moves)


def search(rig, usual, tilt_bound, minutes, seed):
    """CMA-ES from the present grasp (Hansen, The CMA Evolution Strategy: A Tutorial, 2016)."""
    import time

    np = rig.np
    random, n, population = np.random.default_rng(seed), len(rig.grasp), 16
    scale = np.concatenate([3 * [0.006], 2 * [0.15], (n - 5) * [0.25]])
    parents = population // 2
    weights = np.log(parents + 0.5) - np.log(np.arange(1, parents + 1))
    weights /= weights.sum()
    mass = 1.0 / (weights @ weights)
    c_c, c_s = (mass + 4) / (n + 4 + 2 * mass), (mass + 2) / (n + mass + 5)
    c_1 = 2.0 / ((n + 1.3) ** 2 + mass)
    c_mu = min(1.0 - c_1, 2.0 * (mass - 2.0 + 1.0 / mass) / ((n + 2) ** 2 + mass))
    damping = 1.0 + c_s + 2.0 * max(0.0, np.sqrt((mass - 1) / (n + 1)) - 1.0)
    length = np.sqrt(n) * (1.0 - 1.0 / (4 * n) + 1.0 / (21 * n * n))
    mean, covariance, sigma = np.zeros(n), np.eye(n), 0.4
    path, path_s = np.zeros(n), np.zeros(n)
    best, ends, generation = (np.inf, rig.grasp), time.monotonic() + 60.0 * minutes, 0
    while time.monotonic() < ends:
        values, vectors = np.linalg.eigh(covariance)
        axes = np.sqrt(np.maximum(values, 1e-12))
        steps = (random.standard_normal((population, n)) * axes) @ vectors.T
        tries = [rig.grasp + scale * (mean + sigma * step) for step in steps]
        costs = np.array([enclosure(rig, grasp, usual, tilt_bound) for grasp in tries])
        order = np.argsort(costs)
        best = min(best, (costs[order[0]], tries[order[0]]), key=lambda pair: pair[0])
        chosen = steps[order[:parents]]
        move = weights @ chosen
        mean = mean + sigma * move
        path_s = (1 - c_s) * path_s + np.sqrt(c_s * (2 - c_s) * mass) * (vectors @ ((vectors.T @ move) / axes))
        path = (1 - c_c) * path + np.sqrt(c_c * (2 - c_c) * mass) * move
        covariance = (1 - c_1 - c_mu) * covariance + c_1 * np.outer(path, path) + c_mu * (chosen.T * weights) @ chosen
        sigma *= np.exp(c_s / damping * (np.linalg.norm(path_s) / length - 1.0))
        generation += 1
        print(f"{generation}: best {best[0]:.2f}, step {sigma:.2f}", flush=True)
    return rig.clipped(best[1])


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("what", choices=["shake", "search"])
    parser.add_argument("robot", choices=list(ROOTS))
    parser.add_argument(
        "--grasp", type=Path, help="a table bulb_grasp in place of the start's grasp; the search begins with it"
    )
    parser.add_argument("--friction", type=float, default=0.5, help="of the hand")
    parser.add_argument("--timestep", type=float, default=0.005)
    parser.add_argument("--impratio", type=float, default=10.0)
    parser.add_argument("--noslip", type=int, default=0, help="iterations")
    parser.add_argument("--seconds", type=float, default=120.0)
    parser.add_argument(
        "--down", choices=["palm", "fingers", "back"], default="palm", help="where gravity points in the hand"
    )
    parser.add_argument(
        "--tilt",
        type=float,
        nargs=2,
        default=[0.25, 0.25],
        help="in the search, most that the bulb may be turned about x and y against the start's grasp, rad",
    )
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    friction = args.friction if args.what == "shake" else SLIPPERY
    rig = Rig(args.robot, friction, args.timestep, args.impratio, args.noslip, args.grasp)
    if args.what == "shake":
        rig.stage(rig.grasp)
        moved, turned = rig.shake(args.down, args.seconds)
        print(f"moved {1e3 * moved:.2f} mm and {turned:.3f} rad" if moved < LOST else "lost")
        return
    usual = Rig(args.robot, friction).grasp
    found = search(rig, usual, rig.np.array(args.tilt), args.minutes, args.seed)
    center, tilt = found[:3].round(4).tolist(), found[3:5].round(4).tolist()
    print(f"glass_center = {center}\nglass_height = {rig.height}\nglass_tilt = {tilt}")
    for name, target in zip(rig.names, found[5:].round(4).tolist(), strict=True):
        print(f"grip.{name} = {target}")


if __name__ == "__main__":
    environment.enter(__file__, HERE / ".venv", HERE / "requirements.txt")
    main()
