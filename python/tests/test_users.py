"""Tests what users of Gymnasium, ManiSkill and robosuite expect: copies, threads, interruptions, memory, names, messages."""

import copy
import inspect
import io
import pickle
import signal
import subprocess
import sys
import threading
from typing import Any, get_args

import fiatlux
import gymnasium
import numpy as np
import pytest
from fiatlux import _native, settings, vector
from gymnasium.vector import AutoresetMode

# Arguments that a type checker refuses.
ENV: Any = fiatlux.Env
VECTOR: Any = fiatlux.VectorEnv


def small(**settings):
    return fiatlux.VectorEnv("S07", 4, seeds=[1000], observation="flat", **settings)


def test_one_key_is_the_judge_in_force():
    for protocol in ("strict", "published"):
        env = fiatlux.Env("S05", protocol=protocol)
        env.reset(seed=0)
        ended = False
        while not ended:
            *_, terminated, truncated, info = env.step(np.zeros(53))
            ended = terminated or truncated
        summary = env.summary()
        other = "published" if protocol == "strict" else None
        prefix = "strict_" if protocol == "strict" else ""
        for name, ending in (("success", "success"), ("steps", "steps"), ("end", "end"), ("gate_progress", "progress")):
            assert info[name] == summary[prefix + (ending if prefix else name)], name
            if other:
                assert info[f"published_{ending}"] == summary[name], name
        assert info["steps"] == env.row()["step"]


def test_readers_and_controllers_are_copied_and_pickled():
    kinematics = fiatlux.Kinematics("S02", seed=3, robot="g1_bare")
    bodies = fiatlux.WholeBodies(2)
    for made in (copy.deepcopy(kinematics), pickle.loads(pickle.dumps(kinematics))):
        np.testing.assert_array_equal(
            made.poses(made.reference, ["left_palm"]), kinematics.poses(kinematics.reference, ["left_palm"])
        )
    sensed, commands = np.zeros((2, 10 + 2 * 29)), np.zeros((2, 7))
    sensed[:, 5], sensed[:, 9], commands[:, 3], commands[:, 0] = -1.0, 0.75, 0.75, 0.3
    goals = np.full((2, 2, 7), np.nan)
    fresh = pickle.loads(pickle.dumps(bodies))
    np.testing.assert_array_equal(fresh(sensed, commands, goals), bodies(sensed, commands, goals))
    twin = copy.deepcopy(bodies)
    for _ in range(5):
        np.testing.assert_array_equal(twin(sensed, commands, goals), bodies(sensed, commands, goals))
    with pytest.raises(TypeError, match="cannot be pickled during an episode; call reset"):
        pickle.dumps(bodies)
    bodies.reset()
    pickle.dumps(bodies)


