"""Tests what sets the state of single worlds: copies, rows, starts, ends."""

import copy
import pickle

import fiatlux
import numpy as np
import pytest
from test_vector import assert_same

OTHERS = np.arange(4) > 0


def errand(task="S07", num_envs=4, **settings):
    return fiatlux.VectorEnv(
        task, num_envs, **{"seeds": [1000], "episodes": 1, "observation": "flat", "reward": "training", **settings}
    )


def shaken(env, steps=15):
    """Worlds that differ from each other, in the middle of an episode."""
    env.reset(seed=3)
    for actions in np.random.default_rng(1).uniform(-0.3, 0.3, (steps, *env.action_space.shape)):
        env.step(actions)
    return env


def test_a_copied_world_goes_on_exactly():
    """Rows, observations with their noise, and rewards, over 100 steps and the ends of episodes."""
    env = shaken(errand())
    before = env.row(1)
    seen = env.copy_world(1, np.array([True, False, True, True]))
    np.testing.assert_array_equal(seen, np.broadcast_to(seen[1], seen.shape))
    assert_same(before.values(), env.row(1).values())
    ended = 0
    for action in np.random.default_rng(2).uniform(-0.5, 0.5, (100, env.action_space.shape[1])):
        seen, reward, terminated, truncated, _ = env.step(np.broadcast_to(action, env.action_space.shape))
        for world in (0, 2, 3):
            assert_same(env.row(1).values(), env.row(world).values())
        np.testing.assert_array_equal(seen, np.broadcast_to(seen[1], seen.shape))
        assert (reward == reward[1]).all()
        ended += terminated.sum()
    assert ended > 0


def test_a_world_of_another_room_or_vector_is_refused_by_name():
    env = errand(seeds=[1000, 1001])
    with pytest.raises(ValueError, match="snapshot: seeds of the rooms is 1000, but the batch has 1001"):
        env.copy_world(0, OTHERS)
    saved = env.save(world=0)
    with pytest.raises(ValueError, match="snapshot: task is S07, but the batch has S08"):
        errand("S08").restore(saved, OTHERS)
    with pytest.raises(ValueError, match="snapshot: noise is true, but the batch has false"):
        errand(noise=False).restore(saved, OTHERS)
    with pytest.raises(ValueError, match=r"worlds: shape \(3,\), bool; give a boolean for each of 4 worlds"):
        env.copy_world(0, OTHERS[:3])
    with pytest.raises(ValueError, match="world is 4; give 0 to 3"):
        env.save(world=4)
    with pytest.raises(ValueError, match="worlds of the snapshot has 4 numbers instead of 1"):
        env.restore(env.save(), OTHERS)


def test_one_world_s_snapshot_goes_into_a_vector_of_another_size():
    env, other = shaken(errand()), errand(num_envs=2, seed=9)
    saved = pickle.loads(pickle.dumps(env.save(world=2)))
    other.restore(saved, np.array([False, True]))
    assert_same(env.row(2).values(), other.row(1).values())


def test_an_episode_begins_at_the_row_of_another_world_or_at_a_dictionary():
    env = shaken(errand())
    rows = [env.row(world) for world in range(4)]
    env.reset_worlds(np.array([False, True, False, False]), like=3)
    begun = env.row(1)
    assert begun.pop("step") == 0
    assert_same(begun.values(), [rows[3][name] for name in begun])
    assert_same(rows[0].values(), env.row(0).values())

    # All of a row sets all of a world; a part sets that part alone, for each world another one.
    env.reset_worlds(OTHERS, like=rows[0])
    for world in (1, 2, 3):
        assert_same([rows[0][name] for name in begun], [env.row(world)[name] for name in begun])
    poses = np.array([env.row(world)["robot_pose"] for world in range(4)])
    poses[:, 2] += [0.1, 0.2, 0.3, 0.4]
    env.reset_worlds(OTHERS, like={"robot_pose": poses, "fresh_bulb_seated": [1.0]})
    for world in (1, 2, 3):
        np.testing.assert_array_equal(env.row(world)["robot_pose"], poses[world])
        np.testing.assert_array_equal(env.row(world)["joint_position"], rows[0]["joint_position"])
        assert env.row(world)["fresh_bulb_seated"] == 1.0
    assert env.row(0)["fresh_bulb_seated"] == 0.0


