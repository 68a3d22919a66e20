"""Tests vectors with Gymnasium's own wrappers, in each of its autoreset modes."""

import copy

import fiatlux
import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import (
    ClipReward,
    DictInfoToList,
    FlattenObservation,
    NormalizeObservation,
    NormalizeReward,
    RecordEpisodeStatistics,
    RescaleAction,
    TransformObservation,
)

STEPS = 5
WORLDS = 3


def walkers(mode, **settings):
    return fiatlux.WalkingVectorEnv(WORLDS, horizon_steps=STEPS, autoreset_mode=mode, **settings)


def zeros(env):
    return np.zeros(env.action_space.shape)


def test_modes_are_known_by_gymnasiums_names():
    for mode in AutoresetMode:
        for name in (mode, mode.value, mode.name, mode.name.lower()):
            assert walkers(name).metadata["autoreset_mode"] == mode
    assert fiatlux.WalkingVectorEnv(1).metadata["autoreset_mode"] == AutoresetMode.SAME_STEP
    for name in ("later", None, 3):
        with pytest.raises(
            ValueError, match="autoreset_mode is .*; known ones are 'next_step', 'same_step', 'disabled'"
        ):
            walkers(name)


def test_the_next_step_begins_the_next_episode():
    env = walkers("next_step")
    env.reset(seed=1)
    for _episode in range(2):
        for step in range(1, STEPS + 1):
            _, _, terminated, truncated, info = env.step(zeros(env))
            assert env.row(0)["step"] == step and not terminated.any() and truncated.all() == (step == STEPS)
            assert "final_obs" not in info
        # The action of this step counts for nothing.
        observation, reward, terminated, truncated, info = env.step(zeros(env) + 1.0)
        assert env.row(0)["step"] == 0 and not (reward.any() or terminated.any() or truncated.any())
        assert not info["reward_terms"].any() and not info["success"].any()


@pytest.mark.parametrize("mode", AutoresetMode)
def test_before_the_first_reset_nothing_goes_on(mode):
    env = walkers(mode, render_mode="rgb_array")
    env.reset(options={"reset_mask": np.arange(WORLDS) == 0})
    for call in (
        lambda: env.step(zeros(env)),
        lambda: env.rollout(zeros(env)[None]),
        env.render,
        lambda: env.render_world(0),
        lambda: copy.deepcopy(env).step(zeros(env)),
    ):
        with pytest.raises(gymnasium.error.ResetNeeded, match=r"call reset\(\) first"):
            call()
    # A whole state begins an episode, too.
    other = walkers(mode)
    other.reset(seed=1)
    env.restore(other.save())
    np.testing.assert_array_equal(env.step(zeros(env))[0], other.step(zeros(env))[0])


def test_experts_of_worlds_wait_for_their_reset():
    worlds = fiatlux.VectorEnv("S05", 1)
    with pytest.raises(gymnasium.error.ResetNeeded):
        fiatlux.Experts(worlds).label()


def test_a_reset_lets_the_next_step_count():
    env = walkers("next_step", judge=lambda observation, info: (np.ones(WORLDS), np.ones(WORLDS)))
    for _ in range(2):
        env.reset(seed=1)
        _, reward, terminated, _, _ = env.step(zeros(env))
        assert reward.tolist() == [1.0] * WORLDS and terminated.all()
    over = env.save()
    _, reward, terminated, _, _ = env.step(zeros(env))
    assert not reward.any() and not terminated.any()
    # A saved state knows which worlds wait.
    env.restore(over)
    assert not env.step(zeros(env))[1].any()


