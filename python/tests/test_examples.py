"""Runs the programs of `python/examples` in a short form, and for minutes with `FIATLUX_NIGHTLY`."""

import importlib.util
import os
import pathlib
import resource
import subprocess
import time

import fiatlux
import numpy as np
import pytest

nightly = pytest.mark.skipif("FIATLUX_NIGHTLY" not in os.environ, reason="FIATLUX_NIGHTLY is not set")
needs_program = pytest.mark.skipif(
    "FIATLUX_TEST_PROGRAM" not in os.environ, reason="needs the program fiatlux: FIATLUX_TEST_PROGRAM"
)
ROOMS = range(1400, 1416)
EXAMPLES = pathlib.Path(__file__).resolve().parents[1] / "examples"


def imported(name):
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_they_are_short():
    for path in EXAMPLES.glob("*.py"):
        lines = [line for line in path.read_text().splitlines() if line.strip()]
        assert len(lines) <= 60, path.name


def test_mppi_stands():
    # Without it the robot falls after 1.02 s.
    assert imported("mppi").stand(1.6) == 1.6


def test_pick_takes_the_bulb():
    played = fiatlux.evaluate(imported("pick").Pick, ["S08"], [1000]).episodes[0]
    assert played["strict_success"], played


def demonstrated(folder, episodes):
    """Bags of S07 by the policy `walk`."""
    command = [os.environ["FIATLUX_TEST_PROGRAM"], "demonstrate", "--policy", "walk", "--task", "S07"]
    more = ["--episodes", str(episodes), "--no-pictures", "--out", folder]
    subprocess.run([*command, *more], check=True, capture_output=True)
    return fiatlux.Bag.below(folder / "bags", training=True)


def succeeded(policy, task):
    """Number of the rooms in which the strict judge sees a success."""
    episodes = fiatlux.evaluate(policy, [task], ROOMS).episodes
    assert len(episodes) == len(ROOMS)
    return sum(episode["strict_success"] for episode in episodes)


@nightly
def test_mppi_stands_for_as_long_as_it_says():
    assert imported("mppi").stand(20.0) == 20.0


@nightly
def test_pick_takes_the_bulb_in_three_rooms_of_four():
    assert succeeded(imported("pick").Pick, "S08") >= 12


@nightly
@pytest.mark.parametrize("task", ["S06", "S07"])
def test_a_student_of_the_expert_does_nine_rooms_of_ten(task):
    assert imported("dagger").main(task, 8, last=6000) >= 29


@nightly
@needs_program
def test_a_clone_of_twenty_demonstrations_solves_a_room_of_four(tmp_path):
    def used():
        children = resource.getrusage(resource.RUSAGE_CHILDREN)
        return time.process_time() + children.ru_utime + children.ru_stime

    began = used()
    bags = demonstrated(tmp_path, 20)
    policy = imported("bc").Clone(bags)
    assert len(bags) == 20 and used() - began < 180.0, "demonstrations and training take 3 minutes of a processor"
    assert succeeded(policy, "S07") >= 4


@needs_program
def test_a_clone_walks_to_the_bulb(tmp_path):
    policy = imported("bc").Clone(demonstrated(tmp_path, 3))
    env = fiatlux.Env("S07", action_form=policy.action_form, sensors=policy.sensors)
    seen, _ = env.reset(seed=1000)
    policy.reset({})
    away = lambda: np.linalg.norm((seen["privileged.fresh_bulb_position"] - seen["privileged.robot_position"])[:2])
    began = away()
    for _ in range(400):
        seen, _, terminated, _, info = env.step(policy(seen))
        if terminated:
            assert info["success"]
            break
    assert away() < began - 0.5 and seen["base_height"][0] > 0.65, "it is on its way, and upright"


def test_a_student_learns_from_the_expert():
    dagger = imported("dagger")
    errors = []
    train = dagger.Network.train

    def watched(student, inputs, outputs, batches):
        train(student, inputs, outputs, batches)
        errors.append(np.abs(student.layers(inputs)[-1] - outputs).mean(0) / outputs.std(0).clip(0.01))

    dagger.Network.train = watched
    dagger.main("S07", 2, worlds=3, steps=120, batches=400, judged=range(1100, 1102), last=5)
    assert len(errors) == 2 and errors[-1][:3].mean() < 0.5, "it tells where to walk"
