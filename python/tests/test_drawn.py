"""Whatever an episode draws is the same in `Env`, in `VectorEnv`, and in the episode that the service plays."""

import fiatlux
import numpy as np
import pytest

SENSORS = ["proprioception", "hand_contact", "last_action", "lidar", "camera", "chest_camera", "privileged", "verdict"]
STEPS = 15


def actions():
    # Of more digits than a float32 holds.
    return np.random.default_rng(1).uniform(-0.2, 0.2, (STEPS, 53))


@pytest.mark.parametrize("task", ["S05", "S08"])
def test_env_vector_and_episode_are_one(task):
    """Room, sizes, masses, friction, start, light and tint, delay of actions: all show in rows, pictures or sensors."""
    settings = {"sensors": SENSORS, "noise": False, "image_size": (48, 36), "reward": "training"}
    lights = []
    for seed, episode in [(1000, 0), (1001, 0), (1001, 1)]:
        env = fiatlux.Env(task, **settings)
        # The starts of a room are its first episodes; one world for each of them is drawn by its stream.
        worlds = fiatlux.VectorEnv(task, 8, seeds=[seed], episodes=episode + 1, **settings)
        seen, observed = env.reset(seed=seed, options={"episode": episode})[0], worlds.reset()[0]
        same = [w for w in range(8) if np.array_equal(worlds.row(w)["robot_pose"], env.row()["robot_pose"])]
        assert same, "no world began this episode"
        world = same[0]
        lights.append(seen["camera"].mean())
        for step, action in enumerate(actions()):
            for name, part in seen.items():
                np.testing.assert_array_equal(observed[name][world], part, err_msg=f"{name} in step {step}")
                assert observed[name].dtype == part.dtype
            for name, part in env.row().items():
                np.testing.assert_array_equal(worlds.row(world)[name], part, err_msg=f"{name} in step {step}")
            seen, reward, *ended, info = env.step(action)
            observed, rewards, *others, infos = worlds.step(np.tile(action, (8, 1)))
            assert ended == [flags[world] for flags in others]
            # A batch adds up its terms after rounding them.
            assert rewards[world] == pytest.approx(reward, rel=1e-5, abs=1e-7)
            terms = dict(zip(worlds.reward_terms, infos["reward_terms"][world]))
            assert terms == {name: np.float32(term) for name, term in info["reward_terms"].items()}
            np.testing.assert_array_equal(env.row()["action"], action)
    assert np.ptp(lights) > 1.0, "the episodes have the same light"


def test_the_episode_of_the_service_has_the_same_digest():
    env = fiatlux.Env("S05")
    env.reset(seed=1001)
    for action in actions():
        env.step(action)
    queue = iter(actions())
    played = fiatlux.evaluate(lambda _: next(queue), ["S05"], [1001], max_steps=STEPS)
    assert played.episodes[0]["state_digest"] == env.digest


def test_noise_has_the_same_size():
    def seen(make, noise):
        env = make(noise=noise)
        observed = [env.reset(seed=1000)[0]]
        for _ in range(30):
            observed.append(env.step(np.zeros(env.action_space.shape))[0])
        return {name: np.array([part[name] for part in observed]).reshape(31, -1) for name in observed[0]}

    def one(**settings):
        return fiatlux.Env("S05", **settings)

    def many(**settings):
        return fiatlux.VectorEnv("S05", 1, seeds=[1000], **settings)

    spread = []
    for make in (one, many):
        noisy, exact = seen(make, True), seen(make, False)
        spread.append({name: (noisy[name] - exact[name]).std() for name in noisy})
    for name, ours in spread[0].items():
        assert (ours == 0) == (spread[1][name] == 0), name
        assert 0.6 * ours <= spread[1][name] <= 1.6 * ours, name
    assert sum(size > 0 for size in spread[0].values()) == 6


