"""Picks the bulb from the bench (S08) by inverse kinematics and touch: `python pick.py 1000 1016` plays these rooms."""

import sys

import fiatlux
import numpy as np
from fiatlux import poses

KIN = fiatlux.Kinematics()  # the benchmark's robot
ARM = KIN.joint_groups["right_arm"]
REST = [-0.8, -1.2, 0.0, 0.0, 0.5, 0.6, 0.5]  # where the arm's joints go where the hand leaves them free, rad
PLACE, OPEN = np.array([0.38, -0.08]), -0.25  # of the bulb before the pelvis, m; share of the grip, the thumb wide open
READY, BESIDE, AROUND = (0.16, -0.10, 0.05), (0.07, 0.0, 0.0), (0.0, 0.002, 0.0)  # of the hand, in the grasp's frame, m


class Pick:
    action_form, sensors = "joint_target", ["proprioception", "hand_contact", "last_action", "privileged"]

    def reset(self, info):
        self.body, self.grip = fiatlux.WholeBody(), fiatlux.Grip(KIN, thumb_first=0.3)
        self.plan, self.q = self.steps(), KIN.q0

    def __call__(self, seen):
        self.seen, self.q = seen, self.q + 0.15 * (KIN.q0 + seen["joint_position"] - self.q)
        self.pelvis, self.bulb = poses.of(seen, "robot"), poses.of(seen, "fresh_bulb")
        self.facing = poses.upright(self.pelvis)
        self.away = poses.transform(poses.inverse(self.facing), self.bulb[:3])[:2]
        return next(self.plan)

    def grasp(self, turn, way):  # pose of the grasp on a way to the glass, the fingers turned to the left
        turned = poses.multiply(self.facing[3:], poses.of_vector([0, 0, turn - np.pi / 2]))
        return poses.compose([*poses.transform(self.bulb, [0, 0, KIN.glass_height]), *turned], [*way, 1, 0, 0, 0])

    def solve(self, goal, start=REST, tries=12):
        qpos = KIN.reference.copy()
        qpos[KIN.pelvis_qpos], qpos[KIN.joint_qpos], qpos[KIN.joint_qpos[ARM]] = self.pelvis, self.q, start
        return KIN.inverse(qpos, {"right_grasp": goal}, joints=ARM, rest=REST, rest_pull=0.1, tries=tries)

    def act(self, share=OPEN, height=0.78, vx=0.0, vy=0.0):
        targets = self.body.joint_targets(self.seen, arms=[*self.left, *self.arm], vx=vx, vy=vy, height=height)
        targets[self.grip.joints] = self.grip(self.seen, share)
        return targets

    def go(self, posture, shares, rate=0.02):  # the arm follows postures by the part of the way, the hand closes
        for part, share in zip(np.linspace(0, 1, len(shares)), shares):
            angles = posture(part) if callable(posture) else posture
            self.arm = self.arm + np.clip(angles - self.arm, -rate, rate)
            yield self.act(share)

    def steps(self):
        line = lambda a, b: lambda part: self.solve([*(a + part * (b - a))[:3], *b[3:]], self.arm, 1).angles
        self.left, self.arm = self.q[15:22] + [0.5, *[0] * 6], self.q[ARM]
        while np.linalg.norm(self.away) < 0.64:  # there the hand comes up clear of the bench
            yield self.act(height=0.75, vx=-0.2)
        back = poses.rotate(self.facing[3:], [*(self.away - PLACE), 0.78 - self.pelvis[2]])  # from where it will stand
        yield from self.go(self.solve(self.grasp(0.6, READY) - [*back, 0, 0, 0, 0]).angles, [OPEN] * 150, 0.012)
        while (far := np.linalg.norm(off := self.away - PLACE)) > 0.04:
            vx, vy = off / far * np.clip(1.5 * far, 0.1, 0.2)
            yield self.act(height=0.75, vx=vx, vy=vy)
        yield from (self.act() for _ in range(150))
        room_of = lambda found: found.limit_distance if found.position_error + found.rotation_error < 0.01 else -1.0
        room = lambda turn: min(room_of(self.solve(self.grasp(turn, way))) for way in (AROUND, BESIDE))
        turn = max(np.linspace(0.0, 1.1, 12), key=room)
        yield from self.go(self.solve(self.grasp(turn, BESIDE)).angles, [OPEN] * 75, 0.012)
        beside, around = self.grasp(turn, BESIDE), self.grasp(turn, AROUND)
        yield from self.go(line(beside, beside), [OPEN] * 100)
        yield from self.go(line(beside, around), [OPEN] * 60)
        yield from self.go(line(around, around), np.clip(np.arange(125) / 50 - 0.5 + OPEN, OPEN, 1))
        yield from self.go(line(around, around + [0, 0, 0.14, 0, 0, 0, 0]), [1.0] * 70)
        yield from (self.act(1.0) for _ in range(6000))


if __name__ == "__main__":
    print(fiatlux.evaluate(Pick, ["S08"], range(*map(int, sys.argv[1:3]))).table())
