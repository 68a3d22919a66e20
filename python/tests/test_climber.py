"""Tests that the climb can be played on command."""

import fiatlux
import numpy as np
import pytest
from fiatlux import poses

SENSORS = ["proprioception", "last_action", "privileged"]


def begun(task="S12", seed=1000):
    env = fiatlux.Env(task, action_form="joint_target", sensors=SENSORS)
    return env, env.reset(seed=seed)[0]


def ladder(seen):
    return poses.compose(poses.inverse(poses.of(seen, "robot")), poses.of(seen, "ladder"))


def test_it_goes_down_as_fast_as_it_is_told():
    done = {}
    for rate in (0.5, 1.0):
        env, seen = begun()
        climber = fiatlux.Climber("S12")
        for _ in range(600):
            seen, _, terminated, _, _ = env.step(climber(seen, ladder(seen), rate=rate))
            assert not terminated
        assert climber.phase == "Climb"
        done[rate] = climber.part_done
    assert 0.3 < done[0.5] / done[1.0] < 0.7, done


def test_it_climbs_down_by_the_ladders_pose_alone():
    env, seen = begun()
    climber, is_over = fiatlux.Climber("S12"), False
    assert np.isnan(climber.part_done)
    while not is_over:
        seen, _, terminated, truncated, info = env.step(climber(seen, ladder(seen)))
        is_over = terminated or truncated
    assert info["success"], info["end"]


def test_it_leans_and_waits_where_it_is_told_to():
    away = {}
    for lean in (-0.015, 0.015):
        env, seen = begun()
        climber = fiatlux.Climber("S12")
        for step in range(420):
            waits = {"rate": 0.0, "lean": (lean, 0.0)} if step >= 300 else {}
            seen, _, terminated, _, _ = env.step(climber(seen, ladder(seen), **waits))
            assert not terminated
            if step == 300:
                part, began = climber.part_done, poses.of(seen, "robot")
        assert climber.part_done == part
        moved = poses.rotate(poses.conjugate(began[3:]), poses.of(seen, "robot")[:3] - began[:3])
        away[lean] = moved[0]
    assert away[0.015] - away[-0.015] > 0.01, away


def test_what_cannot_be_is_refused_by_name():
    _, seen = begun()
    climber, here = fiatlux.Climber("S12"), ladder(seen)
    for keywords, named in (
        ({"rate": 1.3}, "rate"),
        ({"rate": float("nan")}, "rate"),
        ({"lean": (0.0, -0.04)}, "lean"),
    ):
        with pytest.raises(ValueError, match=named):
            climber(seen, here, **keywords)
    with pytest.raises(ValueError, match="ladder"):
        climber(seen, np.zeros(7))
    with pytest.raises(ValueError, match="last_action"):
        climber({name: part for name, part in seen.items() if name != "last_action"}, here)
    with pytest.raises(ValueError, match="joint_position"):
        climber({**seen, "joint_position": np.full(53, np.nan)}, here)
    for task in ("S05", "S99"):
        with pytest.raises(ValueError, match="S12"):
            fiatlux.Climber(task)
