//! Draws for an episode reach it, and only where they should.

use std::sync::Arc;

use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::{Bulb, Protocol, Row, Task, errand, measure};
use fiatlux_sensing::{NoiseSeed, Observer, Proprioception};
use fiatlux_world::{
    ACTION_SCALE, DomainSample, Episode, EpisodeSpec, HandFriction, Light, PropScale, Randomization, Scene,
    SceneConfig, SceneError, SceneSpec, StartError, StartOffset, StartOptions, Varied, World, start,
};

/// The G1 with Inspire hands.
const JOINTS: usize = 53;

fn scene_of(spec: &EpisodeSpec) -> Arc<Scene> {
    let robot = Arc::new(Robot::benchmark().unwrap());
    let spec = spec.scene(robot.gains(GainSet::default()));
    Arc::new(Scene::build(&SceneConfig::default(), robot, spec).unwrap())
}

fn started(spec: &EpisodeSpec) -> Episode {
    Episode::start(scene_of(spec), spec).unwrap()
}

/// Proprioception of the last row.
fn sensed(episode: &Episode) -> Proprioception {
    let q0 = episode.scene().robot.q0().to_vec();
    super::common::sensed(&mut Observer::new(q0, NoiseSeed::of(episode.spec())), episode.row())
}

/// Rows and observations of some steps, row 0 included. The joints swing about the staged posture.
fn played(episode: &mut Episode, steps: u64) -> Vec<(Row, Proprioception)> {
    let mut rows = vec![(episode.row().clone(), sensed(episode))];
    let staged = episode.row().action.clone();
    for step in 0..steps {
        let swing = |joint: usize| 0.05 * libm::sin(0.1 * step as f64 + joint as f64);
        let action: Vec<f64> = staged.iter().enumerate().map(|(joint, staged)| staged + swing(joint)).collect();
        if episode.step(&action).is_err() {
            break;
        }
        rows.push((episode.row().clone(), sensed(episode)));
    }
    rows
}

/// With nothing drawn, all episodes of all seeds have the same rows and observations, and what was drawn is nominal.
#[test]
fn nothing_drawn_means_nothing_differs() {
    for task in [Task::S01, Task::S05, Task::S08, Task::S11, Task::Climb] {
        let spec =
            |seed, episode| EpisodeSpec { randomize: Randomization::FIXED, ..EpisodeSpec::new(task, seed, episode) };
        let mut first = started(&spec(3, 0));
        let drawn = first.domain_sample();
        let room = started(&EpisodeSpec::new(task, 0, 0)).domain_sample().layout;
        let nominal = DomainSample {
            layout: room,
            scale: PropScale::default(),
            hand_friction: None,
            light: Light::default(),
            start: StartOffset::none(JOINTS),
            varied: Varied::new(),
        };
        assert_eq!(drawn, nominal, "{task}");
        let rows = played(&mut first, 30);
        for (seed, episode) in [(3, 1), (3, 17), (4, 0)] {
            assert_eq!(played(&mut started(&spec(seed, episode)), 30), rows, "{task} seed {seed} episode {episode}");
        }
    }
}

/// By the benchmark's default episodes differ in friction, light, tint and sensors, and where the task has noise in their
/// start; the room is the seed's.
#[test]
fn episodes_differ_by_default() {
    for task in [Task::S01, Task::S05, Task::S11] {
        let [mut first, mut second] = [0, 1].map(|episode| started(&EpisodeSpec::new(task, 2, episode)));
        let (a, b) = (first.domain_sample(), second.domain_sample());
        assert_eq!((a.layout, a.scale), (b.layout, PropScale::default()));
        assert!(a.hand_friction != b.hand_friction && a.light != b.light, "{task}");
        assert_eq!(a.start == b.start, task == Task::S05, "{task}");
        let (rows, others) = (played(&mut first, 10), played(&mut second, 10));
        assert!(rows[0].1 != others[0].1 && rows[10].0 != others[10].0, "{task}");
    }
}

