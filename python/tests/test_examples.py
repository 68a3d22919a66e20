"""Runs the programs of `python/examples` in a short form."""

import importlib.util
import os
import pathlib
import subprocess

import fiatlux
import numpy as np
import pytest

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


@pytest.mark.skipif("FIATLUX_TEST_PROGRAM" not in os.environ, reason="needs the program fiatlux: FIATLUX_TEST_PROGRAM")
def test_a_clone_walks_to_the_bulb(tmp_path):
    command = [
        os.environ["FIATLUX_TEST_PROGRAM"],
        "demonstrate",
        "--policy",
        "walk",
        "--task",
        "S07",
        "--episodes",
        "3",
    ]
    subprocess.run([*command, "--no-pictures", "--out", tmp_path], check=True, capture_output=True)
    bags = [fiatlux.Bag(path) for path in sorted((tmp_path / "bags").glob("*.mcap"))]
    policy = imported("bc").Clone(bags)
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
