#![allow(clippy::unwrap_used)]

use std::sync::Arc;

use fiatlux_dynamics::{BodyId, ShapeId};
use fiatlux_robot::{GainSet, Robot};
use fiatlux_rules::{PRESETS, Task, errand};

use super::*;
use crate::{EpisodeSpec, Scene, SceneConfig, SceneError, SceneKind, SceneSpec, ShapeOwner};

const N: usize = 12_800;

/// Largest Kolmogorov-Smirnov distance that is accepted: 1.95 / sqrt(n), which one sample in a thousand would pass by
/// chance.
fn bound(n: usize) -> f64 {
    1.95 / (n as f64).sqrt()
}

/// Kolmogorov-Smirnov distance between draws and a distribution.
fn distance(mut draws: Vec<f64>, cumulative: impl Fn(f64) -> f64) -> f64 {
    draws.sort_by(f64::total_cmp);
    let n = draws.len() as f64;
    let gap = |(i, x): (usize, &f64)| {
        let expected = cumulative(*x);
        (expected - i as f64 / n).abs().max((expected - (i + 1) as f64 / n).abs())
    };
    draws.iter().enumerate().map(gap).fold(0.0, f64::max)
}

/// Share of a uniform distribution below `x`.
fn share([low, high]: [f64; 2], x: f64) -> f64 {
    ((x - low) / (high - low)).clamp(0.0, 1.0)
}

fn assert_uniform(name: &str, draws: Vec<f64>, range: [f64; 2]) {
    assert!(draws.len() >= 10_000);
    let [low, high] = range;
    assert!(draws.iter().all(|x| (low..=high).contains(x)), "{name} leaves {low} to {high}");
    let (n, found) = (draws.len(), distance(draws, |x| share(range, x)));
    assert!(found < bound(n), "{name}: {found}");
}

/// Seed and episode of the n-th draw.
fn at(n: usize) -> (u64, u64) {
    (n as u64 / 100, n as u64 % 100)
}