def test_disabled_waits_for_a_reset_of_the_worlds_that_ended():
    env = fiatlux.VectorEnv(
        "S05", 3, seeds=[1000, 1001, 1002], autoreset_mode=AutoresetMode.DISABLED, observation="flat"
    )
    env.reset(seed=1)
    # Standing robots may fall in the same step; this one falls first.
    actions = zeros(env)
    actions[1] = -1.0
    for _ in range(200):
        observation, _, terminated, truncated, _ = env.step(actions)
        if terminated.any():
            break
    assert terminated.tolist() == [False, True, False] and not truncated.any()
    rows = [env.row(world) for world in range(3)]
    with pytest.raises(ValueError, match=r"the episode of world \d has ended; call reset\(options={\"reset_mask\""):
        env.step(zeros(env))
    begun, _ = env.reset(options={"reset_mask": terminated})
    for world, _row in enumerate(rows):
        assert (env.row(world)["step"] == 0) == terminated[world]
        np.testing.assert_array_equal(begun[world], observation[world]) if not terminated[world] else None
    env.step(zeros(env))
    for mask in ([True], np.zeros(3, bool), np.ones(3), np.ones((3, 1), bool)):
        with pytest.raises(ValueError, match="reset_mask: "):
            env.reset(options={"reset_mask": mask})


def test_a_masked_reset_with_a_seed_begins_as_a_whole_one():
    env = walkers("disabled")
    whole, _ = env.reset(seed=7)
    env.step(zeros(env))
    begun, _ = env.reset(seed=7, options={"reset_mask": np.array([False, True, False])})
    np.testing.assert_array_equal(begun[1], whole[1])
    assert not np.array_equal(begun[0], whole[0])


@pytest.mark.parametrize("mode", ["same_step", "next_step"])
def test_episode_statistics_are_right(mode):
    env = RecordEpisodeStatistics(walkers(mode))
    env.reset(seed=1)
    paid, lengths = np.zeros(WORLDS), []
    for _step in range(4 * (STEPS + 1)):
        _, reward, _, truncated, info = env.step(zeros(env))
        paid += reward
        if truncated.any():
            lengths += info["episode"]["l"].tolist()
            np.testing.assert_allclose(info["episode"]["r"], paid, rtol=1e-5)
            paid[:] = 0.0
    assert lengths and set(lengths) == {STEPS}
    assert list(env.length_queue) == lengths


def test_episode_statistics_are_right_where_worlds_are_reset_by_hand():
    env = RecordEpisodeStatistics(walkers("disabled"))
    env.reset(seed=1)
    for _ in range(3):
        for _ in range(STEPS):
            *_, truncated, info = env.step(zeros(env))
        assert truncated.all() and info["episode"]["l"].tolist() == [STEPS] * WORLDS
        env.reset(options={"reset_mask": truncated})


def test_observations_are_normalised():
    env = NormalizeObservation(walkers("next_step"))
    seen = [env.reset(seed=1)[0]]
    for _ in range(200):
        seen.append(env.step(np.random.default_rng(len(seen)).uniform(-1, 1, env.action_space.shape))[0])
    last = np.concatenate(seen[100:])
    assert last.dtype == np.float32 and np.isfinite(last).all()
    moves = last.std(axis=0) > 1e-3
    assert moves.sum() > 100 and 0.3 < last.std(axis=0)[moves].mean() < 2.0


@pytest.mark.parametrize(
    "wrap",
    [
        lambda env: TransformObservation(env, lambda observation: observation, env.observation_space),
        NormalizeReward,
        lambda env: ClipReward(env, -1.0, 1.0),
        # Gymnasium warns of bounds that are plain numbers: they become float64.
        lambda env: RescaleAction(
            env, *(np.full(env.single_action_space.shape, bound, np.float32) for bound in (-1, 1))
        ),
        DictInfoToList,
    ],
)
def test_other_wrappers_step(wrap):
    env = wrap(walkers("next_step"))
    env.reset(seed=1)
    for _ in range(2 * STEPS):
        observation, *_ = env.step(zeros(env))
    assert np.isfinite(observation).all()


def test_dictionaries_are_flattened():
    env = FlattenObservation(fiatlux.WalkingVectorEnv(2, observation="dict", autoreset_mode="next_step"))
    observation, _ = env.reset(seed=1)
    assert observation.shape == (2, fiatlux.WalkingVectorEnv(1).single_observation_space.shape[0])


def test_make_vec_takes_the_mode():
    env = gymnasium.make_vec(
        "Fiatlux-Walking-v1", num_envs=2, vectorization_mode="vector_entry_point", autoreset_mode="next_step"
    )
    assert env.unwrapped.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP
