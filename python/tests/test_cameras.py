"""Pictures as bytes from the simulator to the array, and pictures that vary."""

import fiatlux
import numpy as np
import pytest

SIZE = (32, 24)
ROOMS = {"seeds": [1000], "episodes": 1, "num_envs": 2, "num_threads": 1}
CAMERA = {"exposure": (-1.0, 1.0), "noise": (1.0, 4.0), "delay": (20, 40), "pattern": (0, 8)}


def vector(**settings):
    return fiatlux.VectorEnv(
        "S05", **{**ROOMS, "sensors": ["proprioception", "camera"], "image_size": SIZE, **settings}
    )


def test_a_picture_is_its_bytes():
    worlds = vector()
    observation, _ = worlds.reset(seed=3)
    picture = observation["camera"]
    assert picture.dtype == np.uint8 and picture.shape == (2, SIZE[1], SIZE[0], 3) and picture.base is not None
    assert worlds._observation.nbytes == 2 * (SIZE[0] * SIZE[1] * 3 + 4 * _numbers(observation))
    first = {name: part.copy() for name, part in observation.items()}
    flat = vector(observation="flat")
    numbers, _ = flat.reset(seed=3)
    field, shape = flat.fields["camera"]
    np.testing.assert_array_equal(numbers[:, field].reshape(2, *shape), picture)
    actions = np.full((2, 53), 0.3)
    later = worlds.step(actions)[0]
    for name, part in first.items():
        np.testing.assert_array_equal(observation[name], part)
    assert not np.array_equal(later["camera"], picture)


def _numbers(observation):
    """Numbers of a world that are not of its picture."""
    return sum(part[0].size for name, part in observation.items() if name != "camera")


def test_without_copies_the_next_step_overwrites_pictures():
    worlds = vector(copy=False)
    seen, _ = worlds.reset(seed=3)
    before = seen["camera"].copy()
    worlds.step(np.full((2, 53), 0.3))
    assert not np.array_equal(seen["camera"], before)


def test_the_last_pictures_of_episodes_are_returned():
    worlds = vector(horizon_steps=3, final_obs=True)
    worlds.reset(seed=3)
    for _ in range(3):
        before = worlds._observation
        observation, _, _, truncated, info = worlds.step(np.full((2, 53), 0.3))
    assert truncated.all() and info["_final_obs"].all()
    assert info["final_obs"]["camera"].any() and before is not worlds._observation
    assert not np.array_equal(info["final_obs"]["camera"], observation["camera"])


def test_pictures_vary_and_repeat():
    plain = fiatlux.Env("S05", sensors=["camera"], image_size=SIZE)
    expected, _ = plain.reset(seed=1000)
    seen = []
    for _ in range(2):
        env = fiatlux.Env("S05", sensors=["camera"], image_size=SIZE, ranges={"camera": CAMERA})
        observation, info = env.reset(seed=1000)
        assert sorted(info["drawn"]["varied"]) == sorted(f"camera.{name}" for name in CAMERA)
        pictures = [observation["camera"]] + [env.step(np.full(53, 0.3))[0]["camera"] for _ in range(4)]
        seen.append(pictures)
        digest = env.digest
    np.testing.assert_array_equal(seen[0], seen[1])
    assert not np.array_equal(seen[0][0], expected["camera"])
    for _ in range(4):
        plain.step(np.full(53, 0.3))
    # The scene is another one by its record, the rows are the same.
    assert plain.digest == digest


def test_worlds_draw_their_own():
    worlds = vector(ranges={"camera": CAMERA})
    observation, info = worlds.reset(seed=5)
    assert len(set(info["drawn"]["camera.exposure"])) == 2
    assert not np.array_equal(*observation["camera"])
    actions = np.full((2, 53), 0.3)
    worlds.step(actions)
    saved = worlds.save()
    expected = [worlds.step(actions)[0]["camera"] for _ in range(3)]
    worlds.restore(saved)
    np.testing.assert_array_equal([worlds.step(actions)[0]["camera"] for _ in range(3)], expected)
    with pytest.raises(ValueError, match=r"ranges: 'camera\.tilt' has no range"):
        vector(ranges={"camera": {"tilt": (0, 1)}})
    with pytest.raises(ValueError, match="camera"):
        fiatlux.WalkingVectorEnv(num_envs=1, ranges={"camera": CAMERA})


def test_features_in_whole_numbers():
    settings = {"sensors": ["features"], "image_size": (64, 64)}
    single, _ = fiatlux.Env("S05", **settings).reset(seed=1000)
    whole, _ = fiatlux.Env("S05", weights="int8", **settings).reset(seed=1000)
    one, other = single["camera_features"], whole["camera_features"]
    assert 0 < np.linalg.norm(one - other) < 0.02 * np.linalg.norm(one)


def test_the_second_look_is_asked_for_and_repeats():
    def seen(look):
        ranges = {"camera": {"look": (look, look)}}
        worlds = [vector(ranges=ranges), vector(ranges=ranges, num_threads=2)]
        pictures = [world.reset(seed=3)[0]["camera"].copy() for world in worlds]
        np.testing.assert_array_equal(*pictures)
        return pictures[0]

    plain = vector().reset(seed=3)[0]["camera"]
    np.testing.assert_array_equal(seen(1), plain)
    assert np.mean(seen(2) != plain) > 0.2