def test_a_second_thread_is_told_what_to_do():
    env = fiatlux.VectorEnv("S07", 64, seeds=[1000], observation="flat", num_threads=1)
    env.reset(seed=1)
    problems = []

    def use():
        for _ in range(20):
            try:
                env.step(np.zeros(env.action_space.shape))
            except RuntimeError as error:
                problems.append(str(error))

    threads = [threading.Thread(target=use) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert problems and all("another thread is in a call of this Batch" in text and "Lock" in text for text in problems)
    env.step(np.zeros(env.action_space.shape))


def test_ctrl_c_comes_when_the_step_is_done():
    env = fiatlux.VectorEnv("S07", 256, seeds=[1000], observation="flat")
    env.reset(seed=1)
    actions = np.zeros(env.action_space.shape)
    timer = threading.Timer(0.02, signal.raise_signal, [signal.SIGINT])
    interrupted = False
    timer.start()
    try:
        for _ in range(500):
            env.step(actions)
    except KeyboardInterrupt:
        interrupted = True
    timer.join()
    assert interrupted
    steps = {int(env.row(world)["step"]) for world in range(256)}
    assert len(steps) == 1, "every world has taken the step"
    env.step(actions)


@pytest.mark.skipif(sys.platform != "linux", reason="limits of memory are Linux's")
def test_too_many_worlds_are_a_memory_error():
    script = """
import resource, sys
import fiatlux
resource.setrlimit(resource.RLIMIT_AS, (int(sys.argv[1]) * 2**20,) * 2)
try:
    fiatlux.VectorEnv("S07", int(sys.argv[2]), seeds=[1000], episodes=1, num_threads=2).reset(seed=0)
    print("made")
except MemoryError as error:
    print("refused:", error)
"""
    bodies = script.replace(
        'VectorEnv("S07", int(sys.argv[2]), seeds=[1000], episodes=1, num_threads=2).reset(seed=0)',
        "WholeBodies(100_000)",
    )
    run = subprocess.run([sys.executable, "-c", bodies, "1500", "0"], capture_output=True, text=True)
    assert run.stdout.startswith("refused: num_envs: no memory for the controllers of 100000 worlds"), run.stderr[-500:]
    for megabytes, worlds, expected in ((1500, 200_000, "refused: num_envs: no memory for 200000"), (1500, 64, "made")):
        run = subprocess.run(
            [sys.executable, "-c", script, str(megabytes), str(worlds)], capture_output=True, text=True
        )
        assert run.returncode == 0 and run.stdout.startswith(expected), (run.returncode, run.stdout, run.stderr[-500:])


def test_a_rollout_is_its_steps():
    env, twin = small(seed=2), small(seed=2)
    env.reset(seed=1), twin.reset(seed=1)
    actions = np.random.default_rng(0).uniform(-1.0, 1.0, (80, 4, 53))
    played = env.rollout(actions, observations=True)
    assert played.terminated.any(), "an episode ended on the way"
    for step, action in enumerate(actions):
        observation, reward, terminated, truncated, info = twin.step(action)
        np.testing.assert_array_equal(played.observation[step], observation)
        np.testing.assert_array_equal(played.reward[step], reward)
        np.testing.assert_array_equal(played.reward_terms[step], info["reward_terms"])
        np.testing.assert_array_equal(played.terminated[step], terminated)
    last = env.rollout(np.zeros((3, 53)))
    for _ in range(3):
        observation, *_ = twin.step(np.zeros((4, 53)))
    np.testing.assert_array_equal(last.observation, observation)


def test_starts_differ_between_episodes():
    env = fiatlux.VectorEnv("S07", 1, autoreset_mode="disabled")
    seen = {tuple(env.reset(seed=seed)[1]["drawn"]["episode"].tolist()) for seed in range(12)}
    assert len(seen) > 1
    first, again = env.reset(seed=3)[0], env.reset(seed=3)[0]
    for name in first:
        np.testing.assert_array_equal(first[name], again[name])


def test_worlds_are_drawn():
    env = small(render_mode="rgb_array", render_size=(64, 48), render_camera="camera")
    env.reset(seed=0)
    frames = env.render()
    assert len(frames) == 4 and frames[0].shape == (48, 64, 3) and frames[0].std() > 5 and frames[0].flags.writeable
    unseen = small()
    unseen.reset(seed=0)
    assert unseen.render() is None
    one = fiatlux.Env("S07", render_mode="rgb_array", render_size=(64, 48), render_camera="head_camera")
    one.reset(seed=1000)
    assert one.render().flags.writeable


def test_groups_cover_the_joints():
    for env in (fiatlux.Env("S05"), fiatlux.VectorEnv("S05", 1), fiatlux.WalkingVectorEnv(1)):
        places = np.concatenate(list(env.joint_groups.values()))
        assert sorted(places) == list(range(len(env.action_names)))
    assert fiatlux.Env("S05").joint_groups["left_leg"].tolist() == list(range(6))


def test_signatures_name_the_settings():
    for call in (fiatlux.Env, fiatlux.VectorEnv, fiatlux.evaluate, fiatlux.Client.run, fiatlux.WalkingVectorEnv):
        names = inspect.signature(call).parameters
        assert not any(part.kind is part.VAR_KEYWORD for part in names.values()), call
    names = inspect.signature(fiatlux.VectorEnv).parameters
    assert {"ranges", "sensors", "privileged", "links", "num_threads"} <= set(names)
    assert names["observation"].default == "dict" and names["protocol"].default == "strict"
    command = {name: part.default for name, part in inspect.signature(fiatlux.WholeBody.__call__).parameters.items()}
    both = inspect.signature(fiatlux.WholeBody.joint_targets).parameters
    assert {name: both[name].default for name in command} == command and len(command) == 9


def test_types_list_the_names_that_there_are():
    robots = set(fiatlux.ROBOTS)
    assert set(get_args(settings.Robot)) == robots | {name.removeprefix("g1_") for name in robots}
    for name in get_args(settings.Robot):
        assert fiatlux.segments(name)
    assert list(get_args(settings.Sensor)) == _native.sensors()
    for argument, known in (("end_on", settings.End), ("fix", settings.Fixed)):
        with pytest.raises(ValueError, match=f"known ones are {', '.join(get_args(known))}$"):
            ENV("S05", **{argument: ["x"]})
    assert list(get_args(settings.RenderMode)) == fiatlux.Env.metadata["render_modes"]
    assert [vector._autoreset(name) for name in get_args(vector.Autoreset)] == [*AutoresetMode, *AutoresetMode]


def test_reprs_say_what_it_is():
    env = fiatlux.Env("S07")
    assert repr(env) == f"<fiatlux.Env S07, {fiatlux.ROBOTS[0]}, strict judge: no episode has begun>"
    env.reset(seed=1000)
    assert "seed 1000, episode 0" in repr(env)
    assert "S07: 4 worlds" in repr(small()) and "nq 81" in repr(fiatlux.Kinematics("S07"))
    result = fiatlux.evaluate(lambda observation: np.zeros(53), ["S05"], [0], max_steps=2)
    assert len(repr(result)) < 120 and result._repr_html_().startswith("<pre>")


@pytest.mark.parametrize(
    "call, says",
    [
        (lambda: ENV("S07", fix=["a"]), "fix: 'a' is refused.*layout"),
        (lambda: ENV("S07", noise="no"), "noise is 'no'; give True or False"),
        (lambda: ENV("S07", nosie=True), r"unexpected argument 'nosie' \(did you mean 'noise'\?\)"),
        (
            lambda: VECTOR("S07", 1, link=["left_palm"]),
            r"did you mean 'links'\?.*num_threads.*disturbances",
        ),
        (lambda: fiatlux.VectorEnv("S07", 1, starts=[]), "starts is empty; leave it out"),
        (lambda: small(ranges={"com_shift_m": (-0.02, 0.02)}), "com_shift_m is .*; give a number, m"),
        (lambda: small(ranges={"mass": 3}), r"mass is 3; give \(least, most\)"),
        (lambda: fiatlux.Env("S07", render_camera="cam"), "render_camera is 'cam'; .* 'head_camera' .sensor 'camera'."),
        (lambda: fiatlux.Kinematics().poses(np.zeros(60), "left_palm"), r"sites is 'left_palm'; give a list"),
        (lambda: fiatlux.Kinematics().state({"joint_positions": [0.0]}), "did you mean 'joint_position'"),
        (
            lambda: fiatlux.evaluate(type("M", (), {"predict": print})()),
            "a M answers by predict; give lambda observation",
        ),
        (lambda: fiatlux.evaluate(type("M", (), {})), r"M has no method __call__"),
        (lambda: fiatlux.evaluate(print, "S07"), r"tasks is 'S07'; give a list"),
        (lambda: gymnasium.make("Fiatlux-Walking-v1"), "use gymnasium.make_vec"),
        (lambda: VECTOR("S07", 1, starts=[1]), "starts has 1; give a list of fiatlux.Start"),
        (lambda: VECTOR("S07", 1, judge=3), "judge is 3; give a function"),
        (lambda: VECTOR("S07", 2, seeds="0..1"), "seeds is '0..1'; give a list"),
        (lambda: fiatlux.Env("S07", weights="/nowhere"), "weights is '/nowhere'; there is no such file"),
        (lambda: fiatlux.evaluate(lambda seen: None, ["S07"], [1000]), "None is not a real number"),
        (lambda: fiatlux.evaluate(lambda seen: np.zeros(53, complex), ["S07"], [1000]), "complex128 are not real"),
        (lambda: fiatlux.evaluate(lambda seen: ["0"] * 53, ["S07"], [1000]), "are not real"),
        (lambda: fiatlux.Kinematics().poses(np.zeros(60, complex), ["left_palm"]), "qpos: .* are not real"),
    ],
)
def test_messages_name_the_argument_and_the_remedy(call, says):
    with pytest.raises((ValueError, TypeError), match=says):
        call()


def test_more_messages():
    env = small()
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"is 1e300; send numbers from") as refused:
        env.step(np.full((4, 53), 1e300))
    assert len(str(refused.value)) < 200
    kinematics = fiatlux.Kinematics()
    with pytest.raises(ValueError, match="left_palm: the quaternion has length 0"):
        kinematics.inverse(kinematics.reference, {"left_palm": np.zeros(7)})
    judged = small(judge=lambda observation, info: (np.full(4, np.nan), None))
    judged.reset(seed=0)
    with pytest.raises(ValueError, match="judge: the reward of world 0 is nan"):
        judged.step(np.zeros((4, 53)))
    wrong = small(judge=lambda observation, info: (np.zeros(3), None))
    wrong.reset(seed=0)
    with pytest.raises(ValueError, match=r"judge: reward has shape \(3,\); give one for each of 4 worlds"):
        wrong.step(np.zeros((4, 53)))
    assert fiatlux.FiatluxError.__module__ == "fiatlux"
    env.reset(seed=0)
    with pytest.raises(ValueError, match="like: joint_position cannot be read as numbers .*not real"):
        env.reset_worlds(np.arange(4) == 1, like={"joint_position": np.zeros(53, complex)})


