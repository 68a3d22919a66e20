"""Depth and segmentation in environments: the same numbers in one environment and in a vector, with names for labels."""

import fiatlux
import numpy as np

SENSORS = ["proprioception", "depth", "segmentation", "chest_depth", "chest_segmentation"]


def test_channels_have_metres_and_names():
    env = fiatlux.Env("S06", sensors=SENSORS, image_size=(32, 24), observation="dict")
    observation, _ = env.reset(seed=3)
    assert observation in env.observation_space
    depth, labels = observation["depth"], observation["segmentation"]
    assert depth.shape == labels.shape == (24, 32)
    assert depth.dtype == np.float32 and labels.dtype == np.uint8
    assert ((depth > 0) == (labels > 0)).all()
    names = fiatlux.segments()
    seen = {names[label] for label in np.unique(labels) if label}
    assert {"floor", "crate"} <= seen
    assert set(names) == set(range(1, len(names) + 1))


def test_a_vector_sees_what_an_environment_sees():
    env = fiatlux.Env("S06", sensors=SENSORS, image_size=(32, 24), observation="dict")
    worlds = fiatlux.VectorEnv(
        "S06", 2, sensors=SENSORS, image_size=(32, 24), observation="dict", seeds=[3, 4], episodes=1
    )
    alone, _ = env.reset(seed=3)
    together, _ = worlds.reset()
    for name in SENSORS[1:]:
        np.testing.assert_array_equal(together[name][0], alone[name])
