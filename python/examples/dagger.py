"""Distils the expert of S06 or S07: `python dagger.py S07 8` plays and learns for eight rounds, and then plays in 32 other rooms."""

import sys

import numpy as np
from fiatlux import Experts, VectorEnv, WholeBodies, poses

THINGS, PHASES = {"S06": ["crate"], "S07": ["fresh_bulb", "crate", "ladder"]}, {}  # to look at; the expert's, by name


def features(seen, task, phase, since):  # also in the axes of the room, in which crate and bench stand straight
    robot, things = poses.of(seen, "robot"), np.stack([poses.of(seen, thing) for thing in THINGS[task]], axis=1)
    near, away = poses.compose(poses.inverse(robot)[:, None], things), things[..., :3] - robot[:, None, :3]
    parts = [near[..., :3], away, away / (np.linalg.norm(away, axis=-1, keepdims=True) + 0.2), np.eye(17)[phase]]
    parts += [poses.rotate(pose[..., 3:], axis) for pose in (near, things, robot) for axis in np.eye(3)[[0, 2]]]
    parts += [robot[:, 2 * (task == "S06") : 3], np.minimum(since[:, None] / [25, 75, 200, 500], 1)]
    return np.hstack([part.reshape(len(robot), -1) for part in parts]).astype("f"), poses.upright(robot)[:, 3:]


class Network:
    def layers(self, inputs):
        units = [unit := np.clip((inputs - self.means[0]) / self.scales[0], -5, 5)]
        units += [unit := np.tanh(unit @ weight) for weight in self.weights[:-1]]
        return [*units, unit @ self.weights[-1] * self.scales[1] + self.means[1]]

    def train(self, inputs, outputs, batches):  # from nothing, by Adam
        random, sizes = np.random.default_rng(0), [inputs.shape[1], 256, 256, outputs.shape[1]]
        self.means, self.scales = zip(*((part.mean(0), part.std(0) + 0.01) for part in (inputs, outputs)))
        self.weights = [random.normal(size=(a, b)).astype("f") / a**0.5 for a, b in zip(sizes, sizes[1:])]
        moments = [np.zeros((2, *weight.shape), np.float32) for weight in self.weights]
        for step in range(batches):
            *units, last = self.layers(inputs[rows := random.integers(len(inputs), size=256)])
            error = np.tanh((last - outputs[rows]) / self.scales[1]) / 256
            for weight, moment, unit in reversed(list(zip(self.weights, moments, units))):
                slope, error = unit.T @ error, error @ weight.T * (1 - unit**2)
                moment += np.float32([[[0.1]], [[0.01]]]) * (np.stack([slope, slope**2]) - moment)
                weight -= 2e-3 * (1 - step / batches) * moment[0] / (np.sqrt(moment[1]) + 1e-6)


def drive(task, rooms, student, share, steps, data):  # the student walks in this share of the rooms, or does all
    env = VectorEnv(task, len(rooms), seeds=rooms, sensors=["proprioception", "privileged"], action_form="joint_target")
    experts, bodies = Experts(env), WholeBodies(len(rooms), env.num_threads, bends_low=True)
    count, random, verdicts = len(rooms), np.random.default_rng(rooms[0]), {}
    (phase, since), walks, (seen, _) = np.full((2, count), -1), random.random(count) < share, env.reset(seed=rooms[0])
    for _ in range(steps):
        (inputs, turned), label = features(seen, task, phase, since), experts.label()
        dice, taught = random.random((2, count)), np.array([PHASES.setdefault(now, len(PHASES)) for now in label.phase])
        experts.reset((label.phase == "StepUp") & (dice[0] < 0.02))  # or it goes on to where it wanted at first
        command = np.hstack([poses.rotate(turned, label.body_command[:, :3]), label.body_command[:, 3:]])
        wanted = np.hstack([command, label.joint_target[:, 15:], np.eye(16)[taught]])
        data.append((inputs[label.can_label], wanted[label.can_label].astype("f")))
        own = student.layers(inputs)[-1] if student else wanted
        wanted = np.where(walks[:, None] & (np.arange(wanted.shape[1]) < 3) | (share == 1), own, wanted)
        now = np.where((dice[1] < np.geomspace(0.05, 0.5, count)) | (share == 1), wanted[:, -16:].argmax(1), phase)
        wanted[:, :3] *= ((np.linalg.norm(wanted[:, :3], axis=1) > 0.08) & ((now < 1) | (share < 1)))[:, None]
        wanted[:, :3] = poses.rotate(poses.conjugate(turned), wanted[:, :3])
        legs = bodies(np.hstack([*seen.values()][:6]), wanted[:, :7], np.full((count, 2, 7), np.nan))
        seen, _, terminated, truncated, info = env.step(np.nan_to_num(np.hstack([legs[:, :15], wanted[:, 7:-16]])))
        bodies.reset(ended := terminated | truncated)
        phase, since = np.where(ended, -1, np.maximum(now, phase)), np.where(ended | (now > phase), 0, since + 1)
        verdicts = {**{room: info["success"][room] for room in np.flatnonzero(ended)}, **verdicts}
    return verdicts  # the first in each room


def main(task, rounds, worlds=64, steps=700, batches=6000, judged=range(1100, 1132), last=3000):
    data, student = [], PHASES.clear()  # none yet
    for number in range(rounds):
        drive(task, range(2000 + worlds * number, 2000 + worlds * (number + 1)), student, number / rounds, steps, data)
        (student := Network()).train(*map(np.concatenate, zip(*data)), batches * (10 if number + 1 == rounds else 1))
    return sum(drive(task, judged, student, 1, last, []).values())


if __name__ == "__main__":
    print(f"{main(sys.argv[1], int(sys.argv[2]))} of 32 rooms")
