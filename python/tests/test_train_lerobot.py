"""Tests which columns of a bag a policy of `train_lerobot` is trained on, and the mapping with which the bridge plays it.
`extras/test_lerobot.py` trains and serves one."""

import json
import pathlib

import fiatlux
import numpy as np
import pytest
from fiatlux import train_lerobot
from fiatlux._inputs import Inputs, picture_name, rows_back, sectors, sees_room, views
from fiatlux.serve_lerobot import _cameras
from fiatlux.train_lerobot import main, read

BRIDGE = pathlib.Path(__file__).parents[2] / "crates" / "bridge"
STEPS = 40
LEFT, RIGHT = ["L_thumb", "L_index"], ["R_thumb", "R_index", "R_middle"]
EVERYTHING = Inputs(("camera", "chest_camera"), True, 12, (10,), "both")


def pictures(value, every=5, size=(2, 3)):
    return {step: np.full((*size, 3), value + step, np.uint8) for step in range(0, STEPS + 1, every)}


def cloud(*hits):
    """Points of hits at these degrees of azimuth and ranges."""
    return np.array([[r * np.cos(np.radians(a)), r * np.sin(np.radians(a)), 0] for a, r in hits], np.float32).reshape(
        -1, 3
    )


class Recorded(dict):
    """An episode as `fiatlux.Bag` shows it. Row k has the numbers k, and joint j the target k + j / 100."""

    def __init__(self, forces=True, see_room=False, **others):
        joints = [f"joint_{index}" for index in range(29)] + LEFT + RIGHT
        rows, count = np.arange(STEPS + 1, dtype=float), len(joints)
        self.header = {"joint_names": joints, "sensors": [{"name": "lidar", "see_room": see_room}]}
        self.cameras = {"camera": pictures(0), "chest_camera": pictures(100)} | others
        body = ("vx", "vy", "wz", "height", "roll", "pitch", "yaw")
        three = ("base_angular_velocity", "projected_gravity", "base_linear_velocity")
        force = 3.0 * rows[:, None] - np.arange(4) * 15
        super().__init__(
            {
                "/state": {"step": rows, "joint_target": rows[:, None] + np.arange(count) / 100},
                "/action": {f"action.whole_body.{name}": rows[:-1] + 1 for name in body},
                "/observation": {
                    **{f"proprioception.{name}": np.repeat(rows[:, None], 3, axis=1) for name in three},
                    "proprioception.base_height": rows,
                    "proprioception.joint_position": np.repeat(rows[:, None], count, axis=1),
                    **({"hand_contact_force": force.astype(np.float32)} if forces else {}),
                },
            }
        )


@pytest.fixture
def bag(monkeypatch):
    """Puts an episode in the place of all bags."""

    def given(one):
        class Reader:
            def __new__(cls, path):
                return one

        monkeypatch.setattr(train_lerobot, "Bag", Reader)
        monkeypatch.setattr(train_lerobot.dataset, "_images", lambda _: one.cameras)
        scans = {step: cloud((0, 4), (90, 2 + step)) for step in range(0, STEPS, 5)}
        monkeypatch.setattr("fiatlux._inputs.scans_of", lambda _: getattr(one, "points", scans))
        return pathlib.Path("a.mcap")

    return given


@pytest.fixture(autouse=True)
def here(monkeypatch):
    """Episodes are read by this process, which has the bags above."""

    class Here:
        def __init__(self, workers):
            pass

        def __enter__(self):
            return self

        def __exit__(self, *_):
            pass

        map = staticmethod(map)

    monkeypatch.setattr(train_lerobot, "ProcessPoolExecutor", Here)


def test_by_default_the_head_camera_the_body_and_the_right_hand_are_read(bag):
    data = read([bag(Recorded())], 1)
    steps = list(range(0, STEPS, 5))
    assert set(data) == {"images", "state", "action", "at", "last"}
    assert data["images"].shape == (8, 2, 3, 3) and data["images"][:, 0, 0, 0].tolist() == steps
    # Angular velocity, gravity, velocity, height, joints.
    assert data["state"].shape == (8, 10 + 34) and (data["state"] == np.array(steps)[:, None]).all()
    # Commands, arms, right hand; row k + 1 has the target of action k.
    joints = np.array([*range(15, 29), 31, 32, 33]) / 100
    np.testing.assert_allclose(data["action"][0], [1] * 7 + [*(1 + joints)], rtol=1e-6)
    assert data["at"].tolist() == steps and set(data["last"]) == {STEPS - 1}


def test_both_cameras_are_channels_of_a_frame(bag):
    data = read([bag(Recorded())], 1, Inputs(("chest_camera", "camera")))
    assert data["images"].shape == (8, 2, 3, 6)
    assert data["images"][2, 0, 0].tolist() == [10] * 3 + [110] * 3
    assert read([bag(Recorded())], 1, Inputs(("chest_camera",)))["images"][2, 0, 0].tolist() == [110] * 3


