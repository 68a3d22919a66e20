"""Clones S07 from demonstrations: where things are becomes a command to the whole-body controller.

fiatlux demonstrate --policy walk --task S07 --episodes 20 --no-pictures --out demos/s07
python bc.py demos/s07/bags 1100 1116
"""

import sys

import fiatlux
import numpy as np
from fiatlux import poses

SENSORS, COMMAND = ["proprioception", "privileged"], ("vx", "vy", "wz")


def features(seen, ends):
    """Where bulb and crate are from the robot, and the place beside the bulb where demonstrations end; the crate only while it is near.

    No velocities: a clone that sees them learns to go on as it goes, and so to stand.
    """
    robot, bulb, crate = (np.atleast_2d(poses.of(seen, thing)) for thing in ("robot", "fresh_bulb", "crate"))
    parts = []
    for place, reach in ((bulb[:, :2], 3.0), (bulb[:, :2] + ends, 3.0), (crate[:, :2], 0.5)):
        x, y = (place - robot[:, :2]).T
        far, off = np.hypot(x, y), np.arctan2(y, x) - poses.heading(robot[:, 3:])
        near = np.exp(-2 * np.maximum(far - reach, 0))
        parts += [np.minimum(far, 3), np.exp(-2 * far), near * np.cos(off), near * np.sin(off)]
    return np.stack(parts, axis=1)


SIDES = [3, 7, 11], [1, 2]  # features and commands that have the other sign in a mirror


class Network:
    """A layer of random units, and a linear one that ridge regression finds."""

    def __init__(self, inputs, outputs, units=200, penalty=100.0):
        random = np.random.default_rng(0)
        self.mean, self.scale = inputs.mean(0), inputs.std(0) + 1e-3
        self.layer = 0.3 * random.normal(size=(inputs.shape[1], units)), random.normal(size=units)
        hidden = self.hidden(inputs)
        self.last = np.linalg.solve(hidden.T @ hidden + penalty * np.eye(hidden.shape[1]), hidden.T @ outputs)

    def hidden(self, inputs):
        scaled = np.clip((inputs - self.mean) / self.scale, -3, 3)
        return np.hstack([np.tanh(scaled @ self.layer[0] + self.layer[1]), np.ones((len(scaled), 1))])

    def __call__(self, inputs):
        return self.hidden(inputs) @ self.last


class Clone:
    action_form, sensors = "joint_target", [*SENSORS, "last_action"]

    def __init__(self, bags):
        seen, commands = [], []
        begun = [bag.observations(SENSORS) for bag in bags]
        last = [poses.of(one, "robot")[-1, :2] - poses.of(one, "fresh_bulb")[-1, :2] for one in begun]
        self.ends = np.mean(last, axis=0)  # in the room's axes, in which the bench stands straight
        for bag, one in zip(bags, begun):
            given = bag.commands()[:, :3].astype(float)
            begins = np.argmax(np.abs(given).max(axis=1) > 0)  # it stands at first
            for sign in (1, -1):  # as it is, and in a mirror
                seen.append(features(one, self.ends)[begins:-1])
                commands.append(given[begins:].copy())
                seen[-1][:, SIDES[0]] *= sign
                commands[-1][:, SIDES[1]] *= sign
        self.network = Network(np.concatenate(seen), np.concatenate(commands))
        self.low, self.high = np.concatenate(commands).min(0), np.concatenate(commands).max(0)

    def reset(self, info):
        self.body = fiatlux.WholeBody()

    def __call__(self, seen):
        command = np.clip(self.network(features(seen, self.ends))[0], self.low, self.high)
        return self.body.joint_targets(seen, **dict(zip(COMMAND, command)))


if __name__ == "__main__":
    policy = Clone(fiatlux.Bag.below(sys.argv[1], training=True))
    print(fiatlux.evaluate(policy, ["S07"], range(*map(int, sys.argv[2:4]))).table())