@pytest.mark.parametrize(
    ("like", "says"),
    [
        (4, "like is 4; give 0 to 3"),
        ({"robot_poze": np.zeros(7)}, "like has no part 'robot_poze'; the known ones are those of row()"),
        ({"robot_pose": np.zeros(6)}, "like: robot_pose has 6 numbers instead of 7"),
        (
            {"robot_pose": np.zeros((3, 7))},
            r"like: robot_pose has shape \(3, 7\); give a list of numbers, or one for each",
        ),
        ({"joint_position": np.zeros(29)}, "like: joint_position has 29 numbers instead of 53"),
    ],
)
def test_states_that_do_not_fit_are_refused_by_name(like, says):
    env = errand()
    before = env.row(1)
    with pytest.raises(ValueError, match=says):
        env.reset_worlds(OTHERS, like=like)
    assert_same(before.values(), env.row(1).values())


def test_an_episode_is_saved_and_restored():
    env = fiatlux.Env("S07", observation="flat")
    env.reset(seed=1000)
    actions = np.random.default_rng(0).uniform(-0.2, 0.2, (20, 53))
    for action in actions[:10]:
        env.step(action)
    saved = env.save()
    went_on = [env.step(action)[:2] for action in actions[10:]]
    for state, other in ((saved, env), (pickle.loads(pickle.dumps(saved)), fiatlux.Env("S07", observation="flat"))):
        other.restore(state)
        for action, (seen, reward) in zip(actions[10:], went_on):
            ours = other.step(action)
            np.testing.assert_array_equal(ours[0], seen)
            assert ours[1] == reward
        assert other.digest == env.digest
    with pytest.raises(ValueError, match="state: task is 'S07', but the environment has 'S08'"):
        fiatlux.Env("S08", observation="flat").restore(saved)
    with pytest.raises(ValueError, match="state: noise is True, but the environment has False"):
        fiatlux.Env("S07", observation="flat", noise=False).restore(saved)
    assert copy.deepcopy(env).restore(saved) is not None


def test_starts_are_mixed_by_weight():
    own = errand("S04", 1, noise=False).row(0)["robot_pose"]
    other = errand("S12", 1, noise=False).row(0)["robot_pose"]
    raised = {"robot_pose": own + [0, 0, 0.05, 0, 0, 0, 0]}
    starts = [fiatlux.Start(), fiatlux.Start(task="S12", weight=2.0), fiatlux.Start(rows=[raised] * 2, weight=5.0)]
    env = errand("S04", 400, starts=starts)
    env.reset(seed=1)
    poses = [env.row(world)["robot_pose"] for world in range(400)]
    shares = [np.mean([np.array_equal(pose, start) for pose in poses]) for start in (own, other, raised["robot_pose"])]
    # Within four standard deviations of a binomial share of 400.
    np.testing.assert_allclose(shares, [0.125, 0.25, 0.625], atol=0.1)
    assert sum(shares) == 1.0
    with pytest.raises(ValueError, match="snapshot: starts is"):
        env.restore(errand("S04", 400).save())


@pytest.mark.parametrize(
    ("starts", "says"),
    [
        ([fiatlux.Start(task="S01")], "starts: S01 plays in another scene than S04; S01 and replace share one"),
        ([fiatlux.Start(seed=7)], "starts: seed is 7, but the rooms are 1000"),
        ([fiatlux.Start(rows=[])], "starts: rows is empty"),
        ([fiatlux.Start(weight=-1.0)], "bank 0: the weights of starts must be finite and at least 0"),
        ([fiatlux.Start(rows=[{"robot_poze": [1.0]}])], "like has no part 'robot_poze'"),
        ([], "starts is empty; leave it out"),
    ],
)
def test_starts_that_cannot_be_are_refused(starts, says):
    with pytest.raises(ValueError, match=says):
        errand("S04", starts=starts)


