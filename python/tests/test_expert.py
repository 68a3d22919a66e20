"""Tests that the scripted expert answers a learner as it plays by itself."""

import copy
import json
import os
import pickle
import subprocess

import fiatlux
import numpy as np
import pytest


def labelled(env, expert, steps):
    """Answers of the expert as it plays, ``steps`` answers."""
    labels = []
    for _ in range(steps):
        labels.append(expert.label())
        env.step(labels[-1].action)
    return labels


def play(**settings):
    """Digest of S07 as the expert plays it to its end."""
    env = fiatlux.Env("S07", **settings)
    env.reset(seed=64)
    expert = fiatlux.Expert(env)
    is_over = False
    while not is_over:
        label = expert.label()
        assert label.can_label and label.reason is None
        assert label.phase == ("Stand" if label.is_over else "Walk")
        np.testing.assert_array_equal(expert.label().joint_target, label.joint_target)
        _, _, terminated, truncated, info = env.step(label.action)
        is_over = terminated or truncated
    assert info["success"]
    return env.digest


def test_it_plays_alike_whatever_the_student_senses_and_in_whichever_form_it_acts():
    assert play() == play(sensors=["last_action"], action_form="joint_target")


def test_experts_of_many_worlds_answer_as_those_of_one_do_and_begin_anew_with_each_episode():
    settings = {"noise": False, "action_form": "joint_target"}
    env = fiatlux.Env("S05", **settings)
    env.reset(seed=1000)
    alone = labelled(env, fiatlux.Expert(env), 60)
    many = fiatlux.VectorEnv(
        "S05", 3, seeds=[1000], episodes=1, horizon_steps=40, sensors=["last_action"], num_threads=1, **settings
    )
    many.reset(seed=0)
    together = labelled(many, fiatlux.Experts(many, num_threads=2), 60)
    for step, labels in enumerate(together):
        expected = alone[step % 40]
        for name in ("joint_target", "action", "body_command", "arms", "hands", "phase", "is_over", "can_label"):
            assert np.shape(getattr(labels, name))[0] == 3
            for world in range(3):
                np.testing.assert_array_equal(getattr(labels, name)[world], getattr(expected, name), f"{name}, {step}")


def test_body_commands_lead_the_whole_body_controller_to_the_same_joint_targets():
    env = fiatlux.VectorEnv("S09", 2, seeds=[1001], sensors=["proprioception"], observation="flat", num_threads=1)
    observation, _ = env.reset(seed=0)
    experts, bodies = fiatlux.Experts(env), fiatlux.WholeBodies(2)
    stays = np.full((2, 2, 7), np.nan)
    for _ in range(40):
        labels = experts.label()
        targets = bodies(observation, labels.body_command, stays)
        np.testing.assert_array_equal(targets[:, :15], labels.joint_target[:, :15])
        observation, *_ = env.step(labels.action)
    assert (labels.body_command[:, :3] != 0).any()


def test_an_expert_begins_anew_where_it_is_told_to_or_the_environment_goes_back():
    env = fiatlux.Env("S05", action_form="joint_target")
    env.reset(seed=64)
    expert = fiatlux.Expert(env)
    labelled(env, expert, 100)
    saved = env.save()
    walks = expert.label().body_command
    expert.reset()
    # It stands first.
    stands = expert.label().body_command
    assert np.abs(walks[:3]).max() > 0.05 and (stands[:3] == 0).all()
    labelled(env, expert, 60)
    assert np.abs(expert.label().body_command[:3]).max() > 0.05
    env.restore(saved)
    np.testing.assert_array_equal(expert.label().joint_target, fiatlux.Expert(env).label().joint_target)


def test_on_the_ladder_it_commands_joints_and_says_how_far_it_is():
    env = fiatlux.Env("S12", action_form="joint_target", sensors=["last_action"])
    env.reset(seed=64)
    labels = labelled(env, fiatlux.Expert(env), 400)
    assert np.isnan(labels[-1].body_command).all() and labels[-1].phase == "Climb"
    assert 0 < labels[-1].part_done < 0.2 and np.isnan(labels[0].part_done)
    assert not labels[-1].is_over and labels[-1].can_label


