"""A student learns from the expert's labels, and its file plays what the student would."""

import dataclasses
import json
import multiprocessing
import os
import re
import subprocess
import time
from functools import partial
from pathlib import Path

import fiatlux
import numpy as np
import pytest

torch = pytest.importorskip("torch")
pytest.importorskip("safetensors")

from fiatlux.dagger import lessons, parts  # noqa: E402
from fiatlux.dagger.__main__ import load, main  # noqa: E402
from fiatlux.dagger.finds import IN_ROOM, ON_LADDER, Looks  # noqa: E402
from fiatlux.dagger.lessons import RANGES, SETTLES, SLEW, Bodies, Lesson, Memory, Phases, play  # noqa: E402
from fiatlux.dagger.network import WALKS, Network, Shape, export, grown  # noqa: E402
from fiatlux.dagger.rollouts import Rollouts  # noqa: E402
from fiatlux.whole_body import DEAD_ZONE  # noqa: E402

SMALL = [
    "--worlds",
    "2",
    "--steps",
    "60",
    "--updates",
    "3",
    "--batch",
    "8",
    "--picture",
    "32",
    "48",
    "--threads",
    "1",
]


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dagger") / "run"
    assert main(["train", "--tasks", "S05", "S09", "--out", str(folder), "--rounds", "1", *SMALL]) == 0
    return folder


def lesson(student=None, seed=1):
    shape = Shape(("S05",), cameras=("chest_camera",), picture=(32, 32))
    return play("S05", range(1000, 1002), 80, shape=shape, student=student, seed=seed, device="cpu", threads=2).lesson


def test_a_run_goes_on_after_the_rounds_that_it_finished(run, capsys):
    before = {path: path.stat().st_mtime_ns for path in run.rglob("*") if path.is_file()}
    # Bags change neither lessons nor training.
    assert main(["train", "--tasks", "S05", "S09", "--out", str(run), "--rounds", "1", "--bags", "3", *SMALL]) == 0
    assert capsys.readouterr().out == ""
    assert {path: path.stat().st_mtime_ns for path in run.rglob("*") if path.is_file()} == before
    _, record = load(run / "round-1.pt", "cpu")
    assert record["demonstrated"] == record["labelled"] == 2 * 2 * 60 // 5


@pytest.mark.parametrize(
    "other, message",
    [
        (
            ["--worlds", "3"],
            r"a run with --worlds \[2\], not \[3\]: repeat its settings, or name another folder with --out",
        ),
        (["--steps", "80"], "--steps 60, not 80"),
        (["--picture", "48", "48"], r"--picture \[32, 48\], not \[48, 48\]"),
        (["--blind", "--seed", "2"], "--seed 1, not 2; --blind False, not True"),
        (["--rounds", "60000"], "in 2 rooms each: training has 99000 rooms"),
        (["--worlds", "3", "4", "5"], "--worlds has 3 numbers for 2 tasks: give one, or one a task"),
        (["--steps", "20"], "nothing is learned of the first 25 steps"),
        (["--first-room", "64"], "--first-room 64 is for judging"),
        (["--shown", "S07"], "--shown S07 is not among --tasks"),
        (["--threads", "0"], "--threads 0: at least one core plays"),
        (["--bags", "-1"], "--bags -1: give 0 for none"),
    ],
)
def test_a_run_goes_on_by_its_own_settings_alone(run, capsys, other, message):
    with pytest.raises(SystemExit) as ended:
        main(["train", "--tasks", "S05", "S09", "--out", str(run), "--rounds", "1", *SMALL, *other])
    assert ended.value.code == 2 and re.search(message, capsys.readouterr().err)


def test_lessons_of_unknown_settings_are_left_alone(tmp_path, capsys):
    (tmp_path / "lessons-0-S05").mkdir()
    with pytest.raises(SystemExit) as ended:
        main(["train", "--tasks", "S05", "--out", str(tmp_path), *SMALL])
    assert ended.value.code == 2
    assert "has lessons but no settings.json" in capsys.readouterr().err