def test_the_first_episodes_end_at_random_times():
    env = errand(horizon_steps=40, num_envs=12, noise=False)
    env.reset()
    env.stagger()
    ends = np.array([env.step(np.zeros(env.action_space.shape))[3] for _ in range(80)])
    first = ends.argmax(axis=0)
    assert len(set(first.tolist())) > 4
    for world in range(12):
        np.testing.assert_array_equal(np.flatnonzero(ends[:, world])[:2], [first[world], first[world] + 40])
    env.stagger(np.full(12, 39))
    assert env.step(np.zeros(env.action_space.shape))[3].all()


def test_weights_of_a_task_s_reward_can_be_given():
    usual, ours = errand(), errand(reward_weights={"action_rate": -1.0})
    assert ours.reward_weights == {**usual.reward_weights, "action_rate": -1.0}
    place = ours.reward_terms.index("action_rate")
    factor = -1.0 / usual.reward_weights["action_rate"]
    paid = []
    for env in (usual, ours):
        env.reset(seed=1)
        _, reward, _, _, info = env.step(np.full(env.action_space.shape, 0.1))
        np.testing.assert_allclose(reward, info["reward_terms"].sum(axis=1), rtol=1e-6)
        paid.append(info["reward_terms"])
    np.testing.assert_allclose(factor * paid[0][:, place], paid[1][:, place], rtol=1e-6)
    rest = np.arange(len(ours.reward_terms)) != place
    np.testing.assert_array_equal(paid[0][:, rest], paid[1][:, rest])
    with pytest.raises(ValueError, match='the reward has no term "speed"; the terms are gate_progress'):
        errand(reward_weights={"speed": 1.0})


@pytest.mark.parametrize("mode", ["same_step", "next_step", "disabled"])
def test_a_judge_of_one_s_own_pays_and_ends(mode):
    seen = []

    def judge(observation, info):
        steps = np.array([env.row(world)["step"] for world in range(4)]) if seen else np.ones(4)
        seen.append(observation.copy())
        assert info["reward_terms"].shape == (4, len(env.reward_terms))
        return steps + 1.0, steps == 3

    env = errand(judge=judge, autoreset_mode=mode)
    env.reset(seed=1)
    actions = np.zeros(env.action_space.shape)
    for step in range(1, 4):
        observation, reward, terminated, truncated, info = env.step(actions)
        np.testing.assert_array_equal(reward, step + 1.0)
        assert terminated.all() == (step == 3) and not truncated.any()
    if mode == "same_step":
        # The judge saw the last observation, and the caller has both.
        np.testing.assert_array_equal(info["final_obs"], seen[-1])
        assert info["_final_obs"].all() and not np.array_equal(observation, seen[-1])
        assert env.row(0)["step"] == 0
    elif mode == "next_step":
        np.testing.assert_array_equal(observation, seen[-1])
        _, reward, terminated, _, _ = env.step(actions)
        assert not reward.any() and not terminated.any() and env.row(0)["step"] == 0
    else:
        with pytest.raises(ValueError, match="the episode of world 0 has ended"):
            env.step(actions)


def test_episodes_can_be_ended():
    env = shaken(errand())
    others = env.row(0)
    env.terminate(OTHERS)
    assert [env.row(world)["step"] for world in range(4)] == [15, 0, 0, 0]
    assert_same(others.values(), env.row(0).values())


def test_what_varies_varies_by_name():
    """Each range alone changes what it names, and the world moves otherwise."""
    still = {}
    for ranges in (
        {},
        {"friction": {"ladder": (0.1, 0.2), "floor": (2.0, 3.0)}},
        {"thing_mass": {"fresh_bulb": (2.0, 3.0), "ladder": (0.5, 0.6)}},
        {"action_delay": (40, 40)},
    ):
        env = errand("S09", 1, ranges=ranges, variations=1, noise=False)
        shaken(env)
        still[str(ranges)] = env.row(0)["joint_position"].tobytes()
    assert still.pop("{}") not in still.values()
    pictures = [
        errand("S08", 2, ranges={"light": light}, variations=4, sensors=["camera"], image_size=(32, 24)).reset(seed=2)[
            0
        ]
        for light in (False, True)
    ]
    assert np.array_equal(pictures[0][0], pictures[0][1]) and not np.array_equal(pictures[1][0], pictures[1][1])
    for ranges, says in (
        (
            {"friction": {"lader": (0.1, 0.2)}},
            "ranges: friction must name surfaces: floor, room, bench, robot or a thing",
        ),
        ({"friction": {"ladder": (0.2, 0.1)}}, "ranges: friction must be"),
        ({"thing_mass": {"crate": (0.1, 0.2)}}, "ranges: thing_mass must name things that move"),
        ({"thing_mass": {"ladder": (0.0, 0.2)}}, "ranges: thing_mass must be .* above 0"),
        ({"action_delay": (0, 30)}, "action_delay is 30; give a multiple of 20 ms, at most 100"),
        ({"action_delay": (40, 20)}, "ranges: action_delay must be"),
    ):
        with pytest.raises(ValueError, match=says):
            errand(ranges=ranges)
    with pytest.raises(ValueError, match="ranges: action_delay, noise and camera are for the benchmark's tasks"):
        fiatlux.WalkingVectorEnv(1, ranges={"action_delay": (0, 20)})


