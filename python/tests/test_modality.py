"""Tests that the parts which `modality.json` names are where the data set has them."""

import json

import fiatlux
import numpy as np
import pytest
from fiatlux.modality import modality, write_modality


@pytest.fixture(scope="module")
def joints():
    return fiatlux.Env("S05").action_names


def features(joints, action):
    state = [f"base_angular_velocity.{axis}" for axis in "xyz"] + ["base_height"]
    state += [f"{term}.{joint}" for term in ("joint_position", "joint_velocity") for joint in joints]
    return {"observation.state": {"names": state}, "action": {"names": action}, "observation.images.camera": {}}


def test_every_number_has_one_key(joints, tmp_path):
    made = modality(features(joints, joints))
    for part, length in (("state", 4 + 2 * len(joints)), ("action", len(joints))):
        covered = np.concatenate([np.arange(key["start"], key["end"]) for key in made[part].values()])
        assert sorted(covered) == list(range(length)), part
    arm = made["state"]["right_arm"]
    names = features(joints, joints)["observation.state"]["names"][arm["start"] : arm["end"]]
    assert len(names) == 7 and all(name.startswith("joint_position.right_") for name in names)
    assert made["video"] == {"ego_view": {"original_key": "observation.images.camera"}}

    (tmp_path / "meta").mkdir()
    (tmp_path / "meta/info.json").write_text(json.dumps({"features": features(joints, joints)}))
    assert json.loads(write_modality(tmp_path).read_text()) == made
    with pytest.raises(FileNotFoundError, match="name the folder"):
        write_modality(tmp_path / "nothing")


def test_commands_have_their_own_keys(joints):
    made = modality(features(joints, ["vx", "vy", "wz", "height", "roll", "pitch", "yaw"]))
    assert made["action"]["base_height_command"] == {"start": 3, "end": 4} and len(made["action"]) == 3
    with pytest.raises(ValueError, match="no feature 'action'"):
        modality({"observation.state": {"names": []}})
