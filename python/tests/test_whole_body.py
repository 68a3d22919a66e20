"""Tests a Python policy that uses the whole-body controller."""

import fiatlux
import numpy as np
import pytest


def play(steps, **command):
    """Walks in S05's room from its start; returns the poses of the pelvis."""
    env = fiatlux.Env("S05", action_form="joint_target", observation="dict")
    observation, _ = env.reset(seed=64)
    body = fiatlux.WholeBody()
    poses = [env.row()["robot_pose"]]
    arms = body.targets(observation)[15:]
    for _ in range(steps):
        targets = body.targets(observation)
        np.testing.assert_allclose(targets[15:], arms, atol=1e-5)
        targets[:15] = body(observation, **command)
        observation, _, terminated, truncated, _ = env.step(targets)
        assert not terminated and not truncated
        poses.append(env.row()["robot_pose"])
    return np.array(poses)


def test_it_stands_and_walks_backwards_on_command():
    stood, walked = play(100), play(100, vx=-0.4)
    way = np.linalg.norm(stood[-1, :2] - stood[0, :2]), np.linalg.norm(walked[-1, :2] - walked[0, :2])
    assert way[0] < 0.15
    assert way[1] > 0.3
    assert stood[-1, 2] > 0.65 and walked[-1, 2] > 0.65


def test_wrong_commands_and_observations_are_refused_by_name():
    env = fiatlux.Env("S05", observation="dict")
    observation, _ = env.reset(seed=64)
    body = fiatlux.WholeBody()
    with pytest.raises(ValueError, match="vx"):
        body(observation, vx=3.0)
    with pytest.raises(ValueError, match="joint_velocity"):
        body({name: field for name, field in observation.items() if name != "joint_velocity"})
    broken = dict(observation, base_height=np.array([np.nan], np.float32))
    with pytest.raises(ValueError, match="base_height"):
        body(broken)
    assert body.joint_names[0].endswith("hip_pitch_joint") and len(body.q0) == 29


def test_arms_are_held_where_they_are_wanted():
    def sag(holds):
        """Angles of the arms less those wanted, of the shoulders and elbows, rad, for two poses after two seconds each."""
        env = fiatlux.Env("S07", action_form="joint_target", observation="dict")
        observation, _ = env.reset(seed=64)
        body = fiatlux.WholeBody()
        found = []
        for raised in (0.0, 0.6):
            angles = body.q0[15:].copy()
            angles[[0, 7]] -= raised
            for _ in range(100):
                targets = body.targets(observation)
                targets[:15] = body(observation)
                targets[15:29] = body.hold_arms(observation, angles) if holds else angles
                observation, _, terminated, truncated, _ = env.step(targets)
                assert not terminated and not truncated
            missing = body.q0[15:] + observation["joint_position"][15:29] - angles
            found.append(np.abs(missing[[0, 1, 2, 3, 7, 8, 9, 10]]))
        return np.array(found)

    loose, held = sag(False), sag(True)
    assert held.mean() < 0.35 * loose.mean() and held.max() < 0.5 * loose.max(), (loose, held)


def test_wrong_angles_of_arms_are_refused_by_name():
    observation, _ = fiatlux.Env("S07", observation="dict").reset(seed=64)
    body = fiatlux.WholeBody()
    with pytest.raises(ValueError, match=r"angles: shape \(13,\) instead of \(14,\)"):
        body.hold_arms(observation, np.zeros(13))
    with pytest.raises(ValueError, match="left_elbow_joint is not finite"):
        body.hold_arms(observation, np.where(np.arange(14) == 3, np.nan, 0.0))
    with pytest.raises(ValueError, match="projected_gravity"):
        body.hold_arms({"joint_position": observation["joint_position"]}, np.zeros(14))


class Walks:
    """Walks by joint targets, without saying so."""

    def reset(self, info):
        self.body = fiatlux.WholeBody()

    def __call__(self, observation):
        targets = self.body.targets(observation)
        targets[:15] = self.body(observation, vx=0.3)
        return targets