@pytest.mark.parametrize(
    "settings",
    [
        {"action_delay": 60},
        {"prop_scale": {"ladder_z": 1.05}, "fix": ["start", "hand-friction"]},
        {"thresholds": {"facing_rad": 0.3}, "end_on": ["fall"]},
    ],
)
def test_every_setting_of_the_programs_holds_in_both_kinds_of_environment(settings):
    env = fiatlux.Env("S08", observation="flat", noise=False, **settings)
    worlds = errand("S08", 1, noise=False, reward="benchmark", **settings)
    seen = env.reset(seed=1000)[0]
    np.testing.assert_array_equal(seen, worlds.reset()[0][0])
    usual = fiatlux.Env("S08", observation="flat", noise=False)
    usual.reset(seed=1000)
    for action in np.random.default_rng(0).uniform(-0.3, 0.3, (8, 53)):
        ours, others = env.step(action), worlds.step(action[None])
        np.testing.assert_array_equal(ours[0], others[0][0])
        usual.step(action)
    assert usual.digest != env.digest
    if "action_delay" in settings:
        # Three steps of the staged posture, then the first action.
        actions = np.random.default_rng(0).uniform(-0.3, 0.3, (8, 53))
        np.testing.assert_array_equal(env.row()["action"], actions[4])


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"action_delay": 30}, "action_delay is 30; give a multiple of 20 ms, at most 100"),
        ({"fix": ["gravity"]}, "fix: 'gravity' is refused; known ones are layout"),
        ({"fix": "start"}, "fix is 'start'; give a list of names"),
        ({"prop_scale": {"table": 1.0}}, "'table' has no size; use ladder_x"),
        ({"thresholds": {"facing": 1.0}}, "facing"),
        ({"end_on": ["boredom"]}, "boredom"),
    ],
)
def test_settings_that_are_not_known_are_refused(settings, says):
    with pytest.raises(ValueError, match=says):
        fiatlux.Env("S08", **settings)


def test_climbers_feel_their_limbs():
    fields = {task: set(fiatlux.VectorEnv(task, 1, observation="flat").fields) for task in ("S02", "S07", "climb")}
    assert "limb_contact" in fields["S02"] & fields["climb"] - fields["S07"]


def test_what_an_episode_drew_is_in_info():
    env = fiatlux.Env("S08")
    drawn = [env.reset(seed=seed)[1]["drawn"] for seed in (1000, 1001)]
    assert drawn[0]["light"] != drawn[1]["light"] and drawn[0]["hand_friction"] != drawn[1]["hand_friction"]


def test_a_recorded_episode_goes_on_from_any_of_its_rows(tmp_path):
    fiatlux.evaluate(lambda observation: np.zeros(53), tasks=["S05"], seeds=[1000], out=tmp_path)
    (path,) = tmp_path.rglob("*.mcap")
    bag = fiatlux.Bag(path)
    env = errand("S05", 2)
    env.reset()
    assert bag.row(20).keys() == env.row(0).keys()
    env.reset_worlds(np.array([True, False]), like=bag.row(20))
    env.step(np.zeros(env.action_space.shape))
    recorded, ours = bag.row(21), env.row(0)
    assert (recorded.pop("step"), ours.pop("step")) == (21, 1)
    for name in ours:
        np.testing.assert_array_equal(ours[name], recorded[name], err_msg=name)
