"""Distils the expert into a small network: the student drives more and more, the expert says in each row what it would do.

python dagger.py S07 8                       # eight rounds, then 32 rooms that it has not seen"""

import sys

import fiatlux
import numpy as np
from fiatlux import poses

BODY = "base_angular_velocity projected_gravity base_linear_velocity base_height joint_position joint_velocity".split()
SETTINGS = {"sensors": ["proprioception", "last_action", "privileged"], "action_form": "joint_target"}
THINGS = "fresh_bulb", "old_bulb", "crate", "ladder", "socket"


def flat(seen, names):
    return np.hstack([seen[name].reshape(len(seen[name]), -1) for name in names]).astype(float)


def features(seen):  # what the robot feels, its last action, and where things are from its pelvis
    near = [poses.compose(poses.inverse(poses.of(seen, "robot")), poses.of(seen, thing)) for thing in THINGS]
    return np.hstack([flat(seen, [BODY[1], *BODY[3:], "last_action"]), *near]).astype(np.float32)


class Network:
    def __init__(self, inputs, outputs):  # the last weight of each unit is that of a unit that is always 1
        self.random, sizes = np.random.default_rng(0), [inputs.shape[1], 256, 256, outputs.shape[1]]
        self.weights = [self.random.normal(size=(a + 1, b)).astype("f") / a**0.5 for a, b in zip(sizes, sizes[1:])]
        self.means, self.scales = zip(*((part.mean(0), part.std(0) + 0.01) for part in (inputs, outputs)))

    def layers(self, inputs):
        units = [np.clip((inputs - self.means[0]) / self.scales[0], -5, 5)]
        for weight in self.weights:
            units[-1] = np.hstack([units[-1], np.ones((len(inputs), 1), np.float32)])
            units.append(np.tanh(units[-1] @ weight))
        return [*units[:-1], units[-2] @ weight * self.scales[1] + self.means[1]]

    def train(self, inputs, outputs, batches):
        moments = [np.zeros((2, *weight.shape), np.float32) for weight in self.weights]
        for step in range(batches):
            rows = self.random.integers(len(inputs), size=256)
            *units, last = self.layers(inputs[rows])
            error = np.tanh((last - outputs[rows]) / self.scales[1]) / 256
            for weight, moment, unit in reversed(list(zip(self.weights, moments, units))):
                slope, error = unit.T @ error, (error @ weight.T * (1 - unit**2))[:, :-1]
                moment += np.float32([[[0.1]], [[0.01]]]) * (np.stack([slope, slope**2]) - moment)
                weight -= 2e-3 * (1 - step / batches) * moment[0] / (np.sqrt(moment[1]) + 1e-6)


def drive(task, rooms, student, share, data, steps):  # an episode is the student's with this chance, else the expert's
    env = fiatlux.VectorEnv(task, len(rooms), seeds=rooms, **SETTINGS)
    experts, bodies = fiatlux.Experts(env), fiatlux.WholeBodies(len(rooms), env.num_threads, bends_low=True)
    random, verdicts, drives = np.random.default_rng(len(data)), {}, (ended := np.ones(len(rooms), bool))
    seen, _ = env.reset(seed=len(data))
    for _ in range(steps):
        drives = np.where(ended, random.random(len(rooms)) < share, drives)
        label, inputs = experts.label(), features(seen)
        wanted = np.hstack([label.body_command, label.arms, label.hands])
        data.append((inputs[label.can_label], wanted[label.can_label].astype(np.float32)))
        wanted = np.where(drives[:, None], student.layers(inputs)[-1], wanted) if student else wanted
        legs = bodies(flat(seen, BODY), wanted[:, :7], np.full((len(rooms), 2, 7), np.nan))[:, :15]
        seen, _, terminated, truncated, info = env.step(np.nan_to_num(np.hstack([legs, wanted[:, 7:]])))
        bodies.reset(ended := terminated | truncated)
        verdicts = {**{room: info["success"][room] for room in np.flatnonzero(ended)}, **verdicts}
    return verdicts  # the first in each room


def main(task, rounds, worlds=16, steps=700, batches=2500, judged=range(1100, 1132), last=2000):
    data, student = [], None
    for number in range(rounds):
        drive(task, range(1000, 1000 + worlds), student, number / rounds, data, steps)
        inputs, outputs = (np.concatenate(part) for part in zip(*data))
        (student := student or Network(inputs, outputs)).train(inputs, outputs, batches)
    return sum(drive(task, judged, student, 1, [], last).values())


if __name__ == "__main__":
    print(f"{main(sys.argv[1], int(sys.argv[2]))} of 32 rooms")