def test_reach_says_what_remains():
    env = fiatlux.Env("S08", action_form="joint_target")
    observation, _ = env.reset(seed=1000)
    body = fiatlux.WholeBody()
    palms = body.palms(observation)
    near, far = palms[0] + [0.02, 0, 0.02, 0, 0, 0, 0], palms[1] + [0.6, 0, 0.3, 0, 0, 0, 0]
    reached = body.reach(observation, left=near, right=far)
    assert reached.position_error[0] < 0.005 < 0.2 < reached.position_error[1]
    assert np.isnan(body.reach(observation, left=near).position_error[1])
    body.hold_arms(observation, reached)


def test_a_bag_has_what_the_environment_gave(tmp_path):
    random = np.random.default_rng(0)
    actions = random.uniform(-0.2, 0.2, (2000, 53))
    settings = {"sensors": ["proprioception", "contact_force", "last_action", "privileged"]}
    if "contact_force" not in fiatlux._native.sensors():
        settings = {"privileged": True}

    class Wave:
        def reset(self, info):
            self.step = 0

        def __call__(self, observation):
            self.step += 1
            return actions[self.step - 1]

    fiatlux.evaluate(Wave, ["S05"], [1000], out=tmp_path / "run", **settings)
    bag = fiatlux.Bag(next((tmp_path / "run").rglob("*.mcap")))
    env = fiatlux.Env("S05", **settings)
    given = [env.reset(seed=1000)[0]]
    for action in actions[: bag.steps]:
        given.append(env.step(action)[0])
    seen = bag.observations()
    assert list(seen) == list(given[0])
    for name, part in seen.items():
        np.testing.assert_array_equal(part, np.stack([observation[name] for observation in given]), err_msg=name)
    np.testing.assert_array_equal(bag.actions(), actions[: bag.steps])
    flat = bag.observations(["proprioception"], observation="flat")
    assert flat.shape == (bag.steps + 1, 10 + 2 * 53) and bag.commands() is None
    with pytest.raises(ValueError, match="the bag has no 'lidar' in its observations; it has proprioception"):
        bag.observations(["lidar"])
    with pytest.raises(KeyError, match="has no column 'joint_pos'; did you mean 'joint_position'"):
        bag["/state"]["joint_pos"]
    assert "S05, seed 1000" in repr(bag)


