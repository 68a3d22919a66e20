"""Stands by model predictive path integral control (MPPI) of the joints, in S07: `python mppi.py 20` stands for 20 s, or says when it fell."""

import sys

import fiatlux
import numpy as np

N, KNOTS, HOLD, EVERY = (
    48,
    4,
    10,
    2,
)  # candidates; offsets of a plan, each held for 0.2 s; control steps from decision to decision
SPREAD, WARMTH = 0.06, 0.05  # of the candidates, in action units; how soft the choice among them is


def directions(names):
    """Few numbers move the robot: for both legs, ankles, knees and hips ahead and to the side, and the waist."""
    rows = []
    for joint in ("ankle_pitch", "ankle_roll", "knee", "hip_pitch", "hip_roll"):
        rows.append([1.0 if joint in name else 0.0 for name in names])
    rows.append([1.0 if name == "waist_pitch_joint" else 0.0 for name in names])
    return np.array(rows)


def cost(seen, start):
    """Tilt, fall of the pelvis, drift and speed of each world."""
    field = lambda name: seen[name].astype(np.float64)
    tilt = np.linalg.norm(field("projected_gravity")[..., :2], axis=-1)
    drift = np.linalg.norm(field("privileged.robot_position") - start, axis=-1)
    speed = np.linalg.norm(field("base_linear_velocity"), axis=-1) + 0.3 * np.linalg.norm(
        field("base_angular_velocity"), axis=-1
    )
    return 4 * tilt**2 + 8 * drift**2 + 0.3 * speed**2


def stand(seconds, seed=1000):
    worlds = fiatlux.VectorEnv(
        "S07",
        N,
        seeds=[seed],
        episodes=1,
        sensors=["proprioception", "privileged"],
        noise=False,
        end_on=["fall", "time-out"],
    )
    seen, _ = worlds.reset(seed=1)
    start, moves = seen["privileged.robot_position"][0].astype(np.float64), directions(worlds.action_names)
    plan, random, everywhere = np.zeros((KNOTS, len(moves))), np.random.default_rng(0), np.ones(N, bool)
    for step in range(0, int(50 * seconds), EVERY):
        state = worlds.save(world=0)
        worlds.restore(state, everywhere)
        tried = plan + SPREAD * random.normal(size=(N, KNOTS, len(moves)))
        tried[0] = plan
        played = worlds.rollout(np.repeat(tried @ moves, HOLD, axis=1).swapaxes(0, 1), observations=True)
        fell = np.cumsum(played.terminated, axis=0) > 0
        costs = np.where(fell, 5.0, cost(played.observation, start)).mean(axis=0)
        weights = np.exp((costs.min() - costs) / (WARMTH * (costs.mean() - costs.min()) + 1e-9))
        plan = np.einsum("n,nki->ki", weights / weights.sum(), tried)
        worlds.restore(state, everywhere)
        played = worlds.rollout(np.tile(plan[0] @ moves, (EVERY, N, 1)))
        if played.terminated[:, 0].any():
            return (step + EVERY) / 50
        ahead = np.repeat(plan, HOLD, axis=0)
        plan = np.concatenate([ahead[EVERY:], np.repeat(ahead[-1:], EVERY, axis=0)])[::HOLD]
    return seconds


if __name__ == "__main__":
    print(f"stood for {stand(float(sys.argv[1])):.2f} s")