def test_forces_and_sectors_follow_the_body_in_the_state(bag):
    state = read([bag(Recorded())], 1, Inputs(contacts=True, lidar=4))["state"]
    assert state.shape == (8, 44 + 4 + 4)
    # 30, 15, 0 and -15 N at step 10; forces beyond 20 N are no news.
    assert state[2, 44:48].tolist() == [20, 15, 0, -15] and state[0, 44:48].tolist() == [0, -15, -20, -20]
    # From behind by the left: ahead is the first of the third quarter, the right (+y of a LiDAR that hangs upside down) begins the last one.
    np.testing.assert_allclose(state[1, 48:], [10, 10, 4, 7], rtol=1e-6)


def test_pictures_of_the_past_begin_with_the_first_of_an_episode(bag):
    path = bag(Recorded())
    data = read([path, path], 1, Inputs(history=(3, 1)))
    past = [[0, 0], [0, 0], [0, 1], [0, 2], [1, 3], [2, 4], [3, 5], [4, 6]]
    assert data["past"].tolist() == past + [[8 + far, 8 + near] for far, near in past]
    assert len(data["images"]) == 16


def test_the_fingers_of_both_hands_follow_the_arms(bag):
    action = read([bag(Recorded())], 1, Inputs(hands="both"))["action"]
    joints = np.array([*range(15, 29), 29, 30, 31, 32, 33]) / 100
    np.testing.assert_allclose(action[0, 7:], 1 + joints, rtol=1e-6)


@pytest.mark.parametrize(
    "recorded, inputs, says",
    [
        ({"camera": {}}, Inputs(), "no pictures of the head camera; record with --record camera@10"),
        ({"chest_camera": {}}, EVERYTHING, "the chest camera; record with --record camera@10,chest_camera@10,lidar@10"),
        (
            {"chest_camera": pictures(0, 10)},
            Inputs(("camera", "chest_camera")),
            "no picture of the chest camera at step 5",
        ),
        ({"camera": pictures(0, 10)}, Inputs(history=(1,)), "no picture of the head camera at step 5"),
        ({"chest_camera": pictures(0, 5, (4, 4))}, Inputs(("camera", "chest_camera")), "several sizes"),
        ({"forces": False}, Inputs(contacts=True), "no forces on the hands at step 0; .* name hand_contact there"),
        (
            {"points": {0: cloud()}},
            Inputs(lidar=6),
            "no scan of the LiDAR at step 5; record with --record camera@10,lidar@10",
        ),
    ],
)
def test_what_a_bag_lacks_is_named(bag, recorded, inputs, says):
    points = recorded.pop("points", None)
    one = Recorded(**recorded)
    if points is not None:
        one.points = points
    with pytest.raises(SystemExit, match=f"a.mcap has {'' if says.startswith('no') else '.*'}{says}"):
        read([bag(one)], 1, inputs)


def test_bags_of_other_shapes_are_named(bag, monkeypatch):
    path, other = bag(Recorded()), Recorded(camera=pictures(0, 5, (4, 4)))
    monkeypatch.setattr(train_lerobot.dataset, "_images", lambda one: one.cameras)
    both = {"a.mcap": train_lerobot.Bag("a"), "b.mcap": other}
    monkeypatch.setattr(train_lerobot, "Bag", lambda path: both[str(path)])
    with pytest.raises(SystemExit, match=r"b.mcap has pictures of shape \[4, 4, 3\], and a.mcap of \[2, 3, 3\]"):
        read([path, pathlib.Path("b.mcap")], 1)


@pytest.mark.parametrize(
    "flags, says",
    [
        ("--cameras wrist", "--cameras is wrist; give camera or chest_camera"),
        ("--cameras camera camera", "each once"),
        ("--lidar 7", "--lidar is 7; give a number of sectors that divides 180"),
        ("--lidar -4", "--lidar is -4"),
        ("--lidar 360", "--lidar is 360"),
        ("--history 0.25", "--history is 0.25; give multiples of 0.1 s, from 0.1 to 20"),
        ("--history 0", "--history is 0;"),
        ("--history nan", "--history is nan"),
        ("--history 20.1", "--history is 20.1"),
        ("--history 1 1.0", "each once"),
        ("--history 1 2 3 4 5", "at most 4"),
        ("--hands left", "invalid choice: 'left'"),
        ("--chunk 401", "--chunk is 401; the bridge plays at most 400 rows"),
    ],
)
def test_options_out_of_range_are_refused(tmp_path, capsys, flags, says):
    with pytest.raises(SystemExit) as ended:
        main([str(tmp_path), "--out", str(tmp_path / "act"), *flags.split()])
    assert ended.value.code == 2 and says in capsys.readouterr().err