/// A switch changes its own draws and no other.
#[test]
fn each_switch_is_its_own() {
    type Switch = fn(&mut Randomization);
    let switches: [(&str, Switch); 7] = [
        ("layout", |randomize| randomize.layout = false),
        ("start", |randomize| randomize.start = false),
        ("hand_friction", |randomize| randomize.hand_friction = false),
        ("light", |randomize| randomize.light = false),
        ("tint", |randomize| randomize.tint = false),
        ("sensors", |randomize| randomize.sensors = false),
        ("prop_scale", |randomize| randomize.prop_scale = true),
    ];
    let spec = EpisodeSpec::new(Task::S07, 5, 3);
    let tint = |light: &Light| [light.tint_hue, light.tint_saturation, light.tint_value];
    let rest = |light: &Light| [light.dome, light.dome_yaw, light.key, light.key_pitch, light.key_yaw];
    // Row 0 is at rest: what is sensed is the noise.
    let noise = |episode: &Episode| sensed(episode).joint_velocity;
    let usual = started(&spec);
    let before = usual.domain_sample();
    for (name, switch) in switches {
        let mut other = spec.clone();
        switch(&mut other.randomize);
        let episode = started(&other);
        let after = episode.domain_sample();
        let changed = [
            ("layout", before.layout != after.layout),
            ("start", before.start != after.start),
            ("hand_friction", before.hand_friction != after.hand_friction),
            ("light", rest(&before.light) != rest(&after.light)),
            ("tint", tint(&before.light) != tint(&after.light)),
            ("sensors", noise(&usual) != noise(&episode)),
            ("prop_scale", before.scale != after.scale),
        ];
        for (draw, changed) in changed {
            assert_eq!(changed, draw == name, "switch {name}, draw {draw}");
        }
        let friction = after.hand_friction.map(|hand_friction| hand_friction.dynamic_friction);
        assert_eq!(episode.scene().spec.hand_friction, friction, "{name}");
        assert_eq!(after.hand_friction.is_none(), name == "hand_friction");
    }
}

#[test]
fn the_start_has_the_noise_that_was_drawn() {
    for (task, seed) in [(Task::S01, 1), (Task::S03, 2), (Task::S08, 0)] {
        for episode in 0..4 {
            let spec = EpisodeSpec::new(task, seed, episode);
            let mut still = spec.clone();
            still.randomize.start = false;
            let (noisy, nominal) = (started(&spec), started(&still));
            let (offset, scene) = (noisy.domain_sample().start, noisy.scene());
            let (row, from) = (noisy.row(), nominal.row());
            let shift = row.robot.pose.translation.vector - from.robot.pose.translation.vector;
            let turn =
                measure::wrap_angle(measure::yaw(&row.robot.pose.rotation) - measure::yaw(&from.robot.pose.rotation));
            assert!((shift.x - offset.shift[0]).abs() < 1e-12 && (shift.y - offset.shift[1]).abs() < 1e-12, "{task}");
            assert!((turn - offset.turn).abs() < 1e-9 && offset.turn != 0.0, "{task}: {turn}");
            for (joint, limits) in scene.robot.joints().iter().enumerate() {
                let expected = (scene.robot.q0()[joint] + offset.joints[joint]).clamp(limits.lower, limits.upper);
                assert!((row.joint_position[joint] - expected).abs() < 1e-12, "{task}: {}", limits.name);
            }
            assert_eq!(nominal.domain_sample().start, StartOffset::none(JOINTS));
        }
    }
}

/// An episode is refused in any scene but its own, and the message says what differs.
#[test]
fn other_scenes_are_refused() {
    let spec = EpisodeSpec::new(Task::S07, 1, 4);
    let refused = |other: &EpisodeSpec| Episode::start(scene_of(other), &spec).unwrap_err();
    let other =
        EpisodeSpec { seed: 2, randomize: Randomization { hand_friction: false, ..spec.randomize }, ..spec.clone() };
    let message = refused(&other).to_string();
    assert!(message.contains("S07 seed 1 episode 4 plays in a scene with layout seed 1 and was given one with 2"));
    let message = refused(&EpisodeSpec { episode: 5, ..spec.clone() }).to_string();
    let [wanted, given] = [4, 5].map(|episode| HandFriction::draw(1, episode).dynamic_friction);
    let said = format!("a scene with hand friction {wanted} and was given one with {given}");
    assert!(message.contains(&said), "{message}");
    let scale = PropScale { socket: 1.05, ..PropScale::default() };
    let message = refused(&EpisodeSpec { scale, ..spec.clone() }).to_string();
    assert!(message.contains("prop scale") && message.contains("socket: 1.05"), "{message}");
    assert!(matches!(refused(&EpisodeSpec::new(Task::S01, 1, 4)), StartError::Scene { .. }));

    // A recorded layout does where it is the one of the seed.
    let scene = scene_of(&spec);
    let recorded = |layout| {
        let spec = SceneSpec { layout: Some(layout), ..scene.spec.clone() };
        Arc::new(Scene::build(&scene.config, Arc::clone(&scene.robot), spec).unwrap())
    };
    Episode::start(recorded(scene.layout), &spec).unwrap();
    let mut moved = scene.layout;
    moved.robot.position.x += 0.01;
    let message = Episode::start(recorded(moved), &spec).unwrap_err().to_string();
    assert!(message.contains("with layout the one of its layout seed"), "{message}");
}

