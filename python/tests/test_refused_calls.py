"""A call of a vector that is refused changes nothing: a hundred made-up ones for each kind of vector, each followed by steps that are
those of a vector which never made it."""

import fiatlux
import numpy as np
import pytest

WORLDS = 3
QUATERNION = [0.0, 0.0, 0.8, 1.0001, 0.0, 0.0, 0.0]


def made():
    sensors = ["proprioception", "hand_contact", "last_action", "camera@look"]
    settings = {"observation": "flat", "copy": False, "sensors": sensors, "image_size": (8, 6)}
    env = fiatlux.VectorEnv("S07", WORLDS, seeds=[1000], noise=True, seed=3, **settings)
    env.reset(seed=5)
    return env


def walking():
    env = fiatlux.WalkingVectorEnv(WORLDS, seed=3, copy=False)
    env.reset(seed=5)
    return env


def climbing():
    env = fiatlux.ClimbingVectorEnv(WORLDS, seed=3, copy=False)
    env.reset(seed=5)
    return env


def only(world):
    return np.arange(WORLDS) == world


def broken(row, name, value):
    part = np.array(row[name], np.float64)
    part[np.random.default_rng(len(name)).integers(len(part))] = value
    return {name: part}


def rows(env):
    """Calls with parts of rows that no world can take over."""
    everywhere, row = np.ones(WORLDS, bool), env.row(0)
    for mask in (only(0), only(2), everywhere, np.array([True, False, True])):
        for parts in (
            {"robot_pose": QUATERNION},
            {"robot_pose": [np.nan, 0, 0.8, 1, 0, 0, 0]},
            {"robot_pose": [0, 0, -3.0, 1, 0, 0, 0]},
            {"robot_pose": [1e6, 0, 0.8, 1, 0, 0, 0]},
            {"robot_pose": [0, 0, 0.8, 0, 0, 0, 0]},
            {"joint_position": np.full(53, 10.0)},
            {"joint_velocity": np.full(53, 1e4)},
            {"robot_linear_velocity": [0, 0, np.inf]},
            {"robot_angular_velocity": [1e5, 0, 0]},
            {"fresh_bulb_pose": [0, 0, -0.5, 1, 0, 0, 0]},
            broken(row, "joint_target", np.nan),
            broken(row, "joint_effort", np.inf),
            broken(row, "action", 1e300),
            broken(row, "joint_position", -np.inf),
            broken(row, "joint_target", 1e200),
            broken(row, "joint_target", -9.0),
            broken(row, "joint_effort", 1e200),
            broken(row, "joint_effort", -900.0),
            {"robot_pose": [1e200, 0, 0.8, 1, 0, 0, 0]},
            {"robot_linear_velocity": [0, 0, 1e200]},
            {"fresh_bulb_seated": [np.nan]},
            {"fresh_bulb_seated": [7.0]},
        ):
            yield lambda mask=mask, parts=parts: env.reset_worlds(mask, like=parts)
    # One bad world among good ones.
    poses = np.tile(row["robot_pose"], (WORLDS, 1))
    for world in range(WORLDS):
        for value in (np.nan, 5.0):
            bad = poses.copy()
            bad[world, 3] = value
            yield lambda bad=bad: env.reset_worlds(everywhere, like={"robot_pose": bad})
    yield lambda: env.reset_worlds(everywhere, like={"robot_poze": row["robot_pose"]})
    yield lambda: env.reset_worlds(everywhere, like={"robot_pose": "text"})