def test_bags_with_a_lidar_of_two_kinds_are_refused():
    assert sees_room([Recorded(see_room=True)]) and not sees_room([Recorded()])
    with pytest.raises(ValueError, match="in some bags it sees the room"):
        sees_room([Recorded(), Recorded(see_room=True)])


def test_sectors_are_those_of_the_bridge():
    """The same file tests `crates/bridge/src/lidar.rs`."""
    shared = json.loads((BRIDGE / "tests/lidar_sectors.json").read_text())
    elevation = {row: np.radians(50 * row / 31 - 25) for row, *_ in shared["hits"]}
    points = [
        distance
        * np.array(
            [np.cos(elevation[row]) * np.cos(turn), np.cos(elevation[row]) * np.sin(turn), np.sin(elevation[row])]
        )
        for row, column, distance in shared["hits"]
        for turn in [np.radians(2 * column - 180)]
    ]
    for count, expected in shared["sectors"].items():
        np.testing.assert_allclose(sectors(np.array(points, np.float32), int(count)), expected, rtol=1e-6)
    assert sectors(np.zeros((0, 3), np.float32), 3).tolist() == [10, 10, 10]


def test_recorded_scans_are_what_a_policy_sees(tmp_path):
    """A bag keeps points; their sectors are those of the ranges in the observation."""
    seen = []

    def policy(observation):
        seen.append(np.array(observation["lidar"]))
        return np.zeros(53)

    # It falls in about a second.
    fiatlux.evaluate(policy, ["S08"], [1000], out=tmp_path, sensors=["proprioception", "lidar"], record=["lidar@10"])
    scans = fiatlux.Bag(next(tmp_path.rglob("*.mcap"))).scans()
    assert list(scans)[:3] == [0, 5, 10] and len(scans[0]) > 1000
    for row, points in list(scans.items())[:10]:
        nearest = seen[row].reshape(32, 12, 15).min(axis=(0, 2))
        np.testing.assert_allclose(sectors(points, 12), nearest, rtol=1e-6)


def test_times_become_rows():
    assert rows_back([]) == () and rows_back([0.3, 1.0, 20]) == (200, 10, 3)


def test_the_mapping_of_the_defaults_is_the_shipped_one():
    shipped = (BRIDGE / "mappings/lerobot_g1_hand.toml").read_text().splitlines()
    assert Inputs().mapping((128, 128), 20).splitlines() == [line for line in shipped if not line.startswith("#")]


def test_the_mapping_of_all_options_is_one_that_the_bridge_reads():
    """`crates/bridge/src/mapping/tests.rs` reads this file."""
    written = Inputs(("camera", "chest_camera"), True, 12, (10, 3), "both").mapping((64, 48), 4, sees_room=True)
    assert written == (BRIDGE / "tests/written_mapping.toml").read_text()
    longest = Inputs(("camera", "chest_camera"), True, 180, (200, 199, 198, 197), "both")
    names = [
        longest.mapping(size, 4, sees_room=room).splitlines()[0]
        for size in ((128, 128), (64, 48))
        for room in (False, True)
    ]
    assert all(len(name) <= len('name = ""') + 64 for name in names) and len(set(names)) == 4
    assert Inputs().mapping((64, 48), 20).startswith('name = "lerobot_g1_hand-64x48"')


def test_small_deviations_are_not_blown_up():
    least = Inputs(contacts=True, lidar=4).least_std(44 + 12 + 4, 4)
    assert least.tolist() == pytest.approx([0.02] * 44 + [2] * 12 + [0.1] * 4)
    assert Inputs().least_std(44, 4).tolist() == pytest.approx([0.02] * 44)


def test_a_picture_is_named_by_its_views():
    assert picture_name(["camera"], [0]) == "camera" and views("camera") == [("camera", 0)]
    name = picture_name(["camera", "chest_camera"], [-10, 0])
    assert name == "camera@-10+camera+chest_camera@-10+chest_camera"
    assert views(name) == [("camera", -10), ("camera", 0), ("chest_camera", -10), ("chest_camera", 0)]
    for foreign in ("front", "front@-3+front", "camera+front", "camera@-0", "+", ""):
        assert views(foreign) == [(foreign, 0)]
    cameras, deltas = _cameras({"key": views(name)}, {"key": (3, 48, 256)})
    assert cameras == {"camera": (3, 48, 64), "chest_camera": (3, 48, 64)} and deltas == [-10, 0]
    assert _cameras({}, {}) == ({}, [0])


@pytest.mark.parametrize(
    "named, width, says",
    [
        (["camera@-10+camera"], 65, "does not divide into its 2 views"),
        (["camera+camera"], 64, "does not divide"),
        (["camera@-10+camera", "chest_camera"], 64, "of other times for each camera"),
    ],
)
def test_pictures_that_a_contract_cannot_name_are_refused(named, width, says):
    with pytest.raises(ValueError, match=says):
        _cameras({name: views(name) for name in named}, {name: (3, 48, width) for name in named})
