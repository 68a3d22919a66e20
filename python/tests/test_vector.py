"""Tests many worlds in one call."""

import _thread
import copy
import pickle
import threading

import fiatlux
import gymnasium
import numpy as np
import pytest
from gymnasium.error import ClosedEnvironmentError
from gymnasium.vector import AutoresetMode
from gymnasium.vector.utils import batch_space

SEED = 7


def walkers(num_envs=6, num_threads=2, **settings):
    settings = {
        "ranges": {"mass": (0.9, 1.1), "floor_friction": (0.5, 1.1)},
        "variations": 4,
        "disturbances": {"pushes": {"interval_s": (0.2, 0.5), "linear": 0.6}, "wrenches": {"interval_s": (0.2, 0.5)}},
        **settings,
    }
    return fiatlux.WalkingVectorEnv(num_envs, num_threads=num_threads, seed=SEED, **settings)


def play(env, steps, start=0):
    said = []
    for step in range(start, start + steps):
        actions = np.random.default_rng(step).uniform(-1, 1, env.action_space.shape)
        *numbers, info = env.step(actions)
        said += [np.array(part) for part in numbers] + [info["reward_terms"]]
    return said


def assert_same(ours, others):
    assert len(ours) == len(others)
    for one, other in zip(ours, others):
        np.testing.assert_array_equal(one, other)


def test_worlds_of_a_task_are_its_episodes():
    """The first episodes of a batch have the rows of single environments, on one thread and on eight."""
    seeds = [1000, 1001, 1002]
    for threads in (1, 8):
        worlds = gymnasium.make_vec(
            "Fiatlux-S05-CarryBulbToDisposal-v1",
            num_envs=3,
            vectorization_mode="vector_entry_point",
            seeds=seeds,
            episodes=1,
            num_threads=threads,
            reward="training",
            observation="flat",
            noise=False,
        )
        singles = [fiatlux.Env("S05", reward="training", observation="flat", noise=False) for _ in seeds]
        observed, _ = worlds.reset()
        for world, (env, seed) in enumerate(zip(singles, seeds)):
            np.testing.assert_array_equal(env.reset(seed=seed)[0], observed[world])
        for step in range(25):
            # Of more digits than a float32 holds.
            actions = np.random.default_rng(step).uniform(-0.2, 0.2, (3, 53))
            observed, rewards, terminated, _, info = worlds.step(actions)
            assert not terminated.any()
            for world, env in enumerate(singles):
                single, reward, *_ = env.step(actions[world])
                np.testing.assert_array_equal(single, observed[world])
                assert rewards[world] == pytest.approx(reward, rel=1e-5, abs=1e-7)
                ours, others = worlds.row(world), env.row()
                assert ours.keys() == others.keys()
                for name in ours:
                    np.testing.assert_array_equal(ours[name], others[name])
        worlds.close()


def test_threads_and_seeds():
    said = []
    for threads in (1, 2, 8):
        env = walkers(num_threads=threads)
        env.reset(seed=SEED)
        said.append(play(env, 60))
    assert_same(said[0], said[1])
    assert_same(said[0], said[2])
    env.reset(seed=SEED)
    assert_same(said[0], play(env, 60))


def test_episodes_begin_in_the_step_that_ends_them():
    env = walkers(horizon_steps=5, observation="dict")
    assert env.metadata["autoreset_mode"] == AutoresetMode.SAME_STEP
    observed, _ = env.reset(seed=SEED)
    assert env.observation_space.contains(observed)
    for step in range(1, 11):
        observed, _, terminated, truncated, info = env.step(np.zeros(env.action_space.shape, np.float32))
        assert truncated.all() == (step % 5 == 0) and not terminated.any()
        assert ("final_obs" in info) == truncated.any()
    assert info["_final_obs"].all()
    final = info["final_obs"]["last_action"]
    assert final.shape == (6, 4, 15) and not np.array_equal(
        info["final_obs"]["joint_position"], observed["joint_position"]
    )


def test_a_saved_state_goes_on_exactly():
    env = walkers()
    env.reset(seed=SEED)
    play(env, 20)
    saved = env.save()
    went_on = play(env, 30, 20)
    other = walkers(num_threads=5)
    for each in (env, other):
        each.restore(saved)
        assert_same(went_on, play(each, 30, 20))


def test_arrays_are_the_callers_own_unless_asked_otherwise():
    actions = np.zeros((6, 15), np.float32)
    env = walkers()
    first, _ = env.reset()
    kept = first.copy()
    env.step(actions)
    np.testing.assert_array_equal(first, kept)
    env = walkers(copy=False)
    first, _ = env.reset()
    assert env.step(actions)[0] is first or np.shares_memory(env.step(actions)[0], first)