def test_wrong_arguments_are_refused_by_name():
    env, many = fiatlux.Env("S05"), fiatlux.VectorEnv("S05", 2, num_threads=1)
    with pytest.raises(TypeError, match="use Experts"):
        fiatlux.Expert(many)
    with pytest.raises(TypeError, match="use Expert for an Env"):
        fiatlux.Experts(env)
    with pytest.raises(TypeError, match="WalkingVectorEnv"):
        fiatlux.Experts(fiatlux.WalkingVectorEnv(1, num_threads=1))
    with pytest.raises(Exception, match="call reset"):
        fiatlux.Expert(env).label()
    with pytest.raises(ValueError, match="mask: shape"):
        fiatlux.Experts(many).reset([True])
    with pytest.raises(ValueError, match="num_threads"):
        fiatlux.Experts(many, num_threads=0)


def test_its_parameters_can_differ_and_those_that_cannot_be_read_are_refused():
    def first(parameters, task="S08"):
        env = fiatlux.Env(task)
        env.reset(seed=1000)
        return labelled(env, fiatlux.Expert(env, parameters), 30)[-1].joint_target

    own = first(None)
    np.testing.assert_array_equal(first(""), own)
    np.testing.assert_array_equal(first("motion.rate = 0.6"), own)
    assert np.abs(first("motion.rate = 0.3") - own).max() > 1e-3
    with pytest.raises(ValueError, match=r"parameters: .*unknown field `rates`"):
        first("motion.rates = 0.3")
    for wrong in ("motion = 3", "motion.rate = 'fast'", "motion.rate ="):
        with pytest.raises(ValueError, match="parameters: "):
            first(wrong)
    with pytest.raises(ValueError, match="parameters: S05 is not played by hand"):
        first("motion.rate = 0.6", "S05")
    many = fiatlux.VectorEnv("S08", 2, seeds=[1000], sensors=["last_action"], num_threads=1)
    many.reset(seed=0)
    with pytest.raises(ValueError, match="unknown field"):
        fiatlux.Experts(many, parameters="motion.rates = 0.3").label()


def test_a_recorded_episode_is_labelled_afterwards_row_by_row(tmp_path):
    class Stays:
        def __call__(self, observation):
            return np.zeros(53, np.float32)

    fiatlux.evaluate(Stays(), ["S05"], [1000], out=tmp_path)
    bag = fiatlux.Bag(next(tmp_path.rglob("*.mcap")))
    labels = fiatlux.label(bag)
    env = fiatlux.Env("S05")
    env.reset(seed=1000)
    expert = fiatlux.Expert(env)
    for step in range(20):
        np.testing.assert_array_equal(labels.joint_target[step], expert.label().joint_target)
        env.step(np.zeros(53))
    assert len(labels.phase) == len(bag["/state"]["step"]) - 1
    bag.header["seed"] = 1001
    with pytest.raises(ValueError, match="other settings"):
        fiatlux.label(bag)


@pytest.mark.skipif("FIATLUX_TEST_PROGRAM" not in os.environ, reason="needs the program fiatlux: FIATLUX_TEST_PROGRAM")
def test_labels_of_the_experts_own_episode_are_what_it_did(tmp_path):
    command = [
        os.environ["FIATLUX_TEST_PROGRAM"],
        "evaluate",
        "--policy",
        "expert",
        "--tasks",
        "S08",
        "--seeds",
        "1000",
    ]
    subprocess.run([*command, "--out", tmp_path], check=True, capture_output=True)
    bag = fiatlux.Bag(next((tmp_path / "bags").glob("*.mcap")))
    labels = fiatlux.label(bag)
    np.testing.assert_array_equal(labels.action, bag["/state"]["action"][1:])
    phases, is_over = bag.phases()
    assert phases == list(labels.phase) and (is_over == labels.is_over).all() and len(set(phases)) > 3
    path = next((tmp_path / "bags").glob("*.mcap"))
    subprocess.run([os.environ["FIATLUX_TEST_PROGRAM"], "label", path], check=True, capture_output=True)
    first, *rows = (json.loads(line) for line in path.with_suffix(".labels.jsonl").read_text().splitlines())
    assert first["joints"] == bag.header["joint_names"] and first["digest"] == bag.result["end"]["digest"]
    assert [row["phase"] for row in rows] == phases and all(row["can_label"] for row in rows)
    np.testing.assert_array_equal([row["joint_target"] for row in rows], labels.joint_target)