def test_ranges_are_drawn_and_played_alike_by_the_service():
    ranges = {
        "gravity": (9.0, 9.5),
        "noise": (0.5, 2.0),
        "action_delay": (20, 40),
        "friction": {"floor": (0.5, 0.6)},
        "thing_mass": {"ladder": (1.5, 2.0)},
    }
    env = fiatlux.Env("S05", ranges=ranges)
    drawn = env.reset(seed=1001)[1]["drawn"]["varied"]
    assert sorted(drawn) == ["action_delay", "friction.floor", "gravity", "noise", "thing_mass.ladder"]
    assert 9.0 <= drawn["gravity"] <= 9.5 and drawn["action_delay"] in (20, 40)
    for action in actions():
        env.step(action)
    queue = iter(actions())
    played = fiatlux.evaluate(lambda _: next(queue), ["S05"], [1001], max_steps=STEPS, ranges=ranges)
    assert played.episodes[0]["state_digest"] == env.digest
    assert env.reset(seed=1001, options={"episode": 1})[1]["drawn"]["varied"] != drawn


@pytest.mark.parametrize(
    "ranges",
    [
        {"robot_mass": (1.2, 1.2)},
        {"gains": (0.7, 0.7)},
        {"gravity": (9.0, 9.0)},
        {"floor_friction": (0.5, 0.5)},
        {"hand_friction": (0.6, 0.6)},
        {"friction": {"ladder": (0.5, 0.5)}},
        {"thing_mass": {"fresh_bulb": (1.2, 1.2)}},
        "real",
    ],
)
def test_a_range_has_one_name_and_one_meaning_in_env_and_vector(ranges):
    settings = {"sensors": ["proprioception"], "noise": ranges == "real"}
    plain = {"sensors": ["proprioception"], "noise": False}
    env, bare = fiatlux.Env("S08", ranges=ranges, **settings), fiatlux.Env("S08", **plain)
    worlds = fiatlux.VectorEnv("S08", 1, seeds=[1000], episodes=1, variations=1, ranges=ranges, **settings)
    drawn, (_, info) = env.reset(seed=1000)[1]["drawn"]["varied"], worlds.reset()
    bare.reset(seed=1000)
    if ranges == "real":
        assert set(drawn) <= set(info["drawn"])
        return
    name, value = next(iter(drawn.items()))
    assert info["drawn"][name].tolist() == [value]
    for action in actions():
        for each in (env, bare):
            each.step(action)
        worlds.step(action[None])
        for name, part in env.row().items():
            np.testing.assert_allclose(worlds.row(0)[name], part, rtol=1e-6, atol=1e-6, err_msg=name)
    differs = any(not np.array_equal(part, bare.row()[name]) for name, part in env.row().items())
    assert differs == (not {"hand_friction", "friction.ladder"} & set(drawn)), "nothing touches the ladder here"


@pytest.mark.parametrize(
    "settings, words",
    [
        ({"ranges": {"wind": (0, 1)}}, "ranges: 'wind' has no range"),
        ({"ranges": {"gravity": (10, 9)}}, "ranges: gravity is from 10 to 9"),
        (
            {"ranges": {"mass": (0.9, 1.1)}},
            "mass is for vectors of worlds alone; .* one factor for all bodies: robot_mass",
        ),
        ({"ranges": {"stiffness": (0.9, 1.1)}}, "stiffness is for vectors .* one factor for all drives: gains"),
        ({"ranges": {"light": True}}, "light is for vectors of worlds alone; every episode draws its light"),
        ({"ranges": {"gravity": 9.8}}, "ranges: gravity is 9.8; give"),
        ({"ranges": {"noise": (0.5, 2)}, "noise": False}, "noise=False; choose one"),
        ({"ranges": {"action_delay": (0, 40)}, "action_delay": 20}, "choose one of the two"),
    ],
)
def test_ranges_that_cannot_be_drawn_from_are_refused(settings, words):
    with pytest.raises(ValueError, match=words):
        fiatlux.Env("S05", **settings)
