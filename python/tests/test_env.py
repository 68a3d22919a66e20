"""Tests single environments, one episode at a time."""

import warnings

import fiatlux
import gymnasium
import numpy as np
import pytest
from gymnasium.error import ClosedEnvironmentError, ResetNeeded
from gymnasium.utils.env_checker import check_env

CARRY = "Fiatlux-S05-CarryBulbToDisposal-v1"


def test_all_tasks_are_registered():
    assert len(fiatlux.TASKS) == 14
    for task in fiatlux.TASKS.values():
        assert gymnasium.spec(task.id).kwargs == {"task": task.short_id}


@pytest.mark.parametrize("observation", ["dict", "flat"])
def test_check_env_has_nothing_to_say(observation):
    env = gymnasium.make(CARRY, observation=observation, render_mode="rgb_array", render_size=(64, 48))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env.unwrapped)
    env.close()


@pytest.mark.parametrize("name", ["S05", "s5", "S005", "fiatlux-s05-carrybulbtodisposal-v1"])
def test_a_task_may_be_named_as_in_the_programs(name):
    env = fiatlux.Env(name)
    env.reset(seed=0)
    assert env.task.short_id == "S05" and "Env S05" in repr(env)
    other = fiatlux.Env("S05")
    other.restore(env.save())
    assert other.digest == env.digest
    assert "VectorEnv S05" in repr(fiatlux.VectorEnv(name, 1))


def test_observations_are_the_same_numbers_in_both_forms():
    seen = {}
    for form in ("dict", "flat"):
        env = fiatlux.Env("S05", observation=form, privileged=True)
        seen[form], info = env.reset(seed=3)
        assert (info["seed"], info["episode"]) == (3, 0)
        assert env.observation_space.contains(seen[form])
    joined = np.concatenate([numbers.ravel() for numbers in seen["dict"].values()])
    np.testing.assert_array_equal(joined, seen["flat"])
    assert seen["dict"]["joint_position"].shape == (53,)
    assert seen["dict"]["privileged.crate_position"].shape == (3,)


def test_the_published_vector_is_the_sensor_flat():
    env = gymnasium.make(CARRY, observation="published").unwrapped
    vector, _ = env.reset(seed=2)
    assert vector.shape == (6543,) and env.observation_space.contains(vector)
    fields, _ = fiatlux.Env("S05", sensors=["flat"]).reset(seed=2)
    np.testing.assert_array_equal(vector, np.concatenate([part.ravel() for part in fields.values()]))
    assert fiatlux.Env("climb", observation="published").observation_space.shape == (6453,)
    for task, numbers in [("S05", 6483), ("climb", 6423)]:
        assert fiatlux.Env(task, observation="published", robot="g1_dex3").observation_space.shape == (numbers,)


def test_both_action_forms_lead_to_the_same_rows():
    action = fiatlux.Env("S07")
    target = fiatlux.Env("S07", action_form="joint_target")
    for env in (action, target):
        env.reset(seed=1)
    q0 = action.row()["joint_target"]
    for _ in range(5):
        action.step(np.full(53, 0.1))
        target.step(q0 + 0.5 * 0.1)
    np.testing.assert_allclose(action.row()["joint_position"], target.row()["joint_position"], atol=1e-9)


def test_the_same_seed_and_actions_give_the_same_digest():
    digests = []
    for _ in range(2):
        env = fiatlux.Env("S05", reward="training")
        env.reset(seed=4)
        rng = np.random.default_rng(0)
        for _ in range(10):
            *_, info = env.step(rng.uniform(-0.2, 0.2, 53))
        digests.append(env.digest)
    assert digests[0] == digests[1]
    assert "gate_progress" in info["reward_terms"] and len(info["reward_terms"]) > 5
    env.reset()
    assert env.digest not in digests and env.summary()["episode"] == 1


def test_an_episode_ends_as_the_rulebook_says():
    env = fiatlux.Env("S05")
    env.reset(seed=0)
    for _ in range(300):
        *_, terminated, truncated, info = env.step(np.zeros(53))
        if terminated or truncated:
            break
    assert terminated and not truncated and info["end"] == "fall" and not info["success"]
    with pytest.raises(ValueError, match="the episode ended at step"):
        env.step(np.zeros(53))
    env.reset()
    env.step(np.zeros(53))


def test_bad_use_is_refused_by_name():
    env = fiatlux.Env("S05")
    with pytest.raises(ResetNeeded):
        env.step(np.zeros(53))
    env.reset(seed=0)
    for action, match in [
        (np.zeros(52), r"action: shape \(52,\) instead of \(53,\)"),
        ("up", "action: cannot be read as numbers"),
        (np.ma.masked_equal(np.zeros(53), 0), "a masked array has no number where it is masked"),
        (np.full(53, np.nan), "action of joint 'left_hip_pitch_joint' is not finite"),
        (np.full(53, 1e4), "action of joint 'left_hip_pitch_joint' is 10000.0"),
    ]:
        with pytest.raises(ValueError, match=match):
            env.step(action)
    assert env.row()["step"] == 0
    with pytest.raises(ValueError, match="options has no 'room'"):
        env.reset(options={"room": 1})
    env.close()
    for call in (env.reset, lambda: env.step(np.zeros(53)), env.render, env.summary):
        with pytest.raises(ClosedEnvironmentError):
            call()
    for settings, match in [
        ({"task": "S99"}, "there is no task 'S99'"),
        ({"observation": "list"}, "observation is 'list'"),
        ({"sensors": ["smell"]}, "'smell' is not a sensor"),
        ({"sensors": "camera"}, "give a list of names"),
        ({"sensors": ["features"], "weights": "nowhere.safetensors"}, "weights is 'nowhere.safetensors'"),
        ({"observation": "published", "privileged": True}, "a vector of its own"),
        ({"reward": "rich"}, "reward is 'rich'"),
        ({"robot": "c3po"}, "c3po"),
        ({"gains": "soft"}, "soft"),
        ({"action_form": "torque"}, "action_form is 'torque'"),
        ({"render_mode": "human"}, "render_mode is 'human'"),
    ]:
        with pytest.raises(ValueError, match=match):
            fiatlux.Env(**{"task": "S05", **settings})


def test_a_reset_that_is_refused_or_interrupted_counts_no_episode(monkeypatch):
    env = fiatlux.Env("S05")
    env.reset(seed=3)
    env.step(np.zeros(53))
    env.np_random.random()
    state = env.np_random.bit_generator.state
    for options in ({"room": 1}, {"episode": -1}, {"episode": "first"}):
        with pytest.raises(ValueError):
            env.reset(seed=9, options=options)

    def interrupted(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(fiatlux._native, "Episode", interrupted)
        env.reset()
    assert env.row()["step"] == 1 and env.np_random.bit_generator.state == state
    env.step(np.zeros(53))
    _, info = env.reset()
    assert (info["seed"], info["episode"]) == (3, 1)


def test_pictures_show_something():
    env = fiatlux.Env("S07", render_mode="rgb_array", render_size=(80, 60))
    env.reset(seed=0)
    picture = env.render()
    assert picture.shape == (60, 80, 3) and picture.dtype == np.uint8 and picture.std() > 10


def test_a_reset_without_a_seed_draws_a_room_for_training():
    assert fiatlux.env.TRAINING_SEEDS == (1000, 100_000)
    drawn = set()
    for _ in range(8):
        env = fiatlux.Env("S05")
        drawn.add(env.reset()[1]["seed"])
    assert len(drawn) > 4 and all(1000 <= seed < 100_000 for seed in drawn)
