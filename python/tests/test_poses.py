"""Tests the arithmetic of poses against matrices."""

import fiatlux
import numpy as np
import pytest
from fiatlux import poses


def matrix(pose):
    """Homogeneous matrix of a pose: by the textbook's formula for a quaternion's rotation matrix."""
    x, y, z, w, i, j, k = pose
    return np.array(
        [
            [1 - 2 * (j * j + k * k), 2 * (i * j - k * w), 2 * (i * k + j * w), x],
            [2 * (i * j + k * w), 1 - 2 * (i * i + k * k), 2 * (j * k - i * w), y],
            [2 * (i * k - j * w), 2 * (j * k + i * w), 1 - 2 * (i * i + j * j), z],
            [0, 0, 0, 1],
        ]
    )


@pytest.fixture(scope="module")
def two():
    random = np.random.default_rng(0)
    drawn = random.normal(size=(2, 5, 7))
    drawn[..., 3:] /= np.linalg.norm(drawn[..., 3:], axis=-1, keepdims=True)
    return drawn


def test_poses_multiply_as_matrices_do(two):
    a, b = two
    both, back, moved = poses.compose(a, b), poses.inverse(a), poses.transform(a, b[:, :3])
    for k in range(len(a)):
        np.testing.assert_allclose(matrix(both[k]), matrix(a[k]) @ matrix(b[k]), atol=1e-12)
        np.testing.assert_allclose(matrix(back[k]), np.linalg.inv(matrix(a[k])), atol=1e-12)
        np.testing.assert_allclose(moved[k], (matrix(a[k]) @ [*b[k, :3], 1])[:3], atol=1e-12)
    # One pose with many.
    np.testing.assert_array_equal(poses.compose(a[0], b)[0], both[0])


def test_vectors_of_turns_come_back(two):
    vectors = two[0, :, :3] * [[0], [1e-12], [1], [1], [1]]
    np.testing.assert_allclose(poses.to_vector(poses.of_vector(vectors)), vectors, atol=1e-9)
    np.testing.assert_allclose(poses.to_vector(-poses.of_vector(vectors)), vectors, atol=1e-9)
    assert poses.heading(poses.of_vector([0, 0, 2.0])) == pytest.approx(2.0)
    # A lean ahead does not turn where it looks.
    leans = poses.multiply(poses.of_vector([0, 0, 2.0]), poses.of_vector([0, 0.5, 0]))
    assert poses.heading(leans) == pytest.approx(2.0)


def test_poses_of_an_observation():
    env = fiatlux.Env("S08", sensors=["proprioception", "privileged"])
    seen, _ = env.reset(seed=1000)
    for thing, field in (("robot", "robot_pose"), ("fresh_bulb", "fresh_bulb_pose")):
        np.testing.assert_allclose(poses.of(seen, thing), env.row()[field], atol=1e-6)
    vector = fiatlux.VectorEnv("S08", 2, seeds=[1000], sensors=["privileged"])
    assert poses.of(vector.reset(seed=0)[0], "crate").shape == (2, 7)
    with pytest.raises(ValueError, match="privileged.bulb_position' is missing; known are .*'fresh_bulb'"):
        poses.of(seen, "bulb")
    with pytest.raises(ValueError, match="add the sensor 'privileged'"):
        poses.of({"base_height": 1.0}, "robot")


@pytest.mark.parametrize(
    "wrong, message",
    [([0] * 3, "instead of .*, 7"), ([1, 0, 0, 0, 1, 2, 3], "length is not 1"), ([np.nan] * 7, "length is not 1")],
)
def test_what_is_not_a_pose_is_refused(wrong, message):
    for call in (lambda: poses.inverse(wrong), lambda: poses.compose(wrong, [0, 0, 0, 1, 0, 0, 0])):
        with pytest.raises(ValueError, match=message):
            call()


def test_drives_and_bodies_are_named_in_the_order_of_actions_and_sensors():
    hand = fiatlux.Kinematics()
    count = len(hand.joints)
    assert hand.joint_limits.shape == (count, 2) and (hand.joint_limits[:, 0] < hand.joint_limits[:, 1]).all()
    assert hand.stiffness.shape == hand.damping.shape == hand.effort_limit.shape == (count,)
    env = fiatlux.Env("S05", action_form="joint_target")
    seen, _ = env.reset(seed=1000)
    assert seen["right_hand_contact"].shape[0] == len(hand.hand_bodies["right"]) == len(hand.hand_bodies["left"])
    # The bulb of S05 is in the right hand: its thumb feels it, and the left hand's does not.
    felt = {
        side: {
            name
            for name, force in zip(hand.hand_bodies[side], seen[f"{side}_hand_contact"])
            if np.linalg.norm(force) > 0.5
        }
        for side in ("right", "left")
    }
    assert any("thumb" in name for name in felt["right"]) and not felt["left"]
    assert all(name.startswith(("R_", "right_")) for name in hand.hand_bodies["right"])
    # A drive presses with its stiffness times what is left, as inverse dynamics of a joint at rest shows.
    elbow = hand.joints.index("left_elbow_joint")
    target, effort = env.row()["joint_target"][elbow], env.row()["joint_effort"][elbow]
    left = hand.stiffness[elbow] * (target - env.row()["joint_position"][elbow])
    damped = hand.damping[elbow] * env.row()["joint_velocity"][elbow]
    assert effort == pytest.approx(left - damped, abs=0.2)


def test_upright_poses_keep_place_and_heading():
    tilted = poses.multiply(poses.of_vector([0, 0, 2.0]), poses.of_vector([0.0, 0.4, 0.0]))
    pose = np.stack([[1.0, 2.0, 0.7, *tilted], [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]])
    made = poses.upright(pose)
    np.testing.assert_array_equal(made[:, :3], pose[:, :3])
    np.testing.assert_allclose(made[0, 3:], poses.of_vector([0, 0, poses.heading(tilted)]), atol=1e-15)
    # A point 1 m ahead of the robot, half a metre to its left and level with it.
    point = pose[0, :3] + [np.cos(2.0) - 0.5 * np.sin(2.0), np.sin(2.0) + 0.5 * np.cos(2.0), 0.0]
    seen = poses.transform(poses.inverse(made[0]), point)
    np.testing.assert_allclose(seen, [1.0, 0.5, 0.0], atol=1e-12)
