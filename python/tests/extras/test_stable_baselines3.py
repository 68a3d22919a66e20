"""Tests the worlds with Stable-Baselines3's checkers and PPO."""

import warnings

import fiatlux
import numpy as np
import pytest
from fiatlux.stable_baselines3 import StableBaselinesVecEnv
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.preprocessing import is_image_space
from stable_baselines3.common.torch_layers import NatureCNN
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

pytestmark = pytest.mark.filterwarnings("default")


@pytest.mark.parametrize("observation", ["flat", "dict"])
def test_the_checker_passes(observation):
    """The checker recommends action boxes from -1 to 1, as in the default form."""
    env = fiatlux.Env("S05", observation=observation, sensors=["proprioception", "last_action"])
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(env)


@pytest.mark.parametrize("observation, policy", [("flat", "MlpPolicy"), ("dict", "MultiInputPolicy")])
def test_ppo_learns_on_many_worlds(observation, policy):
    worlds = fiatlux.WalkingVectorEnv(16, seed=1, observation=observation, horizon_steps=40)
    env = VecNormalize(VecMonitor(StableBaselinesVecEnv(worlds)), norm_obs=observation == "flat")
    model = PPO(policy, env, n_steps=32, batch_size=128, n_epochs=2, seed=1, device="cpu", verbose=0)
    before = [parameter.clone() for parameter in model.policy.parameters()]
    model.learn(16 * 32 * 3)
    assert model.num_timesteps == 16 * 32 * 3
    assert any((old != new).any() for old, new in zip(before, model.policy.parameters()))
    assert len(model.ep_info_buffer) > 0 and all(info["l"] <= 40 for info in model.ep_info_buffer)


def test_pictures_go_to_a_convolutional_network():
    worlds = fiatlux.VectorEnv(
        "S05", 2, seeds=[1000], sensors=["camera", "proprioception"], image_size=(48, 40), num_threads=1
    )
    assert is_image_space(worlds.single_observation_space["camera"])
    assert is_image_space(fiatlux.Env("S05", sensors=["camera"], image_size=(48, 40)).observation_space["camera"])
    model = PPO("MultiInputPolicy", StableBaselinesVecEnv(worlds), n_steps=8, batch_size=8, n_epochs=1, device="cpu")
    assert isinstance(model.policy.features_extractor.extractors["camera"], NatureCNN)
    assert model.observation_space["camera"].shape == (3, 40, 48), "channels come first for the network"
    model.learn(16)
    action, _ = model.predict(model.env.reset())
    assert action.shape == (2, 53) and np.isfinite(action).all()


def test_vectors_that_the_library_would_misread_are_refused():
    for settings, match in [
        ({"copy": False}, "copy=True"),
        ({"final_obs": False}, "final_obs=True"),
        ({"autoreset_mode": "next_step"}, "autoreset_mode='same_step'"),
    ]:
        with pytest.raises(ValueError, match=f"StableBaselinesVecEnv: .*{match}"):
            StableBaselinesVecEnv(fiatlux.WalkingVectorEnv(2, **settings))


def test_the_end_of_an_episode_is_told():
    env = StableBaselinesVecEnv(fiatlux.WalkingVectorEnv(3, seed=2, horizon_steps=4))
    env.seed(5)
    first = env.reset()
    plain, _ = fiatlux.WalkingVectorEnv(3, seed=2, horizon_steps=4).reset(seed=5)
    np.testing.assert_array_equal(first, plain)
    for step in range(1, 5):
        observed, rewards, dones, infos = env.step(np.zeros((3, 15), np.float32))
        assert dones.all() == (step == 4)
    for world, info in enumerate(infos):
        assert info["TimeLimit.truncated"] and not info["is_success"]
        assert not np.array_equal(info["terminal_observation"], observed[world])
    assert env.env_is_wrapped(VecMonitor) == [False] * 3
    assert env.get_attr("num_threads") == [env.env.num_threads] * 3
    with pytest.raises(AttributeError, match="share one object"):
        env.set_attr("x", 1)
    with pytest.raises(AttributeError, match="of a world"):
        env.env_method("reset")
    env.close()