type Value = (&'static str, fn(&Light) -> f64, [f64; 2]);

const LIGHTS: [Value; 8] = [
    ("dome", |light| light.dome, [600.0, 1400.0]),
    ("dome yaw", |light| light.dome_yaw.to_degrees(), [0.0, 360.0]),
    ("key", |light| light.key, [800.0, 2200.0]),
    ("key pitch", |light| light.key_pitch.to_degrees(), [-15.0, 15.0]),
    ("key yaw", |light| light.key_yaw.to_degrees(), [-30.0, 30.0]),
    ("hue", |light| light.tint_hue, [0.0, 360.0]),
    ("saturation", |light| light.tint_saturation, [0.0, 0.15]),
    ("value", |light| light.tint_value, [0.7, 1.2]),
];

#[test]
fn ranges_are_drawn_uniformly_and_apart() {
    let ranges = |given: &[(&str, [f64; 2])]| {
        EpisodeRanges::new(given.iter().map(|(name, range)| ((*name).to_owned(), *range))).unwrap()
    };
    let both = ranges(&[("gravity", [9.6, 10.0]), ("action_delay", [20.0, 60.0]), ("friction.crate", [0.3, 0.3])]);
    let draws: Vec<Varied> = (0..N).map(at).map(|(seed, episode)| both.draw(seed, episode)).collect();
    assert_uniform("gravity", draws.iter().map(|varied| varied["gravity"]).collect(), [9.6, 10.0]);
    for ms in [20.0, 40.0, 60.0] {
        let share = draws.iter().filter(|varied| varied["action_delay"] == ms).count() as f64 / N as f64;
        assert!((share - 1.0 / 3.0).abs() < 0.02, "{ms} ms: {share}");
    }
    assert!(draws.iter().all(|varied| varied["friction.crate"] == 0.3));
    assert_eq!(draws[7]["gravity"], ranges(&[("gravity", [9.6, 10.0])]).draw(0, 7)["gravity"], "a stream of its own");
    assert_eq!((noise_scale(&draws[0]), delay_steps(&Varied::new())), (1.0, None));
    assert!(matches!(delay_steps(&draws[0]), Some(1..=3)));
}

/// Variation of pictures changes no scene, and an episode without it has none.
#[test]
fn cameras_vary_apart_from_the_scene() {
    let given: Vec<_> = camera::CAMERA_RANGES.iter().map(|(name, range, _)| ((*name).to_owned(), *range)).collect();
    let ranges = EpisodeRanges::new(given).unwrap();
    let spec = EpisodeSpec { ranges, ..EpisodeSpec::new(Task::S05, 3, 1) };
    let drawn = spec.camera().unwrap();
    assert_eq!(drawn.stream, (3, 1));
    assert!(drawn.pattern <= 8 && drawn.delay_steps <= 5 && drawn.shift.iter().all(|shift| shift.abs() <= 0.1));
    let plain = EpisodeSpec::new(Task::S05, 3, 1);
    assert_eq!(plain.camera(), None);
    let gains = Robot::by_name("g1_inspire").unwrap().gains(GainSet::default());
    assert_eq!(spec.scene(gains.clone()).varied, plain.scene(gains).varied);
    let all: std::collections::BTreeSet<usize> =
        (0..200).map(|episode| EpisodeSpec { episode, ..spec.clone() }.camera().unwrap().pattern).collect();
    assert_eq!(all.into_iter().collect::<Vec<_>>(), (0..=8).collect::<Vec<_>>());
}

#[test]
fn ranges_that_cannot_be_drawn_from_are_refused() {
    for (name, range, words) in [
        ("wind", [0.0, 1.0], "'wind' has no range; use gravity, noise, "),
        ("friction.moon", [0.0, 1.0], "'friction.moon' has no range"),
        ("thing_mass.crate", [1.0, 1.0], "'thing_mass.crate' has no range"),
        ("gravity", [10.0, 9.0], "gravity is from 10 to 9"),
        ("gravity", [9.0, 101.0], "from 0 to 100 m/s^2"),
        ("noise", [f64::NAN, 1.0], "noise is from NaN"),
        ("action_delay", [0.0, 30.0], "in steps of 20"),
        ("thing_mass.ladder", [0.0, 1.0], "from 0.01 to 100"),
        ("gains", [0.0, 1.0], "from 0.5 to 2"),
        ("robot_mass", [1.0, 3.0], "from 0.5 to 2"),
        ("hand_friction", [-0.1, 0.5], "from 0 to 10"),
        ("camera.tilt", [0.0, 0.1], "camera.exposure"),
        ("camera.angle", [0.1, 1.0], "from 0.5 to 1.5"),
        ("camera.delay", [0.0, 10.0], "in steps of 20"),
        ("camera.pattern", [0.0, 2.5], "as a whole number"),
        ("camera.look", [1.0, 1.5], "as a whole number"),
        ("camera.look", [0.0, 1.0], "from 1 to 2"),
    ] {
        let error = EpisodeRanges::new([(name.to_owned(), range)]).unwrap_err().to_string();
        assert!(error.contains(words), "{error}");
    }
}

/// Every range of a preset can be drawn, and what is drawn reaches the model: masses, drives, hands, soles and treads.
#[test]
fn a_preset_changes_the_whole_scene() {
    let robot = Arc::new(Robot::by_name("g1_inspire").unwrap());
    for (_, preset) in PRESETS {
        let ranges = EpisodeRanges::new(preset.iter().map(|(name, range)| ((*name).to_owned(), *range))).unwrap();
        let varied = ranges.draw(1000, 3);
        let spec = SceneSpec::new(SceneKind::CoupledLadder, 1000, robot.gains(GainSet::default()));
        let build = |varied| {
            let spec = SceneSpec { varied, ..spec.clone() };
            Scene::build(&SceneConfig::default(), Arc::clone(&robot), spec).unwrap()
        };
        let [nominal, scene] = [Varied::new(), varied.clone()].map(build);
        let mass = |scene: &Scene, body: BodyId| scene.model.bodies()[body.0].spec.mass;
        let near = |found: f64, expected: f64| assert!((found - expected).abs() < 1e-12, "{found}, not {expected}");
        for body in scene.robot_ids.joints.iter().map(|joint| joint.body).chain([scene.robot_ids.root]) {
            near(mass(&scene, body), mass(&nominal, body) * varied["robot_mass"]);
        }
        let ladder = scene.body(errand::LADDER).unwrap();
        near(mass(&scene, ladder), mass(&nominal, ladder));
        for ((_, drive), (_, before)) in scene.model.drives().iter().zip(nominal.model.drives()) {
            near(drive.stiffness, before.stiffness * varied["gains"]);
            near(drive.damping, before.damping * varied["gains"]);
            assert_eq!(drive.effort_limit, before.effort_limit);
        }
        for (index, shape) in scene.model.shapes().iter().enumerate() {
            let expected = match scene.owner(ShapeId(index)) {
                ShapeOwner::Robot(link) if robot.is_hand_surface(link) => varied["hand_friction"],
                ShapeOwner::Robot(link) if robot.feet().contains(&link) => varied["floor_friction"],
                ShapeOwner::Floor => varied["floor_friction"],
                ShapeOwner::LADDER => varied["friction.ladder"],
                _ => nominal.model.shapes()[index].material.friction,
            };
            near(shape.material.friction, expected);
        }
    }
}

#[test]
fn light_and_tint_are_uniform() {
    let lights: Vec<Light> =
        (0..N).map(at).map(|(seed, episode)| Light::draw(seed, episode, &Randomization::default())).collect();
    for (name, value, range) in LIGHTS {
        assert_uniform(name, lights.iter().map(value).collect(), range);
    }
}

#[test]
fn prop_scales_are_uniform() {
    let scales: Vec<PropScale> = (0..N as u64).map(PropScale::draw).collect();
    let published = [[0.95, 1.05], [0.95, 1.05], [0.95, 1.10], [0.9, 1.1], [0.9, 1.1]];
    for (i, range) in published.into_iter().enumerate() {
        let name = scales[0].factors()[i].0;
        assert_uniform(name, scales.iter().map(|scale| scale.factors()[i].1).collect(), range);
    }
    assert!(scales.iter().all(|scale| scale.check().is_ok()));
}

/// Over the materials of many seeds: the static coefficient is uniform, and the dynamic one is the lesser of a uniform
/// one and it, so that 1 - F(x) = (1 - D(x)) (1 - S(x)).
#[test]
fn hand_friction_is_as_published() {
    let (fixed, moving) = ([0.8, 1.2], [0.7, 1.1]);
    let frictions: Vec<HandFriction> = (0..N as u64).map(|n| HandFriction::material(n / 64, (n % 64) as u32)).collect();
    assert_uniform("static", frictions.iter().map(|friction| friction.static_friction).collect(), fixed);
    let dynamic: Vec<f64> = frictions.iter().map(|friction| friction.dynamic_friction).collect();
    assert!(dynamic.iter().all(|x| (0.7..=1.1).contains(x)));
    assert!(frictions.iter().all(|friction| friction.dynamic_friction <= friction.static_friction));
    let found = distance(dynamic, |x| 1.0 - (1.0 - share(moving, x)) * (1.0 - share(fixed, x)));
    assert!(found < bound(N), "{found}");
}

/// Each episode has one of its seed's 64 materials, each of them alike.
#[test]
fn episodes_pick_among_the_materials_of_their_seed() {
    let mut counts = [0_u32; 64];
    for (seed, episode) in (0..N).map(at) {
        let friction = HandFriction::draw(seed, episode);
        assert_eq!(friction, HandFriction::material(seed, friction.bucket));
        counts[friction.bucket as usize] += 1;
    }
    // Chi-square with 63 degrees of freedom: 103 is passed once in a thousand.
    let expected = N as f64 / 64.0;
    let chi_square: f64 = counts.iter().map(|&count| (f64::from(count) - expected).powi(2) / expected).sum();
    assert!(chi_square < 103.0, "{chi_square}");
}

/// The largest number that a stream gives does not round to beyond a range.
#[test]
fn no_draw_rounds_beyond_its_range() {
    let most = 1.0 - (-53_f64).exp2();
    let [x, y, z] = PropScale::LADDER;
    let lights = [Light::DOME, Light::DOME_YAW, Light::KEY, Light::KEY_PITCH, Light::KEY_YAW];
    let tints = [Light::TINT_HUE, Light::TINT_SATURATION, Light::TINT_VALUE];
    let sizes = [x, y, z, PropScale::SOCKET, PropScale::FRESH_BULB];
    for [low, high] in lights.into_iter().chain(tints).chain(sizes).chain([HandFriction::STATIC, HandFriction::DYNAMIC])
    {
        let last = low + (high - low) * most;
        assert!(low < high && last <= high, "{last} of {low} to {high}");
    }
}

#[test]
fn draws_repeat_and_differ_by_seed_and_episode() {
    let light = |seed, episode| Light::draw(seed, episode, &Randomization::default());
    assert_eq!(light(3, 5), light(3, 5));
    assert!(light(3, 5) != light(3, 6) && light(3, 5) != light(4, 5));
    assert_eq!(HandFriction::draw(3, 5), HandFriction::draw(3, 5));
    assert_ne!(HandFriction::material(3, 5), HandFriction::material(4, 5));
    assert_eq!(PropScale::draw(3), PropScale::draw(3));
    assert_ne!(PropScale::draw(3), PropScale::draw(4));
}

/// Light and tint do not share numbers: without one, the other is as it was.
#[test]
fn light_and_tint_are_independent() {
    let usual = Randomization::default();
    let [both, no_light, no_tint, neither] =
        [usual, Randomization { light: false, ..usual }, Randomization { tint: false, ..usual }, Randomization::FIXED]
            .map(|randomize| Light::draw(7, 2, &randomize));
    let nominal = Light::default();
    let tint = |light: &Light, of: &Light| Light {
        tint_hue: of.tint_hue,
        tint_saturation: of.tint_saturation,
        tint_value: of.tint_value,
        ..*light
    };
    assert_eq!(no_light, tint(&nominal, &both));
    assert_eq!(no_tint, tint(&both, &nominal));
    assert_eq!(neither, nominal);
    for (name, value, _) in LIGHTS {
        assert_ne!(value(&both), value(&nominal), "{name}");
    }
}

/// A factor beyond its limits is refused by name, value and limits; the limits themselves are not.
#[test]
fn sizes_out_of_range_are_refused() {
    let with = |change: fn(&mut PropScale, f64), value: f64| {
        let mut scale = PropScale::default();
        change(&mut scale, value);
        scale.check()
    };
    type Change = fn(&mut PropScale, f64);
    let cases: [(&str, Change, [f64; 2]); 5] = [
        ("ladder_x", |scale, value| scale.ladder[0] = value, PropScale::LADDER[0]),
        ("ladder_y", |scale, value| scale.ladder[1] = value, PropScale::LADDER[1]),
        ("ladder_z", |scale, value| scale.ladder[2] = value, PropScale::LADDER[2]),
        ("socket", |scale, value| scale.socket = value, PropScale::SOCKET),
        ("fresh_bulb", |scale, value| scale.fresh_bulb = value, PropScale::FRESH_BULB),
    ];
    for (name, change, [low, high]) in cases {
        assert!(with(change, low).is_ok() && with(change, high).is_ok(), "{name}");
        for value in [low.next_down(), high.next_up(), f64::NAN, f64::INFINITY, -1.0] {
            let error = with(change, value).unwrap_err();
            assert!(matches!(error, SceneError::Scale { .. }));
            assert_eq!(error.to_string(), format!("prop scale: {name} is {value}; it must be within {low} and {high}"));
        }
    }
}

/// Guards against any change of the draws: published results name episodes by seed.
#[test]
fn draws_are_those_of_published_results() {
    let light = Light::draw(3, 5, &Randomization::default());
    let (friction, scale) = (HandFriction::draw(3, 5), PropScale::draw(3));
    let found = [light.dome, light.tint_hue, friction.dynamic_friction, friction.static_friction, scale.ladder[2]];
    assert_eq!(found, [619.0887269142339, 355.8124626608076, 0.9088784643767716, 1.091365566391993, 0.994185491129205]);
    assert_eq!(friction.bucket, 14);
}