@pytest.mark.parametrize("mode", ["same_step", "next_step"])
def test_nothing_that_was_returned_changes(mode):
    """Whoever keeps what steps return has it as it was."""
    env = walkers(horizon_steps=3, observation="dict", autoreset_mode=mode)
    said = [env.reset(seed=1)]
    said += [env.step(np.full(env.action_space.shape, 0.1)) for _ in range(8)]
    said += [env.restore(env.save()), env.row(0)]
    kept = copy.deepcopy(said)
    env.step(np.zeros(env.action_space.shape))
    env.reset(seed=2)
    env.step(np.ones(env.action_space.shape))

    def compare(ours, others):
        if isinstance(ours, dict):
            ours, others = list(ours.values()), list(others.values())
        if isinstance(ours, (list, tuple)):
            for one, other in zip(ours, others):
                compare(one, other)
        else:
            np.testing.assert_array_equal(ours, others)

    compare(said, kept)


def test_worlds_are_spread_over_rooms_and_differ():
    env = fiatlux.VectorEnv("S05", 18, noise=False, episodes=1)
    env.reset(seed=3)
    assert len({tuple(env.row(world)["robot_pose"]) for world in range(18)}) == 16
    env = fiatlux.VectorEnv("S05", 2)
    env.reset()
    assert len({tuple(env.row(world)["robot_pose"]) for world in range(2)}) == 2
    env = walkers(6, ranges=None, disturbances=None)
    observed, _ = env.reset(seed=3)
    assert len({row.tobytes() for row in observed}) == 6


def test_a_picture_is_that_of_the_environment():
    """The light, too, is drawn by seed and episode."""
    settings = {"sensors": ["camera"], "noise": False, "image_size": (32, 32)}
    for seed in (1000, 1001):
        alone = fiatlux.Env("S05", **settings).reset(seed=seed)[0]["camera"]
        batched = fiatlux.VectorEnv("S05", 1, seeds=[seed], episodes=1, **settings).reset()[0]["camera"][0]
        np.testing.assert_array_equal(batched, alone)


def test_pictures_are_bytes():
    env = fiatlux.VectorEnv("S05", 2, sensors=["camera", "last_action"], image_size=(40, 30))
    single = fiatlux.Env("S05", sensors=["camera", "last_action"], image_size=(40, 30))
    assert env.single_observation_space == single.observation_space
    space = env.single_observation_space["camera"]
    assert space == gymnasium.spaces.Box(0, 255, (30, 40, 3), np.uint8)
    assert env.single_observation_space["last_action"].dtype == np.float32
    observed, _ = env.reset()
    assert env.observation_space.contains(observed) and observed["camera"].std() > 10
    assert single.observation_space.contains(single.reset(seed=1)[0])


def test_bounds_of_many_pictures_take_no_memory():
    env = fiatlux.VectorEnv("S05", 3, sensors=["camera", "last_action"], image_size=(40, 30), observation="dict")
    space = env.observation_space
    assert space == batch_space(env.single_observation_space, 3)
    # Each world's bounds are those of the one before, in copies too.
    for one in (env, copy.deepcopy(env), pickle.loads(pickle.dumps(env))):
        parts = one.observation_space.values()
        assert all(part.low.strides[0] == part.bounded_above.strides[0] == 0 for part in parts)
    space.seed(1)
    again = copy.deepcopy(space)
    drawn = space.sample()
    assert space.contains(drawn) and pickle.loads(pickle.dumps(space)) == space
    np.testing.assert_array_equal(again.sample()["camera"], drawn["camera"])
    flat = walkers().observation_space
    assert flat == batch_space(walkers().single_observation_space, 6) and flat.contains(flat.sample())


def test_bad_use_is_refused_by_name():
    env = walkers()
    env.reset()
    actions = np.zeros((6, 15), np.float32)
    with pytest.raises(ValueError, match=r"action: shape \(5, 15\) instead of \(6, 15\)"):
        env.step(actions[:5])
    actions[2, 3] = np.nan
    with pytest.raises(ValueError, match="actions: world 2, 'left_knee_joint' is NaN"):
        env.step(actions)
    assert env.row(2)["step"] == 0
    with pytest.raises(ValueError, match="world is 6; give 0 to 5"):
        env.row(6)
    with pytest.raises(ValueError, match="one number for all worlds"):
        env.reset(seed=[1, 2, 3, 4, 5, 6])
    env.close()
    env.close()
    with pytest.raises(ClosedEnvironmentError):
        env.step(actions)
    for settings, match in [
        ({"num_envs": 0}, "num_envs is 0"),
        ({"num_threads": 0}, "num_threads is 0"),
        ({"frames": 0}, "frames is 0"),
        ({"ranges": {"weight": 1}}, "ranges has no 'weight'"),
        ({"ranges": {"mass": (0.0, 0.0)}}, "ranges: mass must be .* above 0"),
        ({"disturbances": {"wrenches": {"link": "tail"}}}, "the robot has no 'tail'"),
        ({"disturbances": {"pushes": {"interval_s": (2, 1)}}}, "pushes.interval_s"),
    ]:
        with pytest.raises(ValueError, match=match):
            walkers(**settings)
    with pytest.raises(ValueError, match="one world for each room"):
        fiatlux.VectorEnv("S07", seeds=[1000, 1001])