/// Recorded layouts that make no scene of the kind are refused.
#[test]
fn broken_recordings_are_refused() {
    let scene = scene_of(&EpisodeSpec::new(Task::S07, 1, 0));
    let climb = scene_of(&EpisodeSpec::new(Task::Climb, 1, 0)).layout;
    let mut cases = vec![("bench is missing", climb)];
    let mut case = |message, change: fn(&mut fiatlux_world::Layout)| {
        let mut layout = scene.layout;
        change(&mut layout);
        cases.push((message, layout));
    };
    case("crate is missing", |layout| layout.crate_ = None);
    case("robot is not within 100 m", |layout| layout.robot.yaw = f64::NAN);
    case("ladder is not within 100 m", |layout| layout.ladder.position.x = 1e9);
    case("fixture is not between floor and ceiling", |layout| layout.world_from_fixture.translation.z = 4.2);
    case("fixture is not turned as its mount", |layout| {
        layout.world_from_fixture.rotation = nalgebra::UnitQuaternion::identity();
    });
    for (expected, layout) in cases {
        let spec = SceneSpec { layout: Some(layout), ..scene.spec.clone() };
        let error = Scene::build(&scene.config, Arc::clone(&scene.robot), spec).unwrap_err();
        assert!(matches!(error, SceneError::Recorded { .. }), "{error}");
        assert!(error.to_string().contains(expected), "{error}");
    }
}

/// A recording rebuilds the scene without a draw, and row 0 and the actions give the same rows to the bit.
#[test]
fn a_recording_plays_again_without_draws() {
    for (task, prop_scale) in
        [(Task::S01, true), (Task::S03, true), (Task::S05, false), (Task::S10, true), (Task::Climb, true)]
    {
        let mut spec = EpisodeSpec::new(task, 6, 2);
        spec.randomize.prop_scale = prop_scale;
        let mut episode = started(&spec);
        let (drawn, original) = (episode.domain_sample(), Arc::clone(episode.scene()));
        let rows: Vec<Row> = played(&mut episode, 60).into_iter().map(|(row, _)| row).collect();
        assert!(rows.len() > 30, "{task}: {:?}", episode.end());

        let rebuilt = SceneSpec {
            // No draw reads it.
            seed: u64::MAX,
            hand_friction: drawn.hand_friction.map(|hand_friction| hand_friction.dynamic_friction),
            scale: drawn.scale,
            layout: Some(drawn.layout),
            ..original.spec.clone()
        };
        let scene = Arc::new(Scene::build(&SceneConfig::default(), Arc::clone(&original.robot), rebuilt).unwrap());
        assert_eq!(scene.model.shapes(), original.model.shapes(), "{task}");
        assert_eq!(scene.model.reference_state(), original.model.reference_state(), "{task}");
        assert_eq!(scene.geometry(), original.geometry(), "{task}");
        let mut world = World::new(scene);
        world.reset_to(&rows[0]).unwrap();
        for pair in rows.windows(2) {
            let action = &pair[1].action;
            let target: [f64; JOINTS] =
                std::array::from_fn(|joint| original.robot.q0()[joint] + ACTION_SCALE * action[joint]);
            assert_eq!(world.step(action, &target).unwrap(), &pair[1], "{task} step {}", pair[1].step);
        }
    }
}

