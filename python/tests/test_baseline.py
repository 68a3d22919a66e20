"""An exported baseline is played without the libraries that trained it. `extras/test_train.py` exports one."""

import json

import fiatlux
import numpy as np
import pytest


def packed(path, contract, sizes, change=lambda contract, tensors: None):
    """A file with a contract and a random network of layers of these sizes, as the export writes it."""
    random = np.random.default_rng(0)
    tensors = {}
    numbers = tensors["check.observation"] = random.normal(size=sizes[0]).astype(np.float32)
    for number, (before, after) in enumerate(zip(sizes, sizes[1:])):
        weight = tensors[f"layer{number}.weight"] = (0.1 * random.normal(size=(after, before))).astype(np.float32)
        bias = tensors[f"layer{number}.bias"] = (0.1 * random.normal(size=after)).astype(np.float32)
        numbers = weight @ numbers + bias
        last = number == len(sizes) - 2
        numbers = numbers if last else np.where(numbers > 0, numbers, np.exp(np.minimum(numbers, 0)) - 1)
    tensors["check.action"] = numbers.astype(np.float32)
    change(contract, tensors)
    header, body = {"__metadata__": {"contract": json.dumps(contract)}}, b""
    for name, tensor in tensors.items():
        header[name] = {
            "dtype": "F32",
            "shape": list(tensor.shape),
            "data_offsets": [len(body), len(body) + tensor.nbytes],
        }
        body += tensor.tobytes()
    text = json.dumps(header).encode()
    path.write_bytes(len(text).to_bytes(8, "little") + text + body)
    return path


def write(path, change=lambda contract, tensors: None, sensors=("proprioception", "last_action"), inputs=None):
    """A baseline of S02."""
    env = fiatlux.Env("S02", sensors=sensors, observation="flat")
    contract = {
        "format": "fiatlux-baseline/1",
        "task": "S02",
        "robot": "g1_inspire",
        "sensors": list(sensors),
        "hidden": [16, 8],
    }
    return packed(path, contract, [inputs or env.observation_space.shape[0], 16, 8, 53], change)


def test_it_plays_with_its_own_sensors(tmp_path):
    policy = fiatlux.load_policy(write(tmp_path / "s02.safetensors"))
    assert policy.sensors == ["proprioception", "last_action"]
    assert repr(policy).startswith("<fiatlux.Baseline ppo:s02.safetensors@")
    assert repr(policy).endswith(": g1_inspire, 169 numbers of proprioception, last_action>")
    played = fiatlux.evaluate(policy, ["S02"], [0], max_steps=5)
    assert played.episodes[0]["steps"] == 5
    # The same actions in an environment of one's own.
    env = fiatlux.Env("S02", sensors=policy.sensors, observation="flat")
    numbers, _ = env.reset(seed=0)
    for _ in range(5):
        numbers = env.step(policy(numbers))[0]
    assert played.episodes[0]["state_digest"] == env.digest
    with pytest.raises(ValueError, match="sensors is .*the policy's own"):
        fiatlux.evaluate(policy, ["S02"], [0], sensors=["lidar"], max_steps=5)
    with pytest.raises(ValueError, match="observation: shape .* its sensors are proprioception"):
        policy(np.zeros(3))


def test_files_that_are_none_are_refused_by_name(tmp_path):
    def old(contract, _):
        contract["format"] = "fiatlux-baseline/0"

    def other(_, tensors):
        tensors["check.action"] = tensors["check.action"] + 1

    def missing(_, tensors):
        del tensors["layer1.bias"]

    def broken(_, tensors):
        tensors["layer0.bias"] = tensors["layer0.bias"] * np.float32(np.nan)

    for change, match in [
        (old, "fiatlux-baseline/0"),
        (other, "differs from its export"),
        (missing, "no contract of a policy of ppo"),
        (broken, "finite float32"),
    ]:
        with pytest.raises(ValueError, match=match):
            fiatlux.Baseline(write(tmp_path / "x.safetensors", change))
    (tmp_path / "x.safetensors").write_bytes(b"no")
    with pytest.raises(ValueError, match="not a safetensors file"):
        fiatlux.Baseline(tmp_path / "x.safetensors")


def test_a_policy_may_call_an_object_of_its_own_a_robot():
    class Policy:
        robot = object()
        sensors = [1, 2]

        def __call__(self, observation):
            return np.zeros(53)

    assert fiatlux.policy.settings_for(Policy(), {"robot": "g1_dex3"}) == {"robot": "g1_dex3"}
    Policy.robot = "g1_inspire"
    with pytest.raises(ValueError, match="robot is 'g1_dex3'"):
        fiatlux.policy.settings_for(Policy(), {"robot": "g1_dex3"})
