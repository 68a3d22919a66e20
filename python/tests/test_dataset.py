"""Tests which action a frame of a data set has. `extras/test_lerobot.py` writes real data sets."""

import importlib.util
import pathlib
import runpy

import fiatlux
import numpy as np
import pytest
from fiatlux import dataset, lerobot, train_lerobot
from fiatlux.dataset import _commands, _features, _frames
from fiatlux.train_lerobot import MAX_PAUSE, main, shortened

ROWS, JOINTS = 8, 3
TERMS = ["base_height", "joint_position"]


class Recorded(dict):
    """An episode as `fiatlux.Bag` shows it, of a session that delays actions by `delay` steps; `answered` is the step of the
    observation that each recorded action answers. Row k has the numbers 10 k, the action sent in step k the numbers k."""

    is_whole = True

    def __init__(self, delay=0, answered=range(ROWS), commands="chunk"):
        sent = np.arange(ROWS, dtype=float)
        # The staged posture acts until the first action does.
        acted = np.concatenate((np.full(delay + 1, -1.0), sent[: ROWS - delay]))
        self.header = {
            "request": {"action_delay_ms": 20 * delay},
            **{name: "x" for name in ("policy", "task", "robot", "gains", "reward", "instruction")},
            **{
                "episode_protocol": "strict",
                "seed": 1,
                "episode": 0,
                "joint_names": list("abc"),
                "domain_sample": {"mass": 1.0},
            },
        }
        self.result = {"strict": {"success": True, "gate_progress": 1.0}}
        row = 10.0 * np.arange(ROWS + 1)
        seven = np.repeat(sent[:, None], 7, axis=1)
        said = {
            "chunk": {
                "action.chunk.values": seven,
                "action.chunk.keys": [["navigate:3", "height:1", "torso:3"]] * ROWS,
            },
            "whole_body": {
                f"action.whole_body.{name}": sent for name in ("vx", "vy", "wz", "height", "roll", "pitch", "yaw")
            },
            "some": {
                f"action.whole_body.{name}": sent[1:] for name in ("vx", "vy", "wz", "height", "roll", "pitch", "yaw")
            }
            | {"action.whole_body.vx.rows": np.arange(1, ROWS)},
            None: {},
        }[commands]
        super().__init__(
            {
                "/state": {"step": np.arange(ROWS + 1), "action": np.repeat(acted[:, None], JOINTS, axis=1)},
                "/observation": {
                    "proprioception.base_height": row,
                    "proprioception.joint_position": np.repeat(row[:, None], JOINTS, axis=1),
                },
                "/action": {"action.step": np.array(list(answered), np.uint64), **said},
                "/reward": {"total": np.ones(ROWS), "terms.gate.reward": np.ones(ROWS)},
                "/camera": {},
            }
        )

    def channels(self):
        return {}


def column(bag, name, action="joints", stride=1):
    return [float(frame[name][0]) for frame in _frames(bag, TERMS, action, stride)]


@pytest.mark.parametrize("delay", [0, 2])
def test_a_frame_has_the_action_that_acted_and_its_age(delay):
    bag = Recorded(delay)
    assert column(bag, "observation.state") == [10.0 * row for row in range(ROWS)]
    assert column(bag, "action") == [row - delay if row >= delay else -1.0 for row in range(ROWS)]
    assert column(bag, "next.action_delay_s") == pytest.approx([0.02 * delay] * ROWS)


@pytest.mark.parametrize("commands", ["chunk", "whole_body"])
def test_a_frame_has_the_command_that_acted(commands):
    bag = Recorded(2, commands=commands)
    # Nothing that was commanded acts in the first two steps.
    assert column(bag, "observation.state", "command") == [10.0 * row for row in range(2, ROWS)]
    assert column(bag, "action", "command") == list(range(ROWS - 2))
    slow = list(_frames(bag, TERMS, "command", 4))
    assert [float(frame["action"][0]) for frame in slow] == [0, 4] and [
        float(frame["next.reward"][0]) for frame in slow
    ] == [4, 2]


def test_in_real_time_an_action_that_holds_gets_older():
    # Steps 3 and 4 hold the action that answers observation 2; the last one was sent ahead.
    answered = [0, 1, 2, 2, 2, 5, 6, 9]
    assert column(Recorded(0, answered), "next.action_delay_s") == pytest.approx([0, 0, 0, 0.02, 0.04, 0, 0, 0])
    assert column(Recorded(1, answered), "next.action_delay_s") == pytest.approx(
        [0.02, 0.02, 0.02, 0.02, 0.04, 0.06, 0.02, 0.02]
    )