/// Digests tell apart what may change the rows, and nothing that touches none.
#[test]
fn digest_context_holds_what_rows_depend_on() {
    let context = |spec: &EpisodeSpec| spec.identity(&scene_of(spec)).context();
    let spec = EpisodeSpec { randomize: Randomization::FIXED, ..EpisodeSpec::new(Task::S07, 1, 2) };
    let changed = |change: fn(&mut EpisodeSpec)| {
        let mut other = spec.clone();
        change(&mut other);
        context(&other) != context(&spec)
    };
    assert!(changed(|spec| spec.seed = 2));
    assert!(changed(|spec| spec.episode = 3));
    assert!(changed(|spec| spec.randomize.layout = true));
    assert!(changed(|spec| spec.randomize.start = true));
    assert!(changed(|spec| spec.randomize.hand_friction = true));
    assert!(changed(|spec| spec.randomize.prop_scale = true));
    assert!(changed(|spec| spec.scale.ladder[1] = 1.01));
    assert!(!changed(|spec| spec.randomize.light = true));
    assert!(!changed(|spec| spec.randomize.tint = true));
    assert!(!changed(|spec| spec.randomize.sensors = true));
}

/// Every task starts at every corner of the range of sizes, at a ceiling and at a wall mount. A seated bulb stays seated
/// until the robot has fallen, also where its plug is wedged in a sleeve that is too small for it.
#[test]
fn tasks_start_at_every_corner_of_the_sizes() {
    let corner = |bits: u32| {
        let factors = PropScale::default().factors();
        let [x, y, z, socket, fresh_bulb] = std::array::from_fn(|i| factors[i].2[usize::from(bits >> i & 1 == 1)]);
        PropScale { ladder: [x, y, z], socket, fresh_bulb }
    };
    for bits in 0..32 {
        let scale = corner(bits);
        for task in Task::ALL {
            // Seeds 0 and 4 hang the fixture on a wall and on the ceiling.
            let seed = if (bits ^ bits >> 4) & 1 == 0 { 0 } else { 4 };
            let spec = EpisodeSpec { scale, ..EpisodeSpec::new(task, seed, bits.into()) };
            let mut episode = started(&spec);
            let row = episode.row().clone();
            let verdict = episode.judges().of(Protocol::Published).verdict();
            assert_eq!(verdict.count, task.spec().start_count, "{task} {scale:?}: {:?}", verdict.criteria);
            if matches!(task, Task::S03 | Task::S12) {
                let bulb = if task == Task::S03 { Bulb::Old } else { Bulb::Fresh };
                for _ in 0..100 {
                    if episode.step(&row.action).is_err() {
                        break;
                    }
                    assert!(episode.row().attachments[bulb as usize].seated, "{task} {scale:?}");
                }
            }
        }
    }
}

/// A carried bulb is held at the start with every friction and every size that an episode may draw: 216 starts.
#[test]
fn carried_bulbs_are_held_with_any_friction() {
    let robot = Arc::new(Robot::benchmark().unwrap());
    let [low, high] = HandFriction::DYNAMIC;
    for task in [Task::S04, Task::S05, Task::S06, Task::S09, Task::S10, Task::S11] {
        for (friction, fresh_bulb) in [(low, 1.0), (0.8, 1.0), (0.9, 0.9), (high, 1.0), (low, 0.9), (high, 1.1)] {
            for seed in 0..6 {
                let gains = robot.gains(GainSet::default());
                let spec = SceneSpec {
                    hand_friction: Some(friction),
                    scale: PropScale { fresh_bulb, ..PropScale::default() },
                    ..SceneSpec::new(fiatlux_world::SceneKind::of(task), seed, gains)
                };
                let scene = Arc::new(Scene::build(&SceneConfig::default(), Arc::clone(&robot), spec).unwrap());
                let at = format!("{task} seed {seed} friction {friction} size {fresh_bulb}");
                let mut world = start(scene, task, seed % 3, &StartOptions::default())
                    .unwrap_or_else(|error| panic!("{at}: {error}"));
                let row = world.row().clone();
                for _ in 0..15 {
                    let row = world.step(&row.action, &row.joint_target).unwrap();
                    let most = errand::HAND_FORCE
                        .iter()
                        .flat_map(|force| row.force(*force))
                        .map(|force| force.norm())
                        .fold(0.0, f64::max);
                    assert!(most > 1.0 && most < 50.0, "{at} step {}: {most} N", row.step);
                }
            }
        }
    }
}
