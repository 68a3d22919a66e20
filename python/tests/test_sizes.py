"""Sizes and whole numbers from outside: what is too large is refused by name, and the interpreter lives."""

import fiatlux
import numpy as np
import pytest
from fiatlux._numbers import seeds_of

HUGE = 10**12


@pytest.mark.parametrize(
    ("settings", "match"),
    [
        ({"num_envs": HUGE}, "num_envs is 1000000000000; give 1 to 1048576"),
        ({"num_envs": -1}, "num_envs is -1"),
        ({"num_envs": 2.5}, "num_envs is 2.5; give a whole number"),
        ({"num_threads": HUGE}, "num_threads is 1000000000000; give 1 to 1024"),
        ({"variations": HUGE}, "variations is 1000000000000"),
        ({"variations": 0}, "variations is 0"),
        ({"seed": -1}, "seed is -1"),
        ({"seed": 2**64}, "seed is 18446744073709551616"),
        ({"seed": True}, "seed is True; give a whole number"),
        ({"disturbances": {"pushes": {"interval_s": (0, 1e12)}}}, "pushes.interval_s"),
        ({"disturbances": {"wrenches": {"force_n": 1e300}}}, "wrenches.force_n"),
        ({"ranges": {"mass": (1e300, 1e308)}}, "mass"),
        ({"ranges": {"mass": (np.nan, 1.0)}}, "mass"),
        ({"ranges": {"com_shift_m": 1e300}}, "com_shift_m"),
        ({"ranges": {"stiffness": (1.0, np.inf)}}, "stiffness"),
        ({"ranges": {"floor_friction": (-1.0, 1.0)}}, "friction"),
    ],
)
@pytest.mark.parametrize("make", [fiatlux.WalkingVectorEnv, lambda **settings: fiatlux.VectorEnv("S05", **settings)])
def test_vectors(make, settings, match):
    with pytest.raises(ValueError, match=match):
        make(**{"num_envs": 1, **settings})


@pytest.mark.parametrize(
    ("settings", "match"),
    [
        ({"frames": HUGE}, "frames is 1000000000000; give 1 to 1000"),
        ({"horizon_steps": 0}, "horizon_steps is 0"),
        ({"horizon_steps": 2**64}, "horizon_steps is"),
        ({"load_kg": 1e12}, "a load and a force"),
        ({"height": (0.5, np.inf)}, "ranges of commands"),
        ({"arm_range": 1e12}, "arm_range is"),
    ],
)
def test_walks(settings, match):
    with pytest.raises(ValueError, match=match):
        fiatlux.WalkingVectorEnv(1, **settings)


def test_tasks():
    for settings, match in [
        ({"seeds": range(HUGE)}, "seeds names more rooms than num_envs, which is 1"),
        ({"seeds": []}, "seeds is 0; give at least one"),
        ({"seeds": [True]}, "seeds is True"),
        ({"seeds": "1000"}, "seeds is '1000'; give a list"),
        ({"seeds": 1000}, "seeds is 1000; give a list"),
        ({"episodes": HUGE}, "episodes is 1000000000000; give 1 to 100000"),
        (
            {"episodes": 2, "variations": 60_000, "ranges": {"mass": (0.9, 1.1)}},
            "variations is 60000; with 2 starts, give at most",
        ),
    ]:
        with pytest.raises(ValueError, match=match):
            fiatlux.VectorEnv("S05", 1, **{"seeds": [1000], **settings})


@pytest.mark.parametrize(
    "size", [(100_000, 100_000), (0, 64), (64, 4097), (HUGE, HUGE), (2**32 + 64, 64), (64,), 64, (64, 6.5)]
)
def test_pictures(size):
    for make in (
        lambda: fiatlux.Env("S05", sensors=["camera"], image_size=size),
        lambda: fiatlux.Env("S05", render_mode="rgb_array", render_size=size),
        lambda: fiatlux.VectorEnv("S05", 1, sensors=["camera"], image_size=size),
        lambda: fiatlux.evaluate(lambda _: np.zeros(53), ["S05"], [0], sensors=["camera"], image_size=size),
    ):
        with pytest.raises(ValueError, match="(image|render)_size is "):
            make()


def test_a_vector_that_no_memory_holds():
    with pytest.raises(MemoryError, match="num_envs: no memory for 1048576 worlds"):
        fiatlux.VectorEnv("S05", 2**20, seeds=[1000], sensors=["camera"], image_size=(4096, 4096))


def test_one_rule_for_seeds():
    env, worlds = fiatlux.Env("S05"), fiatlux.VectorEnv("S05", 1, seeds=np.arange(1000, 1001), seed=np.int64(1))
    for seed in (np.int64(3), np.uint8(3), 3):
        info = env.reset(seed=seed, options={"episode": np.int32(1)})[1]
        assert (info["seed"], info["episode"]) == (3, 1)
        worlds.reset(seed=seed)

    def zero(_):
        return np.zeros(53)

    played = fiatlux.evaluate(zero, ["S05"], np.arange(2), max_steps=2)
    assert [episode["seed"] for episode in played.episodes] == [0, 1]
    calls = (
        lambda seed: env.reset(seed=seed),
        lambda seed: env.reset(options={"episode": seed}),
        lambda seed: worlds.reset(seed=seed),
        lambda seed: fiatlux.VectorEnv("S05", 1, seeds=[seed]),
        lambda seed: fiatlux.evaluate(zero, ["S05"], [seed], max_steps=2),
    )
    for seed in (True, np.True_, 1.0, "1", -1, 2**64):
        for call in calls:
            with pytest.raises(ValueError, match="(seed|seeds|episode) is .*; give"):
                call(seed)


def test_rooms_are_drawn_afresh_and_stay_drawn(tmp_path):
    file = tmp_path / "out/seeds.txt"
    drawn = seeds_of("fresh:8", record=file)
    assert len(set(drawn)) == 8 and all(100_000 <= seed < 2**32 for seed in drawn)
    assert seeds_of("fresh:8", record=file) == drawn == sorted(map(int, file.read_text().split()))
    assert seeds_of("fresh:8") != drawn
    assert seeds_of("0..2,7") == [0, 1, 2, 7]
    for text, message in [("fresh:0", "draws no rooms"), ("x", "is not a seed")]:
        with pytest.raises(ValueError, match=message):
            seeds_of(text)
    with pytest.raises(OSError, match="other rooms than fresh:3"):
        seeds_of("fresh:3", record=file)
    # Training worlds take numbers alone.
    with pytest.raises(ValueError, match="seeds is "):
        seeds_of("fresh:2", worlds=2)
