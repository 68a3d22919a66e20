"""Tests copies and pickles of environments, snapshots and controllers, and forked processes."""

import copy
import os
import pickle
import subprocess
import sys

import fiatlux
import gymnasium
import numpy as np
import pytest

THROUGH_A_PICKLE = [copy.deepcopy, lambda thing: pickle.loads(pickle.dumps(thing))]


def carriers(num_envs=2, **settings):
    return fiatlux.VectorEnv(
        "S05", num_envs, **{"seeds": [1000, 1001], "reward": "training", "observation": "flat", **settings}
    )


def walkers(num_envs=3, **settings):
    ranges = {"mass": (0.9, 1.1)}
    disturbances = {"pushes": {"interval_s": (0.1, 0.3)}, "wrenches": {"interval_s": (0.1, 0.3)}}
    return fiatlux.WalkingVectorEnv(
        num_envs, **{"ranges": ranges, "disturbances": disturbances, "variations": 2, **settings}
    )


def play(env, steps=40, seed=0):
    """Everything that a vector says; with these actions, robots fall."""
    said = []
    for actions in np.random.default_rng(seed).uniform(-1, 1, (steps, *env.action_space.shape)):
        *numbers, info = env.step(actions)
        said += [*numbers, info["reward_terms"], info["success"]]
    return said + [row for world in range(env.num_envs) for row in env.row(world).values()]


def assert_same(ours, others):
    assert len(ours) == len(others)
    for one, other in zip(ours, others):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("copied", THROUGH_A_PICKLE)
@pytest.mark.parametrize("make", [carriers, walkers])
def test_a_copied_vector_and_a_copied_snapshot_go_on_exactly(make, copied):
    env = make()
    env.reset(seed=5)
    play(env, 25)
    other, saved = copied(env), copied(env.save())
    went_on = play(env, seed=1)
    assert any(np.any(terminated) for terminated in went_on[2 : 6 * 40 : 6]), "no episode ended"
    assert_same(went_on, play(other, seed=1))
    env.restore(saved)
    assert_same(went_on, play(env, seed=1))


@pytest.mark.parametrize("copied", THROUGH_A_PICKLE)
@pytest.mark.parametrize("form", ["action", "joint_target"])
def test_a_copied_episode_goes_on_exactly(copied, form):
    env = gymnasium.make("Fiatlux-S05-CarryBulbToDisposal-v1", observation="flat", action_form=form)
    env.reset(seed=3)
    actions = np.random.default_rng(0).uniform(-0.2, 0.2, (20, 53))
    for action in actions[:10]:
        env.step(action)
    other = copied(env)
    for action in actions[10:]:
        ours, others = env.step(action), other.step(action)
        np.testing.assert_array_equal(ours[0], others[0])
        assert ours[1:] == others[1:]
    assert env.unwrapped.digest == other.unwrapped.digest
    assert env.unwrapped.summary() == other.unwrapped.summary()
    np.testing.assert_array_equal(env.reset()[0], other.reset()[0])


