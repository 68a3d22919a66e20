"""Bags that the programs wrote.

`FIATLUX_TEST_RUN` names the folder of `fiatlux evaluate --policy zero --tasks S05 --seeds 0`.
"""

import json
import os
import pathlib

import fiatlux
import numpy as np
import pytest

RUN = os.environ.get("FIATLUX_TEST_RUN")


@pytest.mark.skipif(RUN is None, reason="FIATLUX_TEST_RUN is not set")
def test_a_bag_has_the_rows_that_the_package_plays():
    folder = pathlib.Path(RUN)
    results = json.loads((folder / "results.json").read_text())
    (recorded,) = results["episodes"]
    (path,) = folder.rglob("*.mcap")
    bag = fiatlux.Bag(path)
    assert bag.is_whole and bag.header["task"] == "S05" and bag.result["strict"]["steps"] == recorded["steps"]
    states = bag["/state"]
    assert bag["/state"] is states
    assert states["joint_position"].shape == (recorded["steps"] + 1, 53)
    # Things and contact measures by name; what cannot move has no velocity.
    sizes = {
        "ladder.linear_velocity": 3,
        "crate.position": 3,
        "fresh_bulb.hand_force": 102,
        "floor_force": 12,
        "tread_load": 4,
    }
    for name, size in sizes.items():
        assert states[name].shape == (recorded["steps"] + 1, size), name
    assert states["old_bulb.other_force_peak"].shape == states["old_bulb.seated"].shape == (recorded["steps"] + 1,)
    assert not any(name.startswith(("things.", "attachments.", "crate.linear", "forces")) for name in states)

    env = fiatlux.Env("S05")
    env.reset(seed=0)
    ended, rewards = False, []
    while not ended:
        _, reward, terminated, truncated, _ = env.step(np.zeros(53))
        rewards.append(reward)
        ended = terminated or truncated
    np.testing.assert_array_equal(env.row()["joint_position"], states["joint_position"][-1])
    np.testing.assert_array_equal(env.row()["joint_velocity"], states["joint_velocity"][-1])
    np.testing.assert_array_equal(env.row()["ladder_pose"][:3], states["ladder.position"][-1])
    np.testing.assert_allclose(bag["/reward"]["total"][-len(rewards) :], rewards)
    for name, value in env.summary().items():
        assert value == recorded[name], name

    with pytest.raises(KeyError, match="no topic '/smell'"):
        bag["/smell"]


def test_a_file_that_is_not_a_bag_is_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match="no bag at"):
        fiatlux.Bag(tmp_path / "nothing.mcap")
    text = tmp_path / "text.mcap"
    text.write_text("not a bag")
    with pytest.raises(fiatlux.FiatluxError, match="text.mcap"):
        fiatlux.Bag(text)


@pytest.mark.skipif(RUN is None, reason="FIATLUX_TEST_RUN is not set")
def test_the_bags_of_a_folder_are_those_that_somebody_put_there(tmp_path):
    (path,) = pathlib.Path(RUN).rglob("*.mcap")
    for name in (
        "b/two.mcap",
        "one.mcap",
        "._one.mcap",
        "#recycle/one.mcap",
        "@eaDir/one.mcap",
        "~$one.mcap",
        "lost+found/x.mcap",
    ):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(path.read_bytes())
    bags = fiatlux.Bag.below(tmp_path)
    assert [bag.header["task"] for bag in bags] == ["S05", "S05"]
    with pytest.raises(FileNotFoundError, match="no bag in"):
        fiatlux.Bag.below(tmp_path / "#recycle" / "nothing")


def test_a_thin_bag_has_the_arrays_of_a_full_one(tmp_path):
    """Guards that readers cannot tell the two forms apart: numbers, observations and results are equal."""
    rooms = {"tasks": ["S05"], "seeds": [0], "run_file": tmp_path / "RUN.toml"}
    policy = lambda observation: np.zeros(53)
    for form in ("full", "thin"):
        fiatlux.evaluate(policy, out=tmp_path / form, bags=form, **rooms)
    full, thin = (fiatlux.Bag.below(tmp_path / form)[0] for form in ("full", "thin"))
    assert thin.is_thin and not full.is_thin and thin.is_whole and thin.steps == full.steps
    assert thin.result["end"] == full.result["end"]
    for topic in full:
        assert full[topic].keys() == thin[topic].keys()
        for name, column in full[topic].items():
            np.testing.assert_array_equal(column, thin[topic][name], f"{topic} {name}")
    for name, numbers in full.observations().items():
        np.testing.assert_array_equal(numbers, thin.observations()[name])
    with pytest.raises(ValueError, match="use 'full' or 'thin'"):
        fiatlux.evaluate(policy, out=tmp_path / "wrong", bags="fat", **rooms)
