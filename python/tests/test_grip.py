"""Tests the hand that closes finger by finger."""

import fiatlux
import numpy as np
import pytest

HAND = fiatlux.Kinematics()


def seen(joints, forces=None):
    felt = np.zeros((len(HAND.hand_bodies["right"]), 3))
    for name, force in (forces or {}).items():
        felt[HAND.hand_bodies["right"].index(name)] = [0, 0, force]
    return {"joint_position": joints - HAND.q0, "right_hand_contact": felt}


def test_it_closes_to_the_grip():
    grip, q = fiatlux.Grip(HAND), HAND.q0.copy()
    assert [HAND.joints[joint] for joint in grip.joints] == list(HAND.grip)
    for share in (-0.25, 0.0, 0.5, 1.0):
        np.testing.assert_allclose(grip(seen(q), share), share * np.array(list(HAND.grip.values())))


def test_a_finger_that_feels_something_presses_gently_and_the_others_close():
    grip, q = fiatlux.Grip(HAND, touch=1.0, press=0.3), HAND.q0.copy()
    body = next(name for name in HAND.hand_bodies["right"] if "index" in name)
    closed = np.array(list(HAND.grip.values()))
    np.testing.assert_array_equal(grip(seen(q, {body: 0.9}), 1.0), closed)
    targets = grip(seen(q, {body: 1.1}), 1.0)
    is_index = np.array(["index" in name for name in HAND.grip])
    assert is_index.any() and not is_index.all()
    np.testing.assert_array_equal(targets[~is_index], closed[~is_index])
    bound = q[grip.joints] + 0.3 / HAND.stiffness[grip.joints]
    np.testing.assert_allclose(targets[is_index], np.minimum(closed, bound)[is_index])
    # It remembers, until it is told to forget.
    np.testing.assert_array_equal(grip(seen(q), 1.0), targets)
    grip.reset()
    np.testing.assert_array_equal(grip(seen(q), 1.0), closed)


def test_the_thumb_goes_first():
    grip, q = fiatlux.Grip(HAND, thumb_first=0.06), HAND.q0.copy()
    is_thumb = np.array(["thumb" in name for name in HAND.grip])
    closed = np.array(list(HAND.grip.values()))
    shares = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5]
    moved = np.array([grip(seen(q), share) for share in shares])
    np.testing.assert_allclose(moved[5], closed * np.where(is_thumb, 0.5, 0.2))
    np.testing.assert_allclose(moved[1], closed * np.where(is_thumb, 0.1, 0.0))


def test_a_robot_without_fingers_is_refused():
    with pytest.raises(ValueError, match="has no fingers"):
        fiatlux.Grip(fiatlux.Kinematics(robot="g1_bare"))
