"""Tests readings of states, batched."""

import signal
import threading
import time

import fiatlux
import numpy as np
import pytest
from fiatlux.kinematics import Support


@pytest.fixture(scope="module")
def room():
    """S02's room, and some states of it."""
    kinematics = fiatlux.Kinematics("S02", seed=64, robot="g1_bare")
    env = fiatlux.Env("S02", robot="g1_bare")
    env.reset(seed=64)
    qpos, qvel = kinematics.state(env.row())
    random = np.random.default_rng(3)
    many = np.tile(qpos, (2, 3, 1))
    many[..., kinematics.joint_qpos] += random.uniform(-0.3, 0.3, (2, 3, len(kinematics.joints)))
    speeds = np.zeros((2, 3, kinematics.nv))
    speeds[..., kinematics.joint_dof] = random.uniform(-1, 1, (2, 3, len(kinematics.joints)))
    speeds[..., kinematics.pelvis_dof] = random.uniform(-1, 1, (2, 3, 6))
    return kinematics, qpos, qvel, many, speeds


def test_a_row_becomes_the_state_that_it_is_of(room):
    kinematics, qpos, qvel, many, _ = room
    env = fiatlux.Env("S02", robot="g1_bare")
    env.reset(seed=64)
    row = env.row()
    poses = kinematics.poses(qpos, ["pelvis", "left_sole", "ladder_tread_0"])
    np.testing.assert_allclose(poses[0], row["robot_pose"], atol=1e-12)
    assert abs(poses[1, 2]) < 0.02 and abs(poses[2, 2] - 0.235) < 0.01
    batch = {name: np.stack([field, field]) for name, field in row.items() if name != "step"}
    np.testing.assert_array_equal(kinematics.state(batch)[0], [qpos, qpos])
    # One state at a time or all at once: the same to the bit.
    at_once = kinematics.poses(many, ["left_palm"])
    np.testing.assert_array_equal(at_once[1, 2], kinematics.poses(many[1, 2], ["left_palm"]))


def test_jacobians_are_the_derivatives_of_poses(room):
    kinematics, _, _, many, speeds = room
    jacobian = kinematics.jacobian(many, "right_palm")
    velocity = np.einsum("...ij,...j->...i", jacobian, speeds)
    np.testing.assert_allclose(kinematics.velocities(many, speeds, ["right_palm"])[..., 0, :], velocity, atol=1e-12)
    step, moved = 1e-6, many.copy()
    moved[..., kinematics.joint_qpos] += step * speeds[..., kinematics.joint_dof]
    at, dof = kinematics.pelvis_qpos.start, kinematics.pelvis_dof.start
    moved[..., at : at + 3] += step * speeds[..., dof : dof + 3]
    still = speeds.copy()
    still[..., dof + 3 : dof + 6] = 0
    change = (kinematics.poses(moved, ["right_palm"]) - kinematics.poses(many, ["right_palm"]))[..., 0, :3] / step
    np.testing.assert_allclose(change, np.einsum("...ij,...j->...i", jacobian[..., :3, :], still), atol=1e-5)
    change = (kinematics.center_of_mass(moved) - kinematics.center_of_mass(many)) / step
    np.testing.assert_allclose(change, np.einsum("...ij,...j->...i", kinematics.com_jacobian(many), still), atol=1e-5)


def test_the_equation_of_motion_is_one(room):
    kinematics, _, _, many, speeds = room
    accelerations = np.random.default_rng(4).uniform(-1, 1, speeds.shape)
    mass = kinematics.mass_matrix(many)
    np.testing.assert_array_equal(mass, np.swapaxes(mass, -1, -2))
    forces = np.einsum("...ij,...j->...i", mass, accelerations) + kinematics.bias_force(many, speeds)
    np.testing.assert_allclose(kinematics.inverse_dynamics(many, speeds, accelerations), forces, atol=1e-9)
    at_rest = kinematics.bias_force(many)
    np.testing.assert_array_equal(at_rest, kinematics.bias_force(many, np.zeros_like(speeds)))
    # It carries the robot's weight.
    up = kinematics.pelvis_dof.start + 2
    np.testing.assert_allclose(at_rest[..., up], 9.81 * mass[..., up, up], rtol=1e-9)


def test_hands_reach_and_keep_their_distance(room):
    kinematics, qpos, _, _, _ = room
    arm = [name for name in kinematics.joints if name.startswith(("left_shoulder", "left_elbow", "left_wrist"))]
    goals = kinematics.poses(qpos, ["left_palm"])[0, :3] + np.array([[0.05, 0.05, 0.05], [0.0, 0.0, 3.0]])
    found = kinematics.inverse(np.stack([qpos, qpos]), {"left_palm": goals}, joints=arm)
    np.testing.assert_array_equal(found.reached, [True, False])
    np.testing.assert_allclose(kinematics.poses(found.qpos[0], ["left_palm"])[0, :3], goals[0], atol=2e-4)
    assert found.position_error[1] > 1.0
    # The forearm keeps off the chest, at a goal where it would touch it.
    pairs = [pair for pair in kinematics.shape_pairs() if set(pair) == {"left_elbow", "torso_chest"}]
    near = kinematics.nearest(qpos, pairs)
    margin = float(near.distance[0]) + 0.01
    goal = kinematics.poses(qpos, ["left_palm"])[0]
    kept = kinematics.inverse(qpos, {"left_palm": goal[:3]}, joints=arm, clearances={pairs[0]: margin})
    assert kept.reached and kinematics.nearest(kept.qpos, pairs).distance[0] > margin - 2e-4