def test_commands_that_are_missing_are_refused(tmp_path):
    assert _commands(Recorded(commands="some")) is None
    with pytest.raises(ValueError, match="no command with every action"):
        _features(Recorded(commands=None), tmp_path, TERMS, "command", "image")
    with pytest.raises(ValueError, match="ended before its first command acted"):
        _features(Recorded(ROWS), tmp_path, TERMS, "command", "image")


def test_the_command_says_what_it_needs(capsys):
    """The launcher asks this before it records anything."""
    if importlib.util.find_spec("lerobot") is None:
        assert lerobot.main(["--check"]) == 1
        assert "its extra lerobot, but" in capsys.readouterr().err
    with pytest.raises(SystemExit):
        lerobot.main([])
    assert "name bags" in capsys.readouterr().err


def test_long_pauses_are_shortened():
    """A pause is cut to its first steps; one in which the robot walks with everything else at rest is none."""
    actions = np.zeros((200, 9), np.float32)
    actions[50:100, 0] = 0.2
    # A target that moves by 0.02 rad a step, then rests until the end.
    actions[150:, 8] = 0.02 * np.minimum(np.arange(50), 20)
    kept = shortened(actions)
    still = np.setdiff1d(np.arange(200), kept)
    assert set(range(50, 100)) <= set(kept) and set(range(150, 170)) <= set(kept) and kept[-1] == 199
    # Steps are kept after the start, after the last step that walks, and after the last one whose row moves.
    assert kept[MAX_PAUSE - 1] == MAX_PAUSE - 1 and kept[MAX_PAUSE] > MAX_PAUSE
    assert 99 + MAX_PAUSE in kept and 100 + MAX_PAUSE in still and 198 in still
    np.testing.assert_array_equal(shortened(actions[:1]), [0])


def test_tasks_with_other_terms_make_one_set():
    bag = Recorded()
    frames = list(_frames(bag, TERMS, "joints", 1, ["gate", "walk"], ["mass", "friction"]))
    assert frames[0]["next.reward_terms"].tolist() == [1.0, 0.0]
    assert frames[0]["episode.conditions"][0] == 1.0 and np.isnan(frames[0]["episode.conditions"][1])


def test_rows_without_a_command_are_refused_by_task():
    bag = Recorded(commands="some")
    bag.header["task"] = "S02"
    with pytest.raises(ValueError, match=f"no command with every action: S02 by x has one with {ROWS - 1} of {ROWS}"):
        _features(bag, "bag", TERMS, "command", "image")


@pytest.mark.parametrize("commands, having", [("some", ROWS - 1), (None, 0)])
def test_act_is_not_trained_on_rows_without_a_command(monkeypatch, commands, having):
    monkeypatch.setattr(train_lerobot, "Bag", lambda path: Recorded(commands=commands))
    with pytest.raises(SystemExit, match=f"a.mcap has no command with every action: x by x has one with {having} of"):
        train_lerobot.episode(pathlib.Path("a.mcap"))


@pytest.mark.parametrize(
    "seed, purpose", [(3, "the published protocol"), (64, "comparisons"), (100_000, "drawn afresh")]
)
def test_a_policy_is_not_trained_in_rooms_for_judging(tmp_path, capsys, monkeypatch, seed, purpose):
    fiatlux.evaluate(lambda _: np.zeros(53), ["S08"], [seed], out=tmp_path / "run")
    with pytest.raises(SystemExit) as ended:
        main([str(tmp_path / "run"), "--out", str(tmp_path / "act")])
    assert ended.value.code == 2
    message = capsys.readouterr().err
    monkeypatch.setattr("sys.argv", ["bc.py", str(tmp_path / "run"), "1100", "1101"])
    with pytest.raises(ValueError) as refused:
        runpy.run_path(str(pathlib.Path(__file__).parents[1] / "examples" / "bc.py"), run_name="__main__")
    for said in (message, str(refused.value)):
        assert f"seed {seed} is for" in said and purpose in said and "use seeds 1000 to 99999" in said


def test_a_numpy_that_the_writer_cannot_use_is_named(monkeypatch):
    monkeypatch.setattr(np, "__version__", "2.4.6")
    with pytest.raises(ImportError, match="NumPy 2.4.6; pip install 'numpy<2.4'"):
        dataset.writer()