@pytest.fixture(scope="module")
def long_bag(tmp_path_factory):
    """An episode of two minutes: 6,001 rows."""
    folder = tmp_path_factory.mktemp("long")
    sensors = ["proprioception", "hand_contact", "last_action"]
    fiatlux.evaluate(lambda _: np.zeros(53), ["S05"], [1000], sensors=sensors, end_on=["time-out"], out=folder / "run")
    return next(folder.rglob("*.mcap"))


@pytest.mark.parametrize("what", ["/state", "/observation", "observations"])
def test_reading_a_bag_takes_at_most_three_times_its_numbers(long_bag, what):
    script = """
import resource, sys
import fiatlux
bag, what = fiatlux.Bag(sys.argv[1]), sys.argv[2]
peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024
before = peak()
columns = bag[what] if what in bag.keys() else bag.observations()
print(sum(part.nbytes for part in columns.values() if hasattr(part, "nbytes")), peak() - before)
"""
    run = subprocess.run(
        [sys.executable, "-c", script, str(long_bag), what], capture_output=True, text=True, check=True
    )
    size, taken = map(int, run.stdout.split())
    # A part of the file is in memory too.
    assert size > 6e6 and taken < 3 * size + 2e6, (size, taken)


def test_pictures_are_shown_in_notebooks(tmp_path):
    image = pytest.importorskip("PIL.Image")

    def shown(what):
        return np.asarray(image.open(io.BytesIO(what._repr_png_())))

    size = {"render_mode": "rgb_array", "render_size": (64, 48)}
    env, actions = fiatlux.Env("S05", **size), iter(np.random.default_rng(0).uniform(-0.2, 0.2, (200, 53)))
    assert env._repr_png_() is None, "no episode has begun"
    env.reset(seed=1000)
    pictures, ended = [env.render()], False
    while not ended:
        _, _, *ends, _ = env.step(next(actions))
        ended = any(ends)
        pictures.append(env.render())
    for what in (env, pictures[-1]):
        np.testing.assert_array_equal(shown(what), pictures[-1])
    assert pictures[-1][0]._repr_png_() is None and (pictures[-1] / 2)._repr_png_() is None
    worlds = fiatlux.VectorEnv("S05", 1, seeds=[1000], **size)
    worlds.reset()
    np.testing.assert_array_equal(shown(worlds.render()[0]), worlds.render_world(0))

    again = iter(np.random.default_rng(0).uniform(-0.2, 0.2, (200, 53)))
    fiatlux.evaluate(lambda _: next(again), ["S05"], [1000], out=tmp_path / "run")
    (bag,) = fiatlux.Bag.below(tmp_path / "run")
    assert bag.steps == len(pictures) - 1
    for row in (0, 3, -1):
        np.testing.assert_array_equal(bag.render(row, size=(64, 48)), pictures[row])
    four = shown(bag)
    assert four.shape == (240, 4 * 320, 3)
    np.testing.assert_array_equal(four[:, -320:], bag.render(-1, size=(320, 240)))
    assert bag.render(0, size=(32, 24), camera="camera").shape == (24, 32, 3)
    for wrong, says in (
        ({"row": bag.steps + 1}, "row is"),
        ({"row": 0, "camera": "tail"}, "render_camera is 'tail'"),
        ({"row": 0, "size": (0, 4)}, "size"),
    ):
        with pytest.raises(ValueError, match=says):
            bag.render(**wrong)