def test_a_controller_is_copied_during_an_episode_and_pickled_between_two():
    env = fiatlux.Env("S05", action_form="joint_target")
    observation, _ = env.reset(seed=64)
    body = fiatlux.WholeBody()
    body(observation, vx=0.3)
    other = copy.deepcopy(body)
    np.testing.assert_array_equal(body(observation, vx=0.3), other(observation, vx=0.3))
    with pytest.raises(TypeError, match=r"WholeBody cannot be pickled during an episode; call reset\(\) first"):
        pickle.dumps(body)
    body.reset()
    fresh = pickle.loads(pickle.dumps(body))
    np.testing.assert_array_equal(body(observation, vx=0.3), fresh(observation, vx=0.3))


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"task": "S08"}, "task is S07, but the batch has S08"),
        ({"protocol": "published"}, "protocol is strict, but the batch has published"),
        ({"noise": False}, "noise is true, but the batch has false"),
        ({"reward": "benchmark"}, "reward is Training, but the batch has Benchmark"),
        ({"action_form": "joint_target"}, "action_form is Action, but the batch has JointTarget"),
        ({"sensors": ["proprioception"]}, "sensors is proprioception, hand_contact, last_action"),
        ({"image_size": (32, 32)}, r"image_size is \[256, 256\]"),
        ({"ranges": {"mass": (0.9, 1.1)}}, r"ranges.mass is \[1.0, 1.0\], but the batch has \[0.9, 1.1\]"),
        ({"ranges": {"hand_friction": (0.6, 0.7)}}, "ranges.hand_friction"),
        ({"disturbances": {"pushes": {"linear": 0.1}}}, "disturbances is"),
        ({"seeds": [1000, 1002]}, "seeds of the rooms is 1000, 1001, but the batch has 1000, 1002"),
        ({"episodes": 2}, "starts is"),
        ({"num_envs": 3}, "worlds is 2, but the batch has 3"),
        ({"robot": "g1_bare"}, "robot is g1_inspire, but the batch has g1_bare"),
        ({"gains": "sonic"}, "gains is"),
        ({"autoreset_mode": "next_step"}, "autoreset is SameStep, but the batch has NextStep"),
    ],
)
def test_a_snapshot_of_other_settings_is_refused_by_name(change, named):
    # A task that robots without hands can begin too.
    base = {"num_envs": 2, "seeds": [1000, 1001], "reward": "training", "observation": "flat"}
    saved = fiatlux.VectorEnv("S07", **base).save()
    change = dict(change)
    other = fiatlux.VectorEnv(change.pop("task", "S07"), **{**base, **change})
    before = [other.row(world) for world in range(other.num_envs)]
    with pytest.raises(ValueError, match=f"snapshot: {named}.*the same settings"):
        other.restore(saved)
    for world, row in enumerate(before):
        assert_same(row.values(), other.row(world).values())


@pytest.mark.parametrize(
    "change", [{"noise": False}, {"frames": 2}, {"load_kg": 0.5}, {"ranges": {"mass": (0.9, 1.2)}}]
)
def test_a_snapshot_of_another_walk_is_refused_by_name(change):
    (name,) = change
    with pytest.raises(ValueError, match=f"snapshot: {'ranges.mass' if name == 'ranges' else name} is"):
        walkers(**change).restore(walkers().save())


def test_bytes_that_are_no_snapshot_are_refused():
    kind, (written,) = walkers().save().__reduce__()
    assert kind(written).__reduce__() == (kind, (written,))
    for bytes_ in (b"", b"no", written[:20], written[:-1], written[:100] + b"x" + written[101:]):
        with pytest.raises(ValueError, match="the snapshot is damaged"):
            kind(bytes_)


FORKS = """
import os, signal, sys, warnings
import fiatlux, numpy as np
warnings.simplefilter("ignore", DeprecationWarning)

def forked(work):
    '''What the child raises, within ten seconds.'''
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        signal.alarm(10)
        try:
            work()
            os.write(writer, b"fine")
        except fiatlux.FiatluxError as error:
            os.write(writer, str(error).encode())
        # As the child of multiprocessing does: what is left is dropped.
        sys.exit(0)
    os.close(writer)
    said = os.read(reader, 10_000).decode()
    assert os.waitpid(child, 0)[1] == 0, f"the child hung or crashed after {said!r}"
    return said

actions = np.zeros((8, 15))
"""


def run(script):
    subprocess.run([sys.executable, "-c", FORKS + script], check=True, timeout=100)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_batch_in_a_forked_child_is_refused_at_once():
    run("""
env = fiatlux.WalkingVectorEnv(8, num_threads=2)
env.reset()
snapshot = env.save()
calls = [env.reset, lambda: env.step(actions), lambda: env.row(0), env.save, lambda: env.restore(snapshot)]
for call in calls:
    said = forked(call)
    assert "make the batch in the child" in said and f"process {os.getpid()}" in said, said
assert forked(env.close) == "fine"
def own():
    mine = fiatlux.WalkingVectorEnv(8, num_threads=2)
    mine.reset(), mine.step(actions)
assert forked(own) == "fine"
one = fiatlux.WalkingVectorEnv(8, num_threads=1)
one.reset()
assert forked(lambda: one.step(actions)) == "fine"
env.step(actions)
""")


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_the_network_in_a_forked_child_is_refused_at_once(tmp_path):
    run(f"""
zero = lambda observation: np.zeros(53)
try:
    fiatlux.Client("tcp/127.0.0.1:1")
except ConnectionError:
    pass
def evaluate():
    fiatlux.evaluate(zero, ["S05"], [0], out={str(tmp_path / "out")!r})
for call in (lambda: fiatlux.Client("tcp/127.0.0.1:1"), evaluate):
    assert "which lacks its threads" in forked(call)
""")
