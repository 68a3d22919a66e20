"""Depth and segmentation in environments: the same numbers in one environment and in a vector, with names for labels."""

import fiatlux
import numpy as np
from fiatlux import dataset

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


def test_a_camera_projects_a_point_to_where_it_is_seen():
    env = fiatlux.Env("S06", sensors=["segmentation", "right_wrist_camera"], image_size=(96, 64))
    observation, _ = env.reset(seed=3)
    camera, row = fiatlux.cameras(image_size=(96, 64))["segmentation"], env.row()
    kinematics = fiatlux.Kinematics("S06", seed=3)
    assert camera.matrix[0, 2] == 48.0 and camera.matrix[1, 2] == 32.0
    names = fiatlux.segments()
    (label,) = [label for label, name in names.items() if name == "old_bulb"]
    world = kinematics.poses(kinematics.state(row)[0], [camera.link])[0]
    eye = compose(world, camera.pose)
    bulb = row["old_bulb_pose"]
    at = turn(eye[3:]).T @ (bulb[:3] + turn(bulb[3:]) @ [0, 0, 0.15] - eye[:3])
    u, v, depth = camera.matrix @ [-at[1], -at[2], at[0]]
    rows, columns = np.nonzero(observation["segmentation"] == label)
    assert len(rows) > 10
    np.testing.assert_allclose([u / depth, v / depth], [columns.mean() + 0.5, rows.mean() + 0.5], atol=6)
    assert set(fiatlux.cameras()) >= {"camera", "chest_camera", "left_wrist_camera", "right_wrist_camera"}
    assert observation["right_wrist_camera"].shape == (64, 96, 3)


def turn(quaternion):
    w, x, y, z = quaternion
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def compose(one, other):
    w, x, y, z = one[3:]
    a, b, c, d = other[3:]
    quaternion = [
        w * a - x * b - y * c - z * d,
        w * b + x * a + y * d - z * c,
        w * c - x * d + y * a + z * b,
        w * d + x * c - y * b + z * a,
    ]
    return np.concatenate([one[:3] + turn(one[3:]) @ other[:3], quaternion])


def test_a_vector_sees_what_an_environment_sees():
    env = fiatlux.Env("S06", sensors=SENSORS, image_size=(32, 24), observation="dict")
    worlds = fiatlux.VectorEnv(
        "S06", 2, sensors=SENSORS, image_size=(32, 24), observation="dict", seeds=[3, 4], episodes=1
    )
    alone, _ = env.reset(seed=3)
    together, _ = worlds.reset()
    for name in SENSORS[1:]:
        np.testing.assert_array_equal(together[name][0], alone[name])


def test_a_bag_and_a_data_set_have_channels_and_wrists(tmp_path):
    """Each picture and each channel of the bag is the environment's of that row, and a frame of a data set has the newest."""
    arrays, wrists = SENSORS[1:], ["left_wrist_camera", "right_wrist_camera"]
    env = fiatlux.Env("S05", sensors=["proprioception", *arrays, *wrists], image_size=(32, 24), observation="dict")
    observation, _ = env.reset(seed=1000)
    seen, ended = [observation], False
    while not ended:
        observation, _, terminated, truncated, _ = env.step(np.zeros(53))
        ended = terminated or truncated
        seen.append(observation)
    record = [f"{name}@10" for name in (*arrays, *wrists)]
    fiatlux.evaluate(lambda _: np.zeros(53), ["S05"], [1000], out=tmp_path, record=record, image_size=(32, 24))
    (path,) = tmp_path.rglob("*.mcap")
    bag = fiatlux.Bag(path)
    assert set(bag.channels()) == set(arrays) and set(bag.images()) == set(wrists)
    for name, views in (bag.channels() | bag.images()).items():
        assert list(views) == list(range(0, bag.steps + 1, 5)), name
        for row, view in views.items():
            assert view.dtype == seen[row][name].dtype, name
            np.testing.assert_array_equal(view, seen[row][name], err_msg=f"{name} in row {row}")
    features, _ = dataset._features(bag, path, ["base_height"], "joints", "image")
    frames = list(dataset._frames(bag, ["base_height"], "joints", 1))
    assert len(frames) == bag.steps
    for name in arrays:
        feature = features[f"observation.{name}"]
        assert (feature["dtype"], feature["shape"]) == (str(seen[0][name].dtype), (24 * 32,))
        assert feature["names"] == {"height": 24, "width": 32}
        np.testing.assert_array_equal(frames[9][f"observation.{name}"], seen[5][name].ravel())
    for name in wrists:
        assert features[f"observation.images.{name}"]["shape"] == (24, 32, 3)
        np.testing.assert_array_equal(frames[9][f"observation.images.{name}"], seen[5][name])
