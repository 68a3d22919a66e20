"""Sensors with a rate of their own: the same pictures in an environment, a vector, a session and a bag; kept in copies."""

import copy
import pickle

import fiatlux
import numpy as np
import pytest

SENSORS = ["proprioception", "camera@10", "chest_camera@look"]
SIZE = (16, 16)


def environment(sensors=SENSORS, **settings):
    return fiatlux.Env("S05", sensors=sensors, image_size=SIZE, observation="dict", **settings)


def moves(steps, seed=0):
    return np.random.default_rng(seed).uniform(-0.3, 0.3, (steps, 53))


def assert_same(one, other):
    assert one.keys() == other.keys()
    for name in one:
        np.testing.assert_array_equal(one[name], other[name], name)


def test_a_field_keeps_the_last_picture_and_says_its_age():
    rated, full = environment(), environment(["proprioception", "camera", "chest_camera"])
    (seen, _), (fresh, _) = rated.reset(seed=1003), full.reset(seed=1003)
    assert set(seen) == set(fresh) | {"camera.age", "chest_camera.age"}
    kept, chest, looked = fresh["camera"], fresh["chest_camera"], 0
    for step, action in enumerate(moves(12), 1):
        seen, fresh = rated.step(action)[0], full.step(action)[0]
        if step == 7:
            seen, chest, looked = rated.look(["chest_camera"]), fresh["chest_camera"], step
        kept = fresh["camera"] if step % 5 == 0 else kept
        assert seen in rated.observation_space
        assert seen["camera"].dtype == np.uint8
        np.testing.assert_array_equal(seen["camera"], kept)
        np.testing.assert_array_equal(seen["chest_camera"], chest)
        np.testing.assert_allclose(
            [seen["camera.age"][0], seen["chest_camera.age"][0]], [step % 5 * 0.02, (step - looked) * 0.02]
        )
    assert (kept != full.reset(seed=1003)[0]["camera"]).any()
    with pytest.raises(ValueError, match="'lidar' is not a sensor of the observation.*camera@10"):
        rated.look(["lidar"])


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda thing: pickle.loads(pickle.dumps(thing))])
def test_a_copy_has_the_kept_picture(copied):
    env = environment()
    env.reset(seed=1003)
    for action in moves(8):
        env.step(action)
    env.look(["chest_camera"])
    before = env.step(moves(1)[0])[0]
    assert before["camera.age"] > 0 and before["chest_camera.age"] > 0
    other, saved = copied(env), env.save()
    went_on = [env.step(action)[0] for action in moves(9, 1)]
    for ours, action in zip(went_on, moves(9, 1)):
        assert_same(ours, other.step(action)[0])
    assert_same(env.restore(saved), before)
    for ours, action in zip(went_on, moves(9, 1)):
        assert_same(ours, env.step(action)[0])


def test_a_vector_keeps_what_an_environment_keeps():
    env = environment(["camera@10", "chest_camera@look", "lidar+room@25"])
    worlds = fiatlux.VectorEnv(
        "S05",
        2,
        sensors=["camera@10", "chest_camera@look", "lidar+room@25"],
        image_size=SIZE,
        seeds=[1003, 1004],
        episodes=1,
    )
    alone, _ = env.reset(seed=1003)
    together, _ = worlds.reset()
    for step, action in enumerate(moves(11)):
        assert_same(alone, {name: part[0] for name, part in together.items()})
        if step == 4:
            alone, together = env.look(["chest_camera"]), worlds.look(["chest_camera"], np.array([True, False]))
            assert_same(alone, {name: part[0] for name, part in together.items()})
            assert together["chest_camera.age"].ravel().tolist() == [0.0, np.float32(0.08)]
        alone, together = env.step(action)[0], worlds.step(np.stack([action, action]))[0]
    saved = worlds.save(0)
    assert_same(
        {
            name: part[1]
            for name, part in fiatlux.VectorEnv(
                "S05",
                2,
                sensors=["camera@10", "chest_camera@look", "lidar+room@25"],
                image_size=SIZE,
                seeds=[1003],
                episodes=1,
            )
            .restore(pickle.loads(pickle.dumps(saved)), np.array([True, True]))
            .items()
        },
        alone,
    )


class Looker:
    """Moves a little, and looks at step 6."""

    sensors = [*SENSORS, "goal", "right_wrist_camera@25"]

    def __init__(self, seen):
        self.seen = seen
        self.moves = iter(moves(1000))

    def look(self, observation):
        return ["chest_camera"] if round(float(observation["camera.age"][0]) * 50) == 1 else []

    def __call__(self, observation):
        self.seen.append({name: part.copy() for name, part in observation.items()})
        return next(self.moves) * 0.1


def test_a_session_has_the_same_fields_and_numbers(tmp_path):
    alone, together = [], []
    settings = {"image_size": SIZE, "end_on": ["time-out", "fall"]}
    fiatlux.evaluate(Looker(alone), ["S07"], [1003], max_steps=40, **settings)
    fiatlux.evaluate(Looker(together), ["S07"], [1003], out=tmp_path, record=["chest_camera"], **settings)
    assert len(together) >= len(alone) == 40
    for ours, theirs in zip(alone, together):
        assert_same(ours, theirs)
    assert {round(float(seen["chest_camera.age"][0]) * 50) for seen in alone} >= {0, 1, 4}
    (path,) = tmp_path.rglob("*.mcap")
    bag = fiatlux.Bag(path).observations(["proprioception"])
    np.testing.assert_array_equal(bag["joint_position"][:40], [seen["joint_position"] for seen in alone])


@pytest.mark.parametrize(
    ("sensors", "message"),
    [
        (["camera@30"], "nearest ones are 25.0000 and 50.0000"),
        (["camera@10", "camera@25"], "listed twice"),
        (["smell@10"], "'smell' is not a sensor"),
        (["camera+room"], "only lidar takes"),
        (["camera@often"], "is not a rate"),
    ],
)
def test_wrong_rates_are_refused(sensors, message):
    with pytest.raises(ValueError, match=message):
        environment(sensors)
    with pytest.raises(ValueError, match=message):
        fiatlux.VectorEnv("S05", 1, sensors=sensors)
