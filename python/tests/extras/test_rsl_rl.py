"""Tests RSL-RL's runner on walking."""

import math

import fiatlux
import numpy as np
import pytest
import torch
from fiatlux.rsl_rl import RslRlVecEnv
from rsl_rl.runners import OnPolicyRunner

pytestmark = pytest.mark.filterwarnings("default")


def config(steps):
    def model(**more):
        return {
            "class_name": "MLPModel",
            "hidden_dims": [64, 64],
            "activation": "elu",
            "obs_normalization": True,
            **more,
        }

    return {
        "seed": 1,
        "num_steps_per_env": steps,
        "save_interval": 100,
        "obs_groups": {"actor": ["policy"], "critic": ["critic"]},
        "actor": model(distribution_cfg={"class_name": "GaussianDistribution", "init_std": 1.0, "std_type": "scalar"}),
        "critic": model(),
        "algorithm": {
            "class_name": "PPO",
            "num_learning_epochs": 2,
            "num_mini_batches": 4,
            "learning_rate": 1e-3,
            "schedule": "adaptive",
            "gamma": 0.99,
            "lam": 0.95,
            "desired_kl": 0.01,
            "entropy_coef": 0.005,
            "clip_param": 0.2,
            "value_loss_coef": 1.0,
            "use_clipped_value_loss": True,
            "max_grad_norm": 1.0,
            "rnd_cfg": None,
            "symmetry_cfg": None,
        },
    }


def test_the_runner_trains_for_50_iterations(tmp_path, capsys):
    torch.manual_seed(1)
    worlds = fiatlux.WalkingVectorEnv(64, seed=1)
    env = RslRlVecEnv(worlds, max_episode_length=1000)
    groups = env.get_observations()
    assert groups["policy"].shape == (64, 320) and groups["critic"].shape == (64, 414)
    runner = OnPolicyRunner(env, config(24), log_dir=str(tmp_path))
    runner.learn(50, init_at_random_ep_len=True)
    said = capsys.readouterr().out
    assert "Learning iteration 49/50" in said and "reward/" in said
    assert (tmp_path / "model_49.pt").is_file()
    policy = runner.get_inference_policy()
    actions = policy(env.get_observations())
    assert actions.shape == (64, env.num_actions) and torch.isfinite(actions).all()


def test_steps_and_ends_are_those_of_the_worlds():
    plain = fiatlux.WalkingVectorEnv(4, seed=3, horizon_steps=5)
    env = RslRlVecEnv(fiatlux.WalkingVectorEnv(4, seed=3, horizon_steps=5), max_episode_length=5)
    observed, _ = plain.reset()
    # The wrapper began its worlds when it was made.
    np.testing.assert_array_equal(env.get_observations()["critic"].numpy(), observed)
    for step in range(1, 11):
        actions = np.random.default_rng(step).uniform(-1, 1, (4, env.num_actions)).astype(np.float32)
        observed, rewards, terminated, truncated, _ = plain.step(actions)
        groups, paid, dones, extras = env.step(torch.from_numpy(actions))
        np.testing.assert_array_equal(groups["critic"].numpy(), observed)
        np.testing.assert_array_equal(paid.numpy(), rewards)
        np.testing.assert_array_equal(dones.bool().numpy(), terminated | truncated)
        np.testing.assert_array_equal(extras["time_outs"].numpy(), truncated)
        assert all(math.isfinite(value) for value in extras["log"].values())
        assert env.episode_length_buf.eq(step % 5).all()


def test_named_fields_are_refused():
    with pytest.raises(ValueError, match="observation='flat'"):
        RslRlVecEnv(fiatlux.WalkingVectorEnv(2, observation="dict"), max_episode_length=10)


def test_random_initial_lengths_take_effect():
    """A world whose episode counts as so long already times out as much earlier, once."""
    env = RslRlVecEnv(fiatlux.WalkingVectorEnv(3, horizon_steps=6), max_episode_length=6)
    still = torch.zeros(3, env.num_actions)
    env.step(still)
    env.episode_length_buf = torch.tensor([1, 3, 5])
    ends = [env.step(still)[3]["time_outs"].tolist() for _ in range(8)]
    of = [[step for step, ended in enumerate(ends, 1) if ended[world]] for world in range(3)]
    assert of == [[5], [3], [1, 7]]
