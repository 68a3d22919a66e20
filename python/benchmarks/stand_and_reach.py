"""Measures standing of the whole-body controller while both arms reach: the figures of docs/notes/walking.md.

    python python/benchmarks/stand_and_reach.py --episodes 8

Each episode is one of S05, which begins with the spent bulb in the right hand. After eight seconds of standing both arms go to
twenty random poses about the one they began in, at 2 rad/s at most, and stay in each for three seconds. In the last two seconds of
each the distances of the pelvis and of the bulb from their own means are measured, as a root of the mean square (rms), mm; the
bulb's only while it is in the hand, that is above half a metre. The drift is the way of the pelvis over a minute of standing with
the arms at rest, between means over two seconds.
"""

import argparse
import json

import fiatlux
import numpy as np
from fiatlux.whole_body import LEGS_AND_WAIST

STEPS_PER_S = 50
FASTEST = 2.0 / STEPS_PER_S
REACH = np.array([0.5, 0.3, 0.4, 0.5, 0.4, 0.3, 0.3] * 2)
"""Half-widths of the poses that are drawn, rad, joint by joint from the shoulder."""
HELD_M = 0.5
"""Height above which the bulb counts as held, m: a dropped one lies on the floor."""
SETTLES = 8 * STEPS_PER_S
"""Control steps of standing first, in which the controller takes over from its network."""


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=8)
    parser.add_argument("--first-seed", type=int, default=64)
    parser.add_argument("--reaches", type=int, default=20)
    parser.add_argument("--exact", action="store_true", help="without the benchmark's noise")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()

    pelvis, hand, drifts, ended, dropped = [], [], [], 0, 0
    for seed in range(args.first_seed, args.first_seed + args.episodes):
        reached = reach(seed, args.reaches, not args.exact)
        pelvis += reached[0]
        hand += reached[1]
        ended += reached[2]
        dropped += len(reached[1]) < len(reached[0])
        drift = stand(seed, not args.exact)
        drifts += [] if drift is None else [drift]
    found = {"episodes": args.episodes, "reaches": len(pelvis), "ended early": ended, "bulb dropped": dropped}
    for name, values in (("pelvis rms mm", pelvis), ("hand rms mm", hand), ("drift in 60 s, mm", drifts)):
        # Where every episode ends early there is nothing to measure.
        found[f"{name}, mean"] = float(np.mean(values)) if values else None
        found[f"{name}, worst"] = float(np.max(values)) if values else None
    print(
        json.dumps(found)
        if args.json
        else "\n".join(
            f"{name:<26}{'none' if value is None else format(value, '.3g'):>9}" for name, value in found.items()
        )
    )


class Standing:
    """An episode in which the controller stands and the arms are driven."""

    def __init__(self, seed, noise):
        self.env = fiatlux.Env("S05", action_form="joint_target", observation="dict", noise=noise)
        self.observation, _ = self.env.reset(seed=seed)
        self.body = fiatlux.WholeBody()
        self.targets = self.body.targets(self.observation)
        self.arms = self.targets[LEGS_AND_WAIST : len(self.body.q0)].copy()

    def step(self, arms):
        """A control step with these targets of the arms; places of pelvis and bulb, m, or None once it has ended."""
        self.targets[LEGS_AND_WAIST : len(self.body.q0)] = arms
        self.targets[:LEGS_AND_WAIST] = self.body(self.observation)
        self.observation, _, terminated, truncated, _ = self.env.step(self.targets)
        row = self.env.row()
        places = np.concatenate((row["robot_pose"][:3], row["old_bulb_pose"][:3]))
        return None if terminated or truncated else places


def rms_mm(places):
    """Of the distances from the mean place."""
    return 1e3 * float(np.sqrt(np.square(places - places.mean(axis=0)).sum(axis=1).mean()))


def reach(seed, reaches, noise):
    """Rms of pelvis and hand at each reach, and whether the episode ended before the last."""
    random = np.random.default_rng(seed)
    standing = Standing(seed, noise)
    begin = arms = standing.arms
    pelvis, hand = [], []
    for _ in range(SETTLES):
        if standing.step(arms) is None:
            return pelvis, hand, True
    for _ in range(reaches):
        goal = begin + random.uniform(-REACH, REACH)
        while np.abs(goal - arms).max() > 1e-9:
            arms = arms + np.clip(goal - arms, -FASTEST, FASTEST)
            if standing.step(arms) is None:
                return pelvis, hand, True
        places = []
        for _ in range(3 * STEPS_PER_S):
            here = standing.step(arms)
            if here is None:
                return pelvis, hand, True
            places.append(here)
        places = np.array(places[-2 * STEPS_PER_S :])
        pelvis.append(rms_mm(places[:, :3]))
        if places[:, 5].min() > HELD_M:
            hand.append(rms_mm(places[:, 3:]))
    return pelvis, hand, False


def stand(seed, noise):
    """The way of the pelvis over a minute of standing, mm, on the floor; None where the episode ended."""
    standing = Standing(seed, noise)
    places = []
    for _ in range(SETTLES + 60 * STEPS_PER_S):
        here = standing.step(standing.arms)
        if here is None:
            return None
        places.append(here[:2])
    places = np.array(places)
    first, last = places[SETTLES - 2 * STEPS_PER_S : SETTLES].mean(axis=0), places[-2 * STEPS_PER_S :].mean(axis=0)
    return 1e3 * float(np.linalg.norm(last - first))


if __name__ == "__main__":
    main()