def test_lessons_repeat_to_the_bit_and_labels_are_the_teachers():
    first, again = lesson(), lesson()
    for name in ("pictures", "body", "place", "velocity", "goal"):
        np.testing.assert_array_equal(getattr(first, name), getattr(again, name))
    assert first.pictures.shape == (32, 1, 32, 32, 3) and first.pictures.std() > 10
    np.testing.assert_array_equal(first.back, np.tile(np.arange(16), 2))
    # It settles, then goes; while it stumbles, the teacher says something else than it does.
    assert first.stands[first.back < 5].all() and not first.stands[first.back > 10].all()
    np.testing.assert_array_equal(first.settles.astype(bool), first.back < SETTLES / 5)
    far = np.linalg.norm(first.goal, axis=1)
    assert ((far > 0.4) & (far < 9)).all()


def test_clean_rollouts_are_kept_as_bags_of_the_same_episodes(tmp_path, monkeypatch):
    # All episodes begin at the start that a recorded evaluation plays.
    monkeypatch.setattr(lessons, "STARTS", 1)
    shape = Shape(("S05",), cameras=("chest_camera",), picture=(16, 16))
    given = dict(rooms=range(1000, 1002), steps=1000, shape=shape, seed=1, threads=2, device="cpu")
    # What a lesson left that was stopped is not in its way.
    (tmp_path / "one").mkdir()
    (tmp_path / "one" / "RUN.toml").write_text("of another run")
    _, counts = lessons.part_of_lesson("S05", student=None, into=tmp_path / "one", bags=1, **given)
    (bag,) = (tmp_path / "one").rglob("*.mcap")
    assert counts["successes"] > 1 and fiatlux.Bag(bag).result["strict"]["success"]
    kept = play("S05", student=None, bags=2, **given).rollouts
    assert len(kept.kept) == 2 and all(len(actions) > 100 for actions in kept.kept.values())
    room, actions = next(iter(kept.kept.items()))
    kept.kept = {room: actions[1:]}
    with pytest.raises(
        RuntimeError, match=f"room {room} succeeded after {len(actions) - 1} steps in the lesson, and its bag"
    ):
        kept.record("S05", shape.robot, "other", tmp_path / "other")


def test_rollouts_are_of_the_first_start_and_few():
    rollouts = Rollouts([7, 8, 9], 5, 2, 2)
    for step in range(3):
        rollouts.step(np.full(3, step), np.full((3, 2), 10.0 * step))
    count, ended = np.full(3, 3), np.ones(3, bool)
    rollouts.end(np.array([1, 0, 0]), count, np.array([True, True, False]))
    assert list(rollouts.kept) == [8] and rollouts.kept[8][:, 0].tolist() == [0, 10, 20]
    rollouts.end(np.zeros(3), count - 1, ended)
    assert list(rollouts.kept) == [8, 7] and len(rollouts.kept[8]) == 3 and len(rollouts.kept[7]) == 2


def test_a_saved_lesson_is_the_same(tmp_path):
    first = lesson()
    first.save(tmp_path)
    read = Lesson.load(tmp_path)
    for name, numbers in vars(first).items():
        np.testing.assert_array_equal(getattr(read, name), numbers)


def test_a_blind_student_sees_no_picture():
    torch.manual_seed(0)
    one, place, back = np.arange(1), np.zeros((1, 3)), np.zeros(1, int)
    for blind in (True, False):
        network = Network(Shape(("S05",), cameras=("camera",), picture=(32, 32), blind=blind))
        memory, random = Memory(network.eval(), 1, "cpu"), np.random.default_rng(0)
        pictures = random.integers(0, 256, (2, 1, 1, 32, 32, 3), np.uint8)
        answers = []
        for picture in pictures:
            memory.look(one, picture, place, back)
            answers.append(memory.decide(one, np.zeros((1, 10), np.float32), place, back, -one, 0 * one, 0))
        assert np.array_equal(*answers) == blind