class WalksByTargets(Walks):
    action_form = "joint_target"


def test_targets_played_as_actions_are_refused_and_a_policy_can_say_what_it_gives():
    with pytest.raises(ValueError, match="action_form='joint_target'"):
        fiatlux.evaluate(Walks, ["S07"], [1000], max_steps=50)
    said = fiatlux.evaluate(WalksByTargets, ["S07"], [1000], max_steps=50)
    given = fiatlux.evaluate(Walks, ["S07"], [1000], max_steps=50, action_form="joint_target")
    assert said.episodes[0]["state_digest"] == given.episodes[0]["state_digest"]
    with pytest.raises(ValueError, match="the policy's own is 'joint_target'"):
        fiatlux.evaluate(WalksByTargets, ["S07"], [1000], max_steps=50, action_form="action")


class Reaches:
    """Moves its arms by joint targets, without saying so, and leaves the legs to another controller."""

    def reset(self, info):
        self.body = fiatlux.WholeBody()

    def __call__(self, observation):
        targets = np.zeros(53)
        targets[15:29] = self.body.hold_arms(observation, self.body.q0[15:])
        return targets


class Keeps(Reaches):
    """Keeps the targets of the start."""

    def __call__(self, observation):
        return self.body.targets(observation)


@pytest.mark.parametrize("policy", [Reaches, Keeps])
def test_targets_of_any_part_that_are_played_as_actions_are_refused(policy):
    with pytest.raises(ValueError, match="WholeBody: .*action_form='joint_target'"):
        fiatlux.evaluate(policy, ["S07"], [1000], max_steps=50)
    fiatlux.evaluate(policy, ["S07"], [1000], max_steps=50, action_form="joint_target")


def test_without_the_last_action_there_is_a_warning():
    class Blind(Reaches):
        def __call__(self, observation):
            return np.concatenate((self.body(observation), np.zeros(38)))

    with pytest.warns(UserWarning, match="add the sensor 'last_action'"):
        fiatlux.evaluate(Blind, ["S07"], [1000], max_steps=5, sensors=["proprioception"])
    with pytest.raises(ValueError, match="'last_action' is missing"):
        fiatlux.evaluate(Keeps, ["S07"], [1000], max_steps=5, sensors=["proprioception"])


def test_hands_reach_while_it_stands():
    env = fiatlux.Env("S07", action_form="joint_target", observation="dict")
    observation, _ = env.reset(seed=64)
    body = fiatlux.WholeBody()
    goal = body.palms(observation)[0] + [0.06, 0.04, 0.08, 0, 0, 0, 0]
    for _ in range(150):
        targets = body.targets(observation)
        targets[:15] = body(observation)
        targets[15:29] = body.hold_arms(observation, body.reach(observation, left=goal))
        observation, _, terminated, truncated, _ = env.step(targets)
        assert not terminated and not truncated
    found = body.palms(observation)[0]
    assert np.linalg.norm(found[:3] - goal[:3]) < 0.02
    assert abs(found[3:] @ goal[3:]) > 0.995
    with pytest.raises(ValueError, match="left: shape"):
        body.reach(observation, left=goal[:3])
    with pytest.raises(ValueError, match="right hand"):
        body.reach(observation, right=np.full(7, np.nan))


def test_joint_targets_are_what_the_parts_return():
    env = fiatlux.Env("S08", action_form="joint_target", observation="dict")
    seen, _ = env.reset(seed=1000)
    whole, parts = fiatlux.WholeBody(), fiatlux.WholeBody()
    arms = parts.q0[15:29]
    for step in range(20):
        expected = parts.targets(seen)
        expected[:15] = parts(seen, vx=0.2, height=0.74)
        if step >= 10:
            expected[15:29] = parts.hold_arms(seen, arms)
        made = whole.joint_targets(seen, arms=arms if step >= 10 else None, vx=0.2, height=0.74)
        np.testing.assert_array_equal(made, expected)
        seen, *_ = env.step(made)
    with pytest.raises(TypeError, match="speed"):
        whole.joint_targets(seen, speed=1.0)