def test_mujoco_has_the_same_poses():
    mujoco = pytest.importorskip("mujoco")
    env = fiatlux.Env("S08", noise=False)
    env.reset(seed=1000)
    for _ in range(15):
        seen, *_ = env.step(np.random.default_rng(0).uniform(-0.5, 0.5, 53))
    kinematics = fiatlux.Kinematics("S08", seed=1000)
    qpos, qvel = kinematics.state(env.row())
    model = mujoco.MjModel.from_xml_string(env.to_mjcf())
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = kinematics.to_mujoco(qpos, qvel, model=model)
    np.testing.assert_allclose(data.qpos, model.key("start").qpos, atol=1e-12)
    np.testing.assert_allclose(data.qvel, model.key("start").qvel, atol=1e-9)
    mujoco.mj_forward(model, data)
    # As proprioception senses them, and the turn.
    for name in ("base_angular_velocity", "base_linear_velocity"):
        np.testing.assert_allclose(data.sensor(name).data, seen[name], atol=1e-5, err_msg=name)
    np.testing.assert_allclose(data.sensor("base_quaternion").data, env.row()["robot_pose"][3:], atol=1e-9)
    for site in ("left_palm", "right_palm", "right_grasp", "imu", "left_sole", "fresh_bulb_plug"):
        pose = kinematics.poses(qpos, [site])[0]
        np.testing.assert_allclose(data.site(site).xpos, pose[:3], atol=1e-9, err_msg=site)
        velocity = np.zeros(6)
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_SITE, data.site(site).id, velocity, 0)
        found = kinematics.velocities(qpos, qvel, [site])[0]
        np.testing.assert_allclose(velocity[[3, 4, 5, 0, 1, 2]], found, atol=1e-8, err_msg=site)
    targets = env.row()["joint_target"]
    data.ctrl[:] = kinematics.to_mujoco_ctrl(targets, model=model)
    np.testing.assert_array_equal(data.ctrl, model.key("start").ctrl)
    for joint, target in zip(kinematics.joints, targets):
        assert data.actuator(joint).ctrl[0] == target, joint
    with pytest.raises(ValueError, match="targets: shape"):
        kinematics.to_mujoco_ctrl(targets[:-1])
    with pytest.raises(ValueError, match="its 29 actuators are not those"):
        bare = fiatlux.Env("S07", robot="g1_bare")
        bare.reset(seed=1000)
        kinematics.to_mujoco_ctrl(targets, model=mujoco.MjModel.from_xml_string(bare.to_mjcf()))
    for joint in kinematics.joints:
        at = kinematics.joint_qpos[kinematics.joints.index(joint)]
        assert data.joint(joint).qpos[0] == qpos[at], joint
    back = kinematics.from_mujoco(data.qpos, data.qvel, model=model)
    np.testing.assert_allclose(back[0], qpos, atol=1e-12)
    np.testing.assert_allclose(back[1], qvel, atol=1e-9)
    assert kinematics.mujoco_joints == [model.joint(joint).name for joint in range(model.njnt)]

    # As many numbers, in another order.
    other = mujoco.MjSpec.from_string(env.to_mjcf()).to_xml().replace('joint name="left_knee_joint"', 'joint name="x"')
    other = other.replace('joint name="right_knee_joint"', 'joint name="left_knee_joint"').replace(
        'joint name="x"', 'joint name="right_knee_joint"'
    )
    for actuator in ("left", "right"):
        assert f'joint name="{actuator}_knee_joint"' in other
    with pytest.raises(ValueError, match="model: nq 81, nv 77, joint .* is '.*_knee_joint', but here"):
        kinematics.to_mujoco(qpos, qvel, model=mujoco.MjModel.from_xml_string(other))
    with pytest.raises(ValueError, match="a quaternion has length"):
        kinematics.from_mujoco(np.zeros(81))


def test_mujoco_s_accelerometer_shows_gravity_at_rest():
    mujoco = pytest.importorskip("mujoco")
    env = fiatlux.Env("S08", robot="g1_bare")
    env.reset(seed=1000)
    text = env.to_mjcf().replace('<freejoint name="pelvis"/>', "")
    assert "freejoint" in text and text != env.to_mjcf(), "the robot hangs by its pelvis, and nothing else does"
    model = mujoco.MjModel.from_xml_string(text[: text.index("<keyframe>")] + "</mujoco>")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.sensor("base_acceleration").data, [0, 0, 9.81], atol=1e-6)