@pytest.mark.parametrize(("task", "step"), [("S06", 380), ("S08", 520), ("S12", 1500)])
def test_it_takes_over_in_the_midst_of_a_task(task, step):
    env = fiatlux.Env(task, action_form="joint_target", sensors=["last_action"])
    env.reset(seed=1000)
    labelled(env, fiatlux.Expert(env), step)
    fresh = fiatlux.Expert(env)
    is_over = False
    while not is_over:
        label = fresh.label()
        assert label.can_label
        _, _, terminated, truncated, info = env.step(label.action)
        is_over = terminated or truncated
    assert info["success"]


def test_experts_begin_anew_where_worlds_are_copied_or_go_back():
    env = fiatlux.VectorEnv(
        "S05", 3, seeds=[1000], episodes=1, sensors=["last_action"], action_form="joint_target", num_threads=1
    )
    env.reset(seed=0)
    experts = fiatlux.Experts(env)
    for _ in range(100):
        env.step(experts.label().action)
    saved = env.save()
    assert (np.abs(experts.label().body_command[:, :3]).max(axis=1) > 0.05).all()
    env.copy_world(0, np.array([False, True, False]))
    stands = (experts.label().body_command[:, :3] == 0).all(axis=1)
    np.testing.assert_array_equal(stands, [False, True, False])
    env.restore(saved)
    assert (experts.label().body_command[:, :3] == 0).all(), "at first it stands"


def test_it_says_where_it_cannot_go_on():
    env = fiatlux.VectorEnv("S12", 1, seeds=[1000], sensors=["last_action"], action_form="joint_target")
    env.reset(seed=0)
    experts = fiatlux.Experts(env)
    for _ in range(2600):
        env.step(experts.label().action)
    assert experts.label().can_label.all()
    row = env.row(0)
    bent = row["joint_position"].copy()
    bent[[0, 6]] -= 0.8
    env.reset_worlds(np.array([True]), {"joint_position": bent})
    label = experts.label()
    assert not label.can_label[0] and "no posture of the plan" in label.reason[0]
    assert np.isnan(label.joint_target).all() and np.isnan(label.action).all()


def test_a_copy_of_an_environment_gets_an_expert_of_its_own():
    env = fiatlux.Env("S07")
    env.reset(seed=1000)
    worlds = fiatlux.VectorEnv("S07", 2, seeds=[1000])
    worlds.reset(seed=1)
    for expert, named in ((fiatlux.Expert(env), "copy its Env"), (fiatlux.Experts(worlds), "copy its VectorEnv")):
        for copied in (copy.deepcopy, pickle.dumps):
            with pytest.raises(TypeError, match=f"cannot be copied or pickled: {named}, and make"):
                copied(expert)


class Asks:
    """Plays what the expert says, and keeps it."""

    sensors = ("proprioception", "hand_contact", "last_action", "privileged")
    action_form = "joint_target"
    told: list[fiatlux.Label] = []

    def reset(self, info):
        self.expert, self.told[:] = info["expert"], []
        # It may be asked at once.
        assert self.expert.label().can_label

    def __call__(self, observation):
        label = self.expert.label()
        assert label.reason is None and label.joint_target.tolist() == self.expert.label().joint_target.tolist()
        self.told.append(label)
        return label.joint_target


def test_a_policy_on_a_server_asks_the_expert_and_hears_what_it_says_in_an_environment(tmp_path):
    played = fiatlux.evaluate(Asks, ["S07"], [64], out=tmp_path)
    told = list(Asks.told)
    assert played.episodes[0]["strict_success"] and len(told) == played.episodes[0]["strict_steps"]
    env = fiatlux.Env("S07", action_form="joint_target", protocol="strict")
    env.reset(seed=64)
    expected = labelled(env, fiatlux.Expert(env), 200)
    for heard, label in zip(told, expected):
        np.testing.assert_array_equal(heard.joint_target, label.joint_target)
        np.testing.assert_array_equal(heard.body_command, label.body_command)
        assert (heard.phase, heard.is_over) == (label.phase, label.is_over)
    # The plain evaluation gives it, too.
    plain = fiatlux.evaluate(Asks, ["S07"], [64])
    assert plain.episodes[0]["state_digest"] == played.episodes[0]["state_digest"]


def test_an_expert_without_exact_poses_says_which_sensors_it_needs(tmp_path):
    class Blind(Asks):
        sensors = ("proprioception",)

    for where in ({"out": tmp_path}, {}):
        with pytest.raises(ValueError, match="reads hand_contact, last_action, privileged, too: add to sensors"):
            fiatlux.evaluate(Blind, ["S07"], [64], **where)