def test_ctrl_c_lets_a_long_step_end():
    env = walkers(4096, 1)
    env.reset()
    actions = np.zeros((4096, 15), np.float32)
    with pytest.raises(KeyboardInterrupt):
        threading.Timer(0.02, _thread.interrupt_main).start()
        for _ in range(100):
            env.step(actions)
    assert len({int(env.row(world)["step"]) for world in range(0, 4096, 64)}) == 1
    env.step(actions)


def test_ctrl_c_works_while_worlds_step():
    env = walkers(1, 1)
    env.reset()
    actions = np.zeros((1, 15), np.float32)
    with pytest.raises(KeyboardInterrupt):
        threading.Timer(0.3, _thread.interrupt_main).start()
        for _ in range(100_000):
            env.step(actions)
    env.step(actions)


class Interrupted:
    """The native part of a vector, with Ctrl-C as each call returns."""

    def __init__(self, batch):
        self.batch = batch

    def __getattr__(self, name):
        def call(*arguments):
            getattr(self.batch, name)(*arguments)
            raise KeyboardInterrupt

        return getattr(self.batch, name) if name == "ended" else call


def test_ctrl_c_leaves_no_call_half_done():
    judged = []

    def judge(observation, info):
        judged.append(observation)
        return None, np.arange(2) == 0

    env = fiatlux.VectorEnv("S05", 2, seeds=[1000], observation="flat", judge=judge)
    own, none = env._batch, np.zeros(env.action_space.shape)

    def interrupted(call):
        env._batch = Interrupted(own)
        try:
            with pytest.raises(KeyboardInterrupt):
                call()
        finally:
            env._batch = own

    interrupted(lambda: env.reset(seed=1))
    jumps = env._jumps.copy()
    # The judge ends the first world's episode, which begins anew.
    interrupted(lambda: env.step(none))
    assert len(judged) == 1 and [int(env.row(world)["step"]) for world in (0, 1)] == [0, 1]
    interrupted(lambda: env.copy_world(1, np.array([True, False])))
    assert (env._jumps - jumps).tolist() == [1, 0] and env.row(0)["step"] == 1
    saved = env.save()
    interrupted(lambda: env.restore(saved))
    assert (env._jumps - jumps).tolist() == [2, 1]
    env.step(none)


def test_weights_of_the_reward_can_be_given():
    usual = walkers()
    ours = walkers(reward_weights={"alive": 2 * usual.reward_weights["alive"]})
    assert list(usual.reward_weights) and set(ours.reward_weights) == set(ours.reward_terms)
    place = ours.reward_terms.index("alive")
    usual.reset(), ours.reset()
    paid = [
        env.step(np.zeros(env.action_space.shape, np.float32))[4]["reward_terms"][:, place] for env in (usual, ours)
    ]
    np.testing.assert_allclose(2 * paid[0], paid[1])
    with pytest.raises(ValueError, match="velocitty"):
        walkers(reward_weights={"velocitty": 1.0})


@pytest.mark.parametrize("protocol", ["published", "strict"])
@pytest.mark.parametrize("task", ["S05", "S07"])
def test_the_verdict_on_an_episode_is_that_of_the_environment(task, protocol):
    settings = {"protocol": protocol, "noise": False, "observation": "flat"}
    env, worlds = fiatlux.Env(task, **settings), fiatlux.VectorEnv(task, 2, seeds=[1000], episodes=1, **settings)
    env.reset(seed=1000)
    worlds.reset(seed=0)
    action, ended = np.full(env.action_space.shape, 0.05), False
    while not ended:
        _, _, terminated, truncated, info = env.step(action)
        ended = terminated or truncated
        *_, found = worlds.step(np.broadcast_to(action, worlds.action_space.shape))
        assert ("steps" in found) == ("steps" in info) == ended
    # What names the episode, and its rows, is the environment's alone.
    of_episode = {"task", "seed", "episode", "steps_in_gate", "state_digest"}
    marks = {name for name in found if name.startswith("_")}
    assert set(info) - of_episode == set(found) - marks - {"final_obs"}
    assert {"success", "steps", "end", f"{'strict' if protocol == 'strict' else 'published'}_end"} <= set(found)
    assert info["end"] == "fall" and 10 < info["steps"] < 500
    for name in set(info) - of_episode - {"reward_terms"}:
        assert list(found[name]) == [info[name]] * 2, name
    assert all(found[mark].all() for mark in marks)


def test_a_horizon_of_the_caller_s_ends_by_time_out():
    worlds = fiatlux.VectorEnv("S07", 3, seeds=[1000], horizon_steps=5, observation="flat")
    worlds.reset(seed=0)
    worlds.stagger([0, 2, 0])
    for _ in range(3):
        *_, info = worlds.step(np.zeros(worlds.action_space.shape))
    assert info["_end"].tolist() == [False, True, False] and info["end"].tolist() == [None, "time-out", None]
    assert info["steps"].tolist() == [0, 3, 0] and info["causes"][1] == ["time-out"]