def test_distances_are_between_the_nearest_points(room):
    kinematics, _, _, many, _ = room
    pairs = [pair for pair in kinematics.shape_pairs("ladder") if "knee" in "".join(pair)]
    assert len(pairs) > 40
    nearest = kinematics.nearest(many, pairs)
    assert nearest.distance.shape == (2, 3, len(pairs)) and nearest.points.shape == (2, 3, len(pairs), 2, 3)
    between = nearest.points[..., 1, :] - nearest.points[..., 0, :]
    np.testing.assert_allclose(between, nearest.normal * nearest.distance[..., None], atol=1e-9)


def test_contacts_are_those_of_the_state(room):
    kinematics, qpos, _, _, _ = room
    sunk = qpos.copy()
    sunk[kinematics.pelvis_qpos.start + 2] -= 0.01
    contacts = kinematics.contacts([qpos + 0, sunk], margin=-0.005)
    soles = [at for at, pair in enumerate(contacts.shapes) if "room_floor" in pair and "sole" in "".join(pair)]
    assert soles and (contacts.state[soles] == 1).all()
    np.testing.assert_allclose(np.abs(contacts.normal[soles, 2]), 1.0)
    assert (contacts.distance[soles] < -0.005).all()


def test_soles_bear_the_weight(room):
    kinematics, _, _, _, _ = room
    qpos = fiatlux.Kinematics(robot="g1_bare").reference.copy()
    floor = fiatlux.Kinematics(robot="g1_bare")
    qpos[floor.joint_qpos] = floor.q0
    supports = floor.sole_supports("left_sole") + floor.sole_supports("right_sole")
    states, rest = np.stack([qpos, qpos]), np.zeros((2, floor.nv))
    made = floor.supports(states, rest, supports, com_acceleration=[[0.0, 0.0, 0.0], [12.0, 0.0, 0.0]])
    np.testing.assert_array_equal(made.borne, [True, False])
    mass = floor.mass_matrix(qpos)[0, 0]
    np.testing.assert_allclose(made.forces[0].sum(axis=0), [0.0, 0.0, 9.81 * mass], atol=1e-6)
    assert np.isnan(made.forces[1]).all() and made.targets.shape == (2, len(floor.joints))


def test_wrong_arguments_are_refused_by_name(room):
    kinematics, qpos, qvel, _, _ = room
    with pytest.raises(ValueError, match="left_horn"):
        kinematics.poses(qpos, ["left_horn"])
    with pytest.raises(ValueError, match="qpos: shape"):
        kinematics.poses(qpos[:-1], ["left_palm"])
    with pytest.raises(ValueError, match="qvel: leading axes"):
        kinematics.bias_force(qpos, np.stack([qvel, qvel]))
    with pytest.raises(ValueError, match=r"qpos\[0, 2\] is not finite"):
        kinematics.mass_matrix(np.where(np.arange(kinematics.nq) == 2, np.nan, qpos))
    with pytest.raises(ValueError, match="friction"):
        kinematics.supports(qpos, qvel, [Support("left_sole", friction=0.0)])
    with pytest.raises(ValueError, match="left_palm: shape"):
        kinematics.inverse(qpos, {"left_palm": [0.0, 1.0]})


def test_a_solution_says_how_far_its_joints_are_from_their_ends(room):
    kinematics, qpos, *_ = room
    arm = kinematics.joint_groups["right_arm"]
    names = [kinematics.joints[joint] for joint in arm]
    assert len(arm) == 7 and all(name.startswith("right_") for name in names)
    goal = kinematics.poses(qpos, ["right_palm"])[0] + [0.05, 0, 0.05, 0, 0, 0, 0]
    by_name, by_place = (kinematics.inverse(qpos, {"right_palm": goal}, joints=joints) for joints in (names, arm))
    np.testing.assert_array_equal(by_name.qpos, by_place.qpos)
    np.testing.assert_array_equal(by_place.angles, by_place.qpos[kinematics.joint_qpos[arm]])
    low, high = kinematics.joint_limits[arm].T
    assert by_place.limit_distance == min((by_place.angles - low).min(), (high - by_place.angles).min()) >= 0
    both = kinematics.inverse(np.stack([qpos, qpos]), {"right_palm": goal}, joints=arm)
    assert both.angles.shape == (2, 7) and both.limit_distance.shape == (2,)
    np.testing.assert_array_equal(both.angles[1], by_place.angles)


def test_ctrl_c_ends_a_call_of_many_states():
    kinematics = fiatlux.Kinematics()
    states = np.tile(kinematics.reference, (8_000, 1))
    states[:, kinematics.joint_qpos[3]] = np.linspace(-0.2, 0.2, len(states))
    poses = kinematics.poses(states, ["left_palm"])
    np.testing.assert_array_equal(
        poses[[0, 1023, 1024, -1]], kinematics.poses(states[[0, 1023, 1024, -1]], ["left_palm"])
    )
    began = time.monotonic()
    kinematics.mass_matrix(states)
    whole, began = time.monotonic() - began, time.monotonic()
    timer = threading.Timer(0.05, signal.raise_signal, [signal.SIGINT])
    with pytest.raises(KeyboardInterrupt):
        timer.start()
        kinematics.mass_matrix(states)
    timer.join()
    assert time.monotonic() - began < 0.6 * whole
