"""Tests the whole-body controllers of many worlds, and the hand's actions on top of them. `extras/test_train.py` trains a policy of them."""

import fiatlux
import numpy as np
import pytest
from fiatlux.hand import ACTIONS, SENSORS, HandActions
from test_baseline import packed

GRASP = {
    "closed": [0.7, 0.4, 0.3, 0.8, 1.5, 0.5, 1.0, 0.4, 0.4, 1.1, 1.0, 1.3],
    "thumb": [True] * 4 + [False] * 8,
    "height": 0.9578,
    "glass": 0.1531,
    "centre": [-0.063, -0.03, -0.025],
    "turn": [0.152, 0.86, -0.488, 0.004],
    "place": [0.378, -0.102],
}


def worlds(count):
    # Two starts would stand at different distances from the bulb.
    settings = {"sensors": SENSORS, "action_form": "joint_target", "observation": "dict"}
    return fiatlux.VectorEnv("S08", count, seeds=[1000], episodes=1, num_threads=1, **settings)


def sensed(seen):
    names = ("base_angular_velocity", "projected_gravity", "base_linear_velocity", "base_height")
    return np.concatenate([seen[name] for name in (*names, "joint_position", "joint_velocity")], axis=1)


@pytest.mark.parametrize("threads", [1, 2])
def test_controllers_of_many_worlds_do_what_one_does(threads):
    env = worlds(3)
    seen, _ = env.reset(seed=0)
    bodies, singles = fiatlux.WholeBodies(3, threads), [fiatlux.WholeBody() for _ in range(3)]
    commands = np.array([[0.2, 0, 0, 0.75, 0, 0, 0], [0, 0, 0, 0.7, 0, 0, 0], [0, 0.1, 0.3, 0.75, 0, 0.2, 0]])
    palms = bodies.palms(sensed(seen))
    goals = palms + np.array([0.0, 0.0, 0.05, 0, 0, 0, 0])
    goals[1, 0] = np.nan
    for _ in range(4):
        targets = bodies(sensed(seen), commands, goals)
        for world, body in enumerate(singles):
            own = {name: field[world] for name, field in seen.items() if not name.startswith("privileged.")}
            own["last_action"] = np.zeros(53)
            np.testing.assert_allclose(body.palms(own), bodies.palms(sensed(seen))[world], atol=1e-12)
            vx, vy, wz, height, roll, pitch, yaw = commands[world]
            legs = body(own, vx=vx, vy=vy, wz=wz, height=height, roll=roll, pitch=pitch, yaw=yaw)
            left = None if world == 1 else goals[world, 0]
            arms = body.hold_arms(own, body.reach(own, left=left, right=goals[world, 1]))
            np.testing.assert_allclose(targets[world], np.concatenate((legs, arms)), atol=1e-12)
        everything = np.zeros((3, 53))
        everything[:, :29] = targets
        seen = env.step(everything)[0]
    bodies.reset([True, False, False])
    again = bodies(sensed(seen), commands, goals)
    assert np.abs(again[0] - targets[0]).max() > 1e-3


def test_wrong_shapes_are_refused_by_name():
    bodies = fiatlux.WholeBodies(2)
    numbers, commands, goals = np.zeros((2, 116)), np.zeros((2, 7)), np.full((2, 2, 7), np.nan)
    for given, match in [
        ((np.zeros((2, 115)), commands, goals), "sensed: shape"),
        ((np.zeros((1, 116)), commands, goals), "sensed: shape"),
        ((numbers, np.zeros((2, 6)), goals), "commands: shape"),
        ((numbers, commands, np.zeros((2, 7))), "goals: shape"),
        ((numbers * np.nan, commands, goals), "is not finite"),
    ]:
        with pytest.raises(ValueError, match=match):
            bodies(*given)
    with pytest.raises(ValueError, match="num_threads"):
        fiatlux.WholeBodies(2, 0)
    with pytest.raises(ValueError, match="mask: shape"):
        bodies.reset([True])


def test_an_action_takes_the_palm_towards_the_grasp():
    env = worlds(2)
    hand = HandActions(GRASP, 2)
    seen, _ = env.reset(seed=0)
    hand.observe(seen)
    hand.begin(np.ones(2, bool))
    apart = [np.linalg.norm(hand.seen["centre"] - hand.centre, axis=1)]
    # Beside the bulb, so that nothing is touched; the second hand closes.
    action = np.zeros((2, ACTIONS))
    action[:, :3] = [1.5, 1.0, 0.0]
    action[1, 6:8] = 1.0
    for _ in range(60):
        hand.decide(action)
        for _ in range(4):
            seen, _, ended, *_ = env.step(hand.targets())
            assert not ended.any()
            hand.observe(seen)
    apart.append(np.linalg.norm(hand.seen["centre"] - hand.centre, axis=1))
    assert (apart[1] < 0.75 * apart[0]).all(), apart
    fingers = seen["joint_position"][:, -12:]
    assert np.abs(fingers[0]).max() < 0.1 and fingers[1].max() > 0.8
    assert np.isfinite(hand.features()).all()


def exported(path, change=lambda contract: None):
    """A file with a random network, as the export writes it."""
    hand = HandActions(GRASP)
    env = worlds(1)
    hand.observe(env.reset(seed=0)[0])
    contract = {"format": "fiatlux-hand/1", "task": "S08", "grasp": GRASP, "hidden": [8]}
    change(contract)
    return packed(path, contract, [hand.features().shape[1], 8, ACTIONS])


def test_an_exported_policy_plays_and_begins_each_episode_anew(tmp_path):
    policy = fiatlux.hand.HandPolicy(exported(tmp_path / "s08.safetensors"))
    assert repr(policy).startswith("<fiatlux.hand.HandPolicy hand:s08.safetensors@")
    assert repr(HandActions(GRASP, 3)) == "<fiatlux.HandActions: 3 worlds, 10 numbers a decision>"
    first, second = (fiatlux.evaluate(policy, ["S08"], [0], max_steps=12).episodes[0] for _ in range(2))
    assert first["steps"] == 12 and first["state_digest"] == second["state_digest"]
    with pytest.raises(ValueError, match="as a dictionary of fields"):
        policy(np.zeros(3))
    old = exported(tmp_path / "old.safetensors", lambda contract: contract.update(format="fiatlux-hand/0"))
    with pytest.raises(ValueError, match="fiatlux-hand/0"):
        fiatlux.hand.HandPolicy(old)
    with pytest.raises(ValueError, match="fiatlux-hand/1, this version reads fiatlux-baseline"):
        fiatlux.Baseline(tmp_path / "s08.safetensors")
    empty = exported(tmp_path / "empty.safetensors", lambda contract: contract.pop("grasp"))
    with pytest.raises(ValueError, match="grasp"):
        fiatlux.hand.HandPolicy(empty)
    assert isinstance(fiatlux.load_policy(tmp_path / "s08.safetensors"), fiatlux.hand.HandPolicy)
