"""Picks the bulb from the bench (S08) by inverse kinematics and touch: `python pick.py 1000 1016` plays these rooms."""

import sys

import fiatlux
import numpy as np
from fiatlux import poses

KIN = fiatlux.Kinematics()  # the benchmark's robot
NAMES = [name for name in KIN.joints if name.startswith(("right_shoulder", "right_elbow", "right_wrist"))]
ARM, HAND = ([KIN.joints.index(name) for name in names] for names in (NAMES, KIN.grip))
GRIP, DELAY = np.array([*KIN.grip.values()]), np.array([0.0 if "thumb" in name else 0.3 for name in KIN.grip])  # rad, s
SAME = np.array([[a.split("_")[1] == b.split("_")[1] for b in KIN.hand_bodies["right"]] for a in KIN.grip])  # finger
REST = [-0.8, -1.2, 0.0, 0.0, 0.5, 0.6, 0.5]  # where the arm's joints go where the hand leaves them free, rad
PLACE, OPEN = np.array([0.38, -0.08]), -0.25  # of the bulb before the pelvis, m; share of the grip, the thumb wide open
READY, BESIDE, AROUND = (0.16, -0.10, 0.05), (0.07, 0.0, 0.0), (0.0, 0.002, 0.0)  # of the hand, in the grasp's frame, m


class Pick:
    action_form, sensors = "joint_target", ["proprioception", "hand_contact", "last_action", "privileged"]

    def reset(self, info):
        self.body, self.plan, self.q = fiatlux.WholeBody(), self.steps(), None

    def __call__(self, seen):
        now = KIN.q0 + seen["joint_position"]
        self.seen, self.q = seen, now if self.q is None else self.q + 0.15 * (now - self.q)
        self.pelvis, self.bulb = poses.of(seen, "robot"), poses.of(seen, "fresh_bulb")
        self.facing = poses.of_vector([0, 0, poses.heading(self.pelvis[3:])])
        self.away = poses.rotate(poses.conjugate(self.facing), self.bulb[:3] - self.pelvis[:3])[:2]
        return next(self.plan)

    def grasp(self, turn, way):  # pose of the grasp on a way to the glass, the fingers turned to the left
        turned = poses.multiply(self.facing, poses.of_vector([0, 0, turn - np.pi / 2]))
        return poses.compose([*poses.transform(self.bulb, [0, 0, KIN.glass_height]), *turned], [*way, 1, 0, 0, 0])

    def solve(self, goal, start=REST, tries=12):  # the arm's angles; the room of its joints, below 0 if it cannot reach
        qpos = KIN.reference.copy()
        qpos[KIN.pelvis_qpos], qpos[KIN.joint_qpos], qpos[KIN.joint_qpos[ARM]] = self.pelvis, self.q, start
        found = KIN.inverse(qpos, {"right_grasp": goal}, joints=NAMES, rest=REST, rest_pull=0.1, tries=tries)
        angles, far = found.qpos[KIN.joint_qpos[ARM]], found.position_error + found.rotation_error > 0.01
        return angles, -1.0 if far else np.abs(KIN.joint_limits[ARM] - angles[:, None]).min()

    def act(self, share=OPEN, height=0.78, vx=0.0, vy=0.0):
        targets = self.body.targets(self.seen)
        targets[:15] = self.body(self.seen, vx=vx, vy=vy, height=height)
        targets[15:29] = self.body.hold_arms(self.seen, [*self.left, *self.arm])
        self.felt |= SAME @ (
            np.linalg.norm(self.seen["right_hand_contact"], axis=1) > 1.0
        )  # a finger: 1 N, then 0.3 N m
        most = np.where(self.felt, self.q[HAND] + 0.3 / KIN.stiffness[HAND], np.inf)
        targets[HAND] = np.minimum(GRIP * share, most)
        return targets

    def go(self, posture, shares, rate=0.02):  # the arm follows postures by the part of the way, the hand closes
        for part, share in zip(np.linspace(0, 1, len(shares)), shares):
            self.arm = self.arm + np.clip(posture(part) - self.arm, -rate, rate)
            yield self.act(share)

    def steps(self):
        line = lambda a, b: lambda part: self.solve([*(a + part * (b - a))[:3], *b[3:]], self.arm, 1)[0]
        self.left, self.arm, self.felt = self.q[15:22] + [0.5, *[0] * 6], self.q[ARM], np.zeros(len(HAND), bool)
        while np.linalg.norm(self.away) < 0.64:  # there the hand comes up clear of the bench
            yield self.act(height=0.75, vx=-0.2)
        back = poses.rotate(self.facing, [*(self.away - PLACE), 0.78 - self.pelvis[2]])  # from where it will stand
        ready = self.solve(self.grasp(0.6, READY) - [*back, 0, 0, 0, 0])[0]
        yield from self.go(lambda part: ready, np.full(150, OPEN), 0.012)
        while (far := np.linalg.norm(off := self.away - PLACE)) > 0.04:
            vx, vy = off / far * np.clip(1.5 * far, 0.1, 0.2)
            yield self.act(height=0.75, vx=vx, vy=vy)
        yield from (self.act() for _ in range(150))
        room = lambda turn: min(self.solve(self.grasp(turn, way))[1] for way in (AROUND, BESIDE))
        turn = max(np.linspace(0.0, 1.1, 12), key=room)
        posture = self.solve(self.grasp(turn, BESIDE))[0]
        yield from self.go(lambda part: posture, np.full(75, OPEN), 0.012)
        beside, around = self.grasp(turn, BESIDE), self.grasp(turn, AROUND)
        yield from self.go(line(beside, beside), np.full(100, OPEN))
        yield from self.go(line(beside, around), np.full(60, OPEN))
        yield from self.go(line(around, around), np.clip(np.arange(125)[:, None] / 50 - 0.5 - DELAY + OPEN, OPEN, 1))
        yield from self.go(line(around, around + [0, 0, 0.14, 0, 0, 0, 0]), np.ones(70))
        yield from (self.act(1.0) for _ in range(6000))


if __name__ == "__main__":
    print(fiatlux.evaluate(Pick, ["S08"], range(*map(int, sys.argv[1:3]))).table())