@pytest.fixture(scope="module")
def hands(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dagger") / "hands"
    assert main(["train", "--tasks", "S06", "S08", "--out", str(folder), "--rounds", "1", *SMALL]) == 0
    return folder


ALL = ["train", "--tasks", "S05", "S06", "S10", "S12", *SMALL, "--shown", "S06", "--ages", "0", "10"]


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """One network that walks, works with its hands and finds where it is on the ladder."""
    folder = tmp_path_factory.mktemp("dagger") / "whole"
    assert main([*ALL, "--out", str(folder), "--rounds", "1"]) == 0
    return folder


def test_one_network_learns_tasks_of_all_kinds(whole, tmp_path):
    network, record = load(whole / "round-1.pt", "cpu")
    shape = network.shape
    assert (
        shape.acts
        and shape.finds == ON_LADDER.finds
        and shape.says[-7:] == [("finds", name) for name in ON_LADDER.finds]
    )
    assert len(shape.reads) == network.head[0].in_features and len(shape.says) == network.last.out_features
    # The teacher shows S06 in both rounds; S12 is looked at once, and in S10 there is nothing to see before the robot is up.
    assert record["demonstrated"] == 2 * (60 // 5 + 2 * 60) and record["labelled"] == 2 * 60 // 5
    assert record["looks"] == 2 * 60 // 5 and set(record["errors"]) == {"x", "y", "heading", "wall"}
    walked = Lesson.load(whole / "lessons-0-S05-1000")
    assert walked.body.shape[1] == shape.sensed and (np.array(walked.phase) == -1).all() and not walked.moves.any()
    with pytest.raises(SystemExit, match="places are learned in S03, S04, S11, S12; name one of them"):
        main(["train", "--tasks", "S06", "S10", "--out", str(tmp_path / "other"), *SMALL])
    with pytest.raises(SystemExit, match="needs S06 or S08 among them, too"):
        main(["train", "--tasks", "S05", "S12", "--out", str(tmp_path), *SMALL])


def test_a_larger_network_begins_with_what_a_smaller_one_knows(whole, hands, tmp_path, capsys):
    small, large = load(hands / "round-1.pt", "cpu")[0], load(whole / "round-1.pt", "cpu")[0].shape
    large = dataclasses.replace(
        large, tasks=("S08", "S05", "S06"), phases=("Other", *reversed(small.shape.phases)), ages=(0, 50, 150, 200)
    )
    big = grown(small, large).eval()
    seen, states = torch.rand(5, 4, 2, 3, 48, 32), torch.randn(5, large.state)
    read, said = (
        [theirs.index(name) for name in own]
        for own, theirs in ((small.shape.reads, large.reads), (small.shape.says, large.says))
    )
    of_state = [place - len(large.reads) + large.state for place in read[-small.shape.state :]]

    def answer(network, pictures, states):
        embedded = network.encode(pictures.flatten(0, 1)).unflatten(0, pictures.shape[:2])
        return network.answer(network.decide(embedded, states)[0])

    with torch.no_grad():
        expected = answer(small, seen[:, :3], states[:, of_state])
        torch.testing.assert_close(answer(big, seen, states)[:, said], expected, atol=1e-4, rtol=1e-4)
    with pytest.raises(
        ValueError, match="has what the new one lacks: tasks S08; phases StepUp; name its --tasks, --ages"
    ):
        grown(small, dataclasses.replace(large, tasks=("S05", "S06"), phases=small.shape.phases[1:]))
    file = tmp_path / "hands.safetensors"
    export(small, file, {})
    with pytest.raises(
        SystemExit,
        match=r"--start .*hands.safetensors: the network has what the new one lacks: picture \(32, 48\); ages 50, 150; name",
    ):
        start = [*ALL, "--out", str(tmp_path / "run"), "--picture", "48", "48", "--start", str(file)]
        main(["train", "--tasks", "S06", "S08", "S05", *start[8:]])


def test_processes_make_the_same_parts(tmp_path, monkeypatch):
    monkeypatch.setattr(parts, "WORLDS", 1)
    for cores in ("1", "2"):
        run = ["train", "--tasks", "S05", "--rounds", "1", "--out", str(tmp_path / cores), *SMALL, "--threads", cores]
        assert main(run) == 0
    first, second = (load(tmp_path / cores / "round-1.pt", "cpu")[0].state_dict() for cores in "12")
    assert len(list((tmp_path / "2").glob("lessons-1-S05-*"))) == 2
    for name, numbers in first.items():
        assert torch.equal(numbers, second[name]), name


@dataclasses.dataclass
class Slept(parts.Columns):
    seconds: np.ndarray


def waits(seconds, threads):
    time.sleep(seconds)
    return Slept(np.array(seconds)), {"threads": threads}


def test_a_run_that_is_stopped_ends_its_processes(tmp_path, monkeypatch):
    work = [parts.Part(tmp_path / str(seconds), partial(waits, seconds)) for seconds in (0, 300, 301, 302)]

    def stops(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(parts, "print", stops, raising=False)
    began = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        parts.do_all(work, 2)
    # The pool's own thread may be the one that collects a child, which counts as active until then.
    until = time.monotonic() + 20
    while multiprocessing.active_children() and time.monotonic() < until:
        time.sleep(0.05)
    assert not multiprocessing.active_children() and time.monotonic() - began < 120
    assert [part.is_done for part in work] == [True, False, False, False]


@pytest.mark.parametrize("task, made", [("S09", "run"), ("S06", "hands"), ("S05", "whole"), ("S06", "whole")])
@pytest.mark.parametrize("blind", [False, True])
def test_the_file_plays_what_the_student_would(request, tmp_path, task, made, blind):
    program = os.environ.get("FIATLUX_TEST_PROGRAM")
    if program is None:
        pytest.skip("FIATLUX_TEST_PROGRAM names no program fiatlux")
    network, record = load(request.getfixturevalue(made) / "round-1.pt", "cpu")
    has_hands, first = task in lessons.PHASES, WALKS + network.shape.moves
    if blind:
        weights = network.state_dict()
        network = Network(dataclasses.replace(network.shape, blind=True)).eval()
        network.load_state_dict(weights)
    file, out, number = tmp_path / "sees.safetensors", tmp_path / "out", network.shape.tasks.index(task)
    if count := len(network.shape.phases):
        # After a few updates phases are so alike that rounding would choose, and so are standing and going: here the last phase is chosen in
        # the first step, and kept, and the robot goes.
        with torch.no_grad():
            network.last.bias[WALKS - 1] -= 0.5
            network.last.weight[first : first + count] = 0.0
            network.last.bias[first : first + count] = torch.arange(count) / 8
    export(network, file, record)
    settings = ["--tasks", task, "--seeds", "1003", "--record", "camera@10,chest_camera@10", "--end-on", "time-out"]
    played = [program, "evaluate", "--policy", f"see:{file}", "--out", str(out), *settings]
    subprocess.run(played, check=True, capture_output=True, timeout=600)
    (bag,) = (fiatlux.Bag(path) for path in out.rglob("*.mcap"))
    assert "see:sees.safetensors@" in json.dumps(bag.header)
    sensed = bag["/observation"]
    column = lambda name: np.reshape(sensed[name], (len(sensed["step"]), -1))  # noqa: E731
    body = np.concatenate([column(f"proprioception.{name}") for name in lessons.SENSED], 1)
    read = body
    if network.shape.joints:
        forces = column("hand_contact_force").reshape(len(body), -1, 3)
        touched = np.minimum(np.linalg.norm(forces, axis=2), lessons.MAX_TOUCH_N)
        read = np.concatenate([body, column("proprioception.joint_position"), touched], 1)
    targets = bag["/state"]["joint_target"]
    images, commands = bag.images(), bag.commands()
    memory, place, velocity, wanted = Memory(network, 1, "cpu"), np.zeros(3), np.zeros(3), np.zeros(3)
    phases = Phases(np.random.default_rng(0), 1)
    for step in range(min(400, len(commands))):
        numbers = body[step].astype(np.float64)
        if step:
            cos, sin = np.cos(place[2]), np.sin(place[2])
            ahead, left = numbers[6:8]
            place = place + 0.02 * np.array([cos * ahead - sin * left, sin * ahead + cos * left, numbers[2]])
        one, back = np.arange(1), np.array([step // 5])
        if step % 5 == 0:
            pictures = np.stack([images[camera][step] for camera in network.shape.cameras])[None]
            memory.look(one, pictures, place[None], back)
        if step % 5 == 0 or has_hands:
            since = step - phases.began
            answer = memory.decide(
                one, read[step][None].astype(np.float32), place[None], back, phases.now, since, number
            )[0]
            answer, chosen, _ = np.split(answer, [first, first + count])
            if has_hands:
                phases.choose(chosen[None].argmax(axis=1), np.array([step]))
            # Where it hardly prefers to stand or to go, rounding decides.
            assert abs(answer[3]) > 1e-3
            wanted = np.zeros(3) if answer[3] > 0 else np.clip(answer[:3], RANGES[:, 0], RANGES[:, 1])
        goes = (np.abs(wanted) >= DEAD_ZONE).any() and step >= SETTLES
        velocity = velocity + np.clip(wanted - velocity, -SLEW * 0.02, SLEW * 0.02) if goes else np.zeros(3)
        np.testing.assert_allclose(commands[step, :3], velocity, atol=2e-3, err_msg=str(step))
        if has_hands:
            np.testing.assert_allclose(commands[step, 3:], answer[4:8], atol=2e-3, err_msg=str(step))
            rates = 0.02 * np.repeat(lessons.RATES, (14, targets.shape[1] - 29))
            within = np.clip(answer[8:], *fiatlux.Kinematics().joint_limits[15:].T)
            moved = targets[step, 15:] + np.clip(within - targets[step, 15:], -rates, rates)
            np.testing.assert_allclose(targets[step + 1, 15:], moved, atol=2e-3, err_msg=str(step))


def test_velocities_set_in_gently_and_stop_at_once():
    bodies = Bodies(1, 1)
    sensed = np.zeros((1, 10 + 2 * 53))
    sensed[0, 5], sensed[0, 9] = -1.0, 0.75
    ahead, others = np.array([[0.5, 0.0, 0.0]]), np.ones((1, 53))
    bodies.targets(sensed, ahead, np.array([SETTLES - 1]), others)
    assert (bodies.velocity == 0).all()
    targets = bodies.targets(sensed, ahead, np.array([SETTLES]), others)
    np.testing.assert_allclose(bodies.velocity, [[0.012, 0.0, 0.0]])
    assert (targets[0, 15:] == 1.0).all() and not (targets[0, :15] == 1.0).any()
    bodies.targets(sensed, 0 * ahead, np.array([SETTLES + 1]), others)
    assert (bodies.velocity == 0).all()


def test_a_run_of_counted_updates_follows_from_its_seed(tmp_path, capsys):
    counted = ["--tasks", "S05", "--rounds", "1", *SMALL, "--updates", "6", "--takes-over", "0.5"]
    weights = []
    for name in ("one", "other"):
        assert main(["train", "--out", str(tmp_path / name), *counted]) == 0
        weights.append(load(tmp_path / name / "round-1.pt", "cpu")[0].state_dict())
    for name, numbers in weights[0].items():
        assert torch.equal(numbers, weights[1][name]), name
    assert "none ended in 2 of 2 worlds" in capsys.readouterr().out
    curve = (tmp_path / "one" / "curve-1.csv").read_text().splitlines()
    assert curve[0] == "step,velocity,stands,goal,moves,phases,finds" and len(curve) == 7


def test_the_teacher_takes_over_where_it_is_asked_to():
    shape = Shape(("S05",), cameras=("chest_camera",), picture=(32, 32))
    torch.manual_seed(0)
    student, settings = Network(shape).eval(), dict(shape=shape, seed=1, device="cpu", threads=2)
    given_up, taken = (
        play("S05", range(1000, 1004), 200, student=student, takes_over=share, **settings).lesson for share in (0, 1)
    )
    # It walks at a time drawn from the first 200 steps on: what the robot does then is what the teacher says.
    assert np.abs(taken.body[:, 6] - given_up.body[:, 6]).max() > 0.1


def test_the_phase_of_a_lesson_is_the_teachers_or_a_little_behind():
    phases, random = Phases(np.random.default_rng(3), 200), np.random.default_rng(4)
    taught, behind = np.zeros(200, int), np.zeros(200, int)
    most, late = 0, 0
    for step in range(400):
        taught = np.where(random.random(200) < 0.01, taught + 1, taught)
        phases.follow(taught, np.full(200, step))
        behind = np.where(phases.now == taught, 0, behind + 1)
        most, late = max(most, behind.max()), late + (behind > 0).mean()
        assert (phases.now <= taught).all() and (phases.began <= step).all()
    assert 20 <= most <= 60 and 5 < late < 60
    phases.reset(np.arange(200) < 100)
    assert (phases.now[:100] == -1).all() and (phases.now[100:] >= 0).all()


def test_hands_choose_their_phase_and_read_it_in_the_next_decision(hands):
    network, _ = load(hands / "round-1.pt", "cpu")
    shape, back = network.shape, np.zeros(1, int)
    assert shape.phases[:2] == ("StepUp", "Settle") and "Close" in shape.phases
    body, place = np.zeros((1, shape.sensed)), np.zeros((1, 3))
    state = lambda phase, since: lessons.state_of(  # noqa: E731
        shape, body, place, [place, place], np.array([phase]), np.array([since]), back
    )[0]
    first = shape.measured
    assert len(state(-1, 0)) == shape.state and not state(-1, 0)[first : first + len(shape.phases) + 4].any()
    assert state(1, 50)[first : first + len(shape.phases)].argmax() == 1
    np.testing.assert_allclose(state(1, 50)[first + len(shape.phases) :][:4], [1, 50 / 75, 0.25, 0.1], rtol=1e-6)
    lesson = Lesson.load(hands / "lessons-0-S06-1000")
    # The teacher drove: what stands for the student's phase is the teacher's of the step before, or an older one.
    begins = np.flatnonzero(np.array(lesson.since) == 0)
    assert (np.array(lesson.phase)[begins] == -1).all()
    assert (np.array(lesson.does) >= 0).all()


@pytest.mark.parametrize("tasks", [("S05", "S09"), ("S06", "S08")])
def test_a_file_goes_on_as_the_network_that_it_was_written_from(tmp_path, tasks):
    torch.manual_seed(0)
    before = Network(lessons.shape_of(tasks, picture=(32, 32))).eval()
    shape = before.shape
    before.normalise(torch.randn(50, shape.state) * 3 + 1, torch.randn(50, shape.moves) * 2 - 1)
    file = tmp_path / "see.safetensors"
    export(before, file, {"minutes": 1.0})
    after, record = load(file, "cpu")
    assert after.shape == shape and record == {"minutes": 1.0}
    states, seen = torch.randn(5, shape.state), torch.rand(5, len(shape.ages), len(shape.cameras), 3, 32, 32)

    def answer(network):
        embedded = network.encode(seen.flatten(0, 1)).unflatten(0, seen.shape[:2])
        return network.answer(network.decide(embedded, states)[0])

    with torch.no_grad():
        torch.testing.assert_close(answer(after), answer(before), atol=2e-2, rtol=2e-2)
        was = answer(after)
        # Other scales change what it is trained in, and nothing of what it says.
        after.normalise(torch.randn(50, shape.state) - 2, torch.randn(50, shape.moves) * 0.3, keeps_answers=True)
        torch.testing.assert_close(answer(after), was, atol=1e-4, rtol=1e-3)
        assert not torch.equal(after.mean, before.mean)


def test_a_start_that_is_no_network_is_refused(tmp_path):
    file = tmp_path / "other.safetensors"
    safetensors_torch = pytest.importorskip("safetensors.torch")
    safetensors_torch.save_file({"a": torch.zeros(1)}, file)
    with pytest.raises(ValueError, match="has the format None; 'fiatlux-see/1' is read"):
        load(file, "cpu")


def test_a_start_that_lacks_a_layer_is_refused(tmp_path):
    from safetensors import safe_open
    from safetensors.torch import save_file

    whole, part = tmp_path / "see.safetensors", tmp_path / "part.safetensors"
    export(Network(Shape(("S05",), picture=(32, 32))), whole, {})
    with safe_open(whole, "pt") as opened:
        tensors = {name: opened.get_tensor(name) for name in opened.keys() if name != "head.1.bias"}
        save_file(tensors, part, metadata=opened.metadata())
    with pytest.raises(ValueError, match="does not fit its own contract: 'head.1.bias'"):
        load(part, "cpu")


FIND = ["find", "--tasks", "S12", "S11", *SMALL]


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    folder = tmp_path_factory.mktemp("dagger") / "found"
    assert main([*FIND, "--out", str(folder)]) == 0
    return folder


def test_it_learns_where_the_robot_is_from_looks_that_it_keeps(found, tmp_path, capsys):
    looks = Looks.load(found / "looks-S12-1000")
    # Worlds begin on the platform, and their pictures are as many as the bodies that took them.
    assert len(looks.place) == len(looks.pictures) == len(looks.body) == 2 * 60 // 5
    assert np.abs(looks.place).max(axis=0) == pytest.approx([0.05, 0.05, 0.1], abs=0.1)
    assert set(looks.room) == {1000, 1001} and set(np.unique(looks.wall)) <= {0.0, 1.0}
    before = {path: path.stat().st_mtime_ns for path in found.rglob("*.npy")}
    assert main([*FIND, "--out", str(found)]) == 0
    assert {path: path.stat().st_mtime_ns for path in found.rglob("*.npy")} == before
    assert "kept out" in capsys.readouterr().out
    network, record = load(found / "found.pt", "cpu")
    assert record["looks"] == 2 * len(looks.place) and set(record["errors"]) == {"x", "y", "heading", "wall"}
    assert network.shape.finds == ON_LADDER.finds and network.shape.state == network.shape.measured
    assert main(["export", str(found / "found.pt"), str(tmp_path / "found.safetensors")]) == 0
    again, _ = load(tmp_path / "found.safetensors", "cpu")
    assert again.shape == network.shape
    with pytest.raises(SystemExit, match="--stands-from: a network that finds a place"):
        main(["export", str(found / "found.pt"), str(tmp_path / "other.safetensors"), "--stands-from", "1"])


@pytest.mark.parametrize(
    "other, message",
    [
        (["--worlds", "3"], r"--worlds \[2\], not \[3\]"),
        (["--worlds", "1", "2", "3"], "--worlds has 3 numbers for 2 tasks"),
        (["--seed", "2"], "--seed 1, not 2"),
        (["--first-room", "64"], "--first-room 64 is for judging"),
        (["--tasks", "S05"], "invalid choice: 'S05'"),
    ],
)
def test_looks_of_other_settings_are_not_taken_for_its_own(found, capsys, other, message):
    with pytest.raises(SystemExit) as ended:
        main([*FIND, "--out", str(found), *other])
    assert ended.value.code == 2 and re.search(message, capsys.readouterr().err)


def test_it_learns_where_the_room_is_and_what_stands_in_it(tmp_path, capsys):
    run = ["find", "--tasks", "S01", *SMALL, "--out", str(tmp_path / "room")]
    assert main(run) == 0
    looks = Looks.load(tmp_path / "room" / "looks-S01-1000")
    assert len(looks.place) == 2 * 60 // 10
    place = dict(zip(IN_ROOM.numbers, looks.place.T))
    assert np.hypot(place["cos"], place["sin"]) == pytest.approx(1, abs=1e-5)
    # Bench and crate stay where they are in the room, as the robot goes.
    for thing in ("bench", "crate"):
        ahead, left = place[f"{thing}_ahead"], place[f"{thing}_left"]
        x = place["x"] + place["cos"] * ahead - place["sin"] * left
        y = place["y"] + place["sin"] * ahead + place["cos"] * left
        for room in (1000, 1001):
            assert np.ptp(x[looks.room == room]) < 1e-3 and np.ptp(y[looks.room == room]) < 1e-3
        assert np.ptp(x) > 0.1
    network, record = load(tmp_path / "room" / "found.pt", "cpu")
    assert network.shape.finds == IN_ROOM.finds and set(record["errors"]) == {*IN_ROOM.numbers, "wall"}
    with pytest.raises(SystemExit, match="S12 and S01 find other things"):
        main(["find", "--tasks", "S12", "S01", *SMALL, "--out", str(tmp_path / "both")])


def test_a_robot_with_other_hands_learns_and_its_name_stays_with_the_network(tmp_path):
    robot = "g1_dex3"
    assert main(["find", "--tasks", "S12", *SMALL, "--robot", robot, "--out", str(tmp_path)]) == 0
    network, _ = load(tmp_path / "found.pt", "cpu")
    env = fiatlux.VectorEnv("S12", 1, robot=robot)
    assert network.shape.robot == robot and network.shape.joints == tuple(env.action_names)
    env.close()
    assert lessons.shape_of(["S06"], robot=robot).joints != lessons.shape_of(["S06"]).joints


def test_the_shipped_network_finds_what_is_learned_here():
    """The policy reads the shipped file by names of its own, and refuses others."""
    shipped = Path(__file__).parents[3] / "crates/policies/weights/platform.safetensors"
    network, record = load(shipped, "cpu")
    assert network.shape.finds == ON_LADDER.finds
    # As docs/notes/training.md has them, of the network that was played.
    errors = {name: round(error * 1e3, 1) for name, error in record["errors"].items()}
    assert errors == {"x": 5.8, "y": 2.8, "heading": 10.8, "wall": 5.3}


@pytest.mark.parametrize("name", ["walks", "ladder", "hands", "platform", "room"])
def test_the_card_of_a_shipped_network_is_of_its_file(name):
    weights = Path(__file__).parents[3] / "crates/policies/weights"
    _, record = load(weights / f"{name}.safetensors", "cpu")
    card = (weights / "README.md").read_text().split(f"## {name}.safetensors")[1].split("## ")[0]
    learned = record["looks"] if "looks" in record else record["labelled"]
    assert f"{learned:,}" in card