def calls(env):
    """Calls that every vector has, each with something wrong."""
    everywhere = np.ones(WORLDS, bool)
    zeros = np.zeros(env.action_space.shape)
    snapshot = env.save()
    other = fiatlux.VectorEnv("S08", 1, seeds=[1000], observation="flat")
    for action in (
        np.full_like(zeros, np.nan),
        np.full_like(zeros, np.inf),
        np.full_like(zeros, 1e300),
        zeros[:, :-1],
        zeros[:-1],
        "text",
        None,
    ):
        yield lambda action=action: env.step(action)
    late = np.zeros((4, *zeros.shape))
    late[3, 1, 2] = np.nan
    wide = np.zeros((4, WORLDS + 1, zeros.shape[1]))
    for actions in (late, np.zeros((0, *zeros.shape)), np.zeros((4, 7)), wide, "text"):
        yield lambda actions=actions: env.rollout(actions)
    for mask in ([True], np.zeros(WORLDS, bool), np.ones(WORLDS), np.ones((WORLDS, 1), bool), "text"):
        yield lambda mask=mask: env.reset_worlds(mask)
        yield lambda mask=mask: env.reset(options={"reset_mask": mask})
        yield lambda mask=mask: env.terminate(mask)
        yield lambda mask=mask: env.copy_world(0, mask)
        yield lambda mask=mask: env.restore(env.save(0), mask)
        yield lambda mask=mask: env.look(["camera"], mask)
    for number in (-1, WORLDS, 1.5, True, "1", 2**70):
        yield lambda number=number: env.copy_world(number, everywhere)
        yield lambda number=number: env.reset_worlds(everywhere, like=number)
        yield lambda number=number: env.row(number)
        yield lambda number=number: env.save(number)
        yield lambda number=number: env.render_world(number)
    for seed in (-1, 2**64, 1.5, True, "1", [1, 2, 3]):
        yield lambda seed=seed: env.reset(seed=seed)
    for steps in ([1], [1, 2, -3], "abc", [1.5] * WORLDS):
        yield lambda steps=steps: env.stagger(steps)
    for sensors in ("camera", ["nix"], ["lidar"], ["camera", "lidar"], [1], [None]):
        yield lambda sensors=sensors: env.look(sensors)
        yield lambda sensors=sensors: env.look(sensors, only(1))
    yield lambda: env.restore(other.save())
    yield lambda: env.restore(other.save(0), everywhere)
    yield lambda: env.restore(snapshot, everywhere)
    yield lambda: env.restore(env.save(0))
    yield lambda: env.restore(None)
    yield lambda: env.reset(options={"mask": everywhere})
    yield lambda: env.contacts()


@pytest.mark.parametrize("make, kinds", [(made, [calls, rows]), (walking, [calls]), (climbing, [calls])])
def test_a_refused_call_leaves_the_vector_as_it_was(make, kinds):
    env, twin = make(), make()
    actions = np.random.default_rng(0).uniform(-0.3, 0.3, (10, *env.action_space.shape))
    count = 0
    for call in (call for kind in kinds for call in kind(env)):
        before = env._observation.copy()
        with pytest.raises(Exception) as refused:
            call()
        assert isinstance(refused.value, (ValueError, TypeError, OverflowError, fiatlux.FiatluxError)), refused.value
        np.testing.assert_array_equal(env._observation, before)
        for action in actions:
            for found, expected in zip(env.step(action)[:4], twin.step(action)[:4]):
                np.testing.assert_array_equal(found, expected)
        for world in range(WORLDS):
            for name, part in env.row(world).items():
                np.testing.assert_array_equal(part, twin.row(world)[name], err_msg=name)
        assert all(np.array_equal(a, b, equal_nan=True) for a, b in zip(env.drawn().values(), twin.drawn().values()))
        count += 1
    assert count >= 100, count


def test_the_refusal_says_which_world_and_what():
    env = made()
    for parts, says in (
        ({"robot_pose": QUATERNION}, r"like: world 2 .*robot_pose has a quaternion of length 1.0001; divide"),
        ({"robot_pose": [0, 0, -3.0, 1, 0, 0, 0]}, r"like: world 2 .* m below the floor"),
        (
            {"joint_position": np.full(53, 10.0)},
            r"like: world 2 .*joint_position of 'left_hip_pitch_joint' is 10, rad; the joint goes",
        ),
        (
            {"joint_velocity": np.full(53, 1e4)},
            r"like: world 2 .*joint_velocity of 'left_hip_pitch_joint' is 10000, rad/s",
        ),
        ({"robot_pose": [1e6, 0, 0.8, 1, 0, 0, 0]}, r"like: world 2 .*robot_pose is 1000000.* m from the middle"),
        (
            {"joint_target": np.full(53, 1e200)},
            r"like: world 2 .*joint_target of 'left_hip_pitch_joint' is 1e200, rad; the joint goes",
        ),
        (
            {"joint_effort": np.full(53, 1e200)},
            r"like: world 2 .*joint_effort of 'left_hip_pitch_joint' is 1e200, N m; give -139 to 139",
        ),
        ({"fresh_bulb_seated": [7.0]}, "like: fresh_bulb_seated is 7.0; give 1 for seated, 0 for free"),
    ):
        with pytest.raises(ValueError, match=says):
            env.reset_worlds(only(2), like=parts)


def test_starts_that_no_episode_reaches_are_refused():
    with pytest.raises(ValueError, match="starts: no world starts there: 'pelvis' is .* below the floor"):
        fiatlux.VectorEnv("S07", 1, seeds=[1000], starts=[fiatlux.Start(rows=[{"robot_pose": [0, 0, -3, 1, 0, 0, 0]}])])
