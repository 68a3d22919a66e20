#![allow(clippy::unwrap_used)]

use sha2::{Digest, Sha256};

use super::*;

fn numbers(layout: &Layout) -> Vec<f64> {
    let fixture = layout.world_from_fixture;
    let mut all: Vec<f64> = fixture.translation.vector.iter().chain(fixture.rotation.coords.iter()).copied().collect();
    for place in [layout.anchor, layout.ladder, layout.robot] {
        all.extend([place.position.x, place.position.y, place.yaw]);
    }
    for center in [layout.bench, layout.crate_].into_iter().flatten() {
        all.extend(center.iter());
    }
    all
}

fn digest(layout: &Layout) -> String {
    let mut hash = Sha256::new();
    numbers(layout).iter().for_each(|x| hash.update(x.to_le_bytes()));
    hash.finalize()[..8].iter().map(|byte| format!("{byte:02x}")).collect()
}

#[test]
fn rooms_of_a_thousand_seeds_are_valid() {
    let config = SceneConfig::default();
    let (room, zones) = (&config.room, &config.layout);
    let mut mounts = [0; 4];
    for seed in 0..1000 {
        let layout = Layout::draw(&config, seed, LadderStart::Free).unwrap();
        mounts[layout.mount as usize] += 1;
        let placed = [
            (layout.anchor.position, zones.fixture_inset),
            (layout.bench.unwrap(), zones.table_half),
            (layout.ladder.position, zones.ladder_half),
            (layout.robot.position, zones.robot_half),
            (layout.crate_.unwrap(), zones.crate_half),
        ];
        for (i, (place, half)) in placed.iter().enumerate() {
            for (other, other_half) in &placed[..i] {
                assert!((place - other).amax() >= half + other_half + zones.gap, "seed {seed}");
            }
            // A wall's anchor may reach over the zone's edge by a hand's breadth.
            let slack = if i == 0 { 0.02 } else { 0.0 };
            for (value, zone) in [(place.x, room.zone_x), (place.y, room.zone_y)] {
                assert!(value - half >= zone[0] - slack && value + half <= zone[1] + slack, "seed {seed}: zone {i}");
            }
        }
        assert_eq!(layout.world_from_fixture.translation.z, 2.2);
        let robot = layout.robot.world_from_place(0.79);
        let bench = layout.bench.unwrap();
        let facing = measure::facing_angle(&robot, &Vector3::new(bench.x, bench.y, 0.0));
        assert!(facing.abs() <= 15.0_f64.to_radians() + 1e-12, "seed {seed}: {facing}");
    }
    assert!((450..550).contains(&mounts[0]) && mounts[1..].iter().all(|n| (120..220).contains(n)), "{mounts:?}");
}

#[test]
fn coupled_ladder_stands_before_the_fixture_steps_away() {
    let config = SceneConfig::default();
    for seed in 0..200 {
        let free = Layout::draw(&config, seed, LadderStart::Free).unwrap();
        let coupled = Layout::draw(&config, seed, LadderStart::Coupled).unwrap();
        assert_eq!(Layout { ladder: free.ladder, ..coupled }, free, "seed {seed}: the room differs");
        let ladder = coupled.ladder.world_from_place(0.0);
        let fixture = coupled.world_from_fixture.translation.vector;
        let away = (ladder.translation.vector - fixture).xy();
        let standoff = if coupled.mount == Mount::Ceiling { 0.48 } else { 0.60 };
        assert!((away.norm() - standoff).abs() < 1e-12, "seed {seed}");
        let steps = ladder.rotation * -Vector3::y();
        assert!((steps.xy().dot(&away) / standoff - 1.0).abs() < 1e-12, "seed {seed}");
        let top = measure::world_point(&ladder, &Vector3::new(0.0, 0.10, 1.18));
        assert!((measure::horizontal_distance(&top, &fixture) - (standoff - 0.10)).abs() < 1e-12, "seed {seed}");
        // The socket opens downwards, or towards the ladder.
        let axis = coupled.world_from_fixture.rotation * Vector3::z();
        let expected = if coupled.mount == Mount::Ceiling { -Vector3::z() } else { away.push(0.0) / standoff };
        assert!((axis - expected).norm() < 1e-12, "seed {seed}: {axis}");
    }
}

/// Guards against any change of the draw: published results name rooms by seed.
#[test]
fn rooms_do_not_change() {
    let config = SceneConfig::default();
    let digests: Vec<String> =
        (0..4).map(|seed| digest(&Layout::draw(&config, seed, LadderStart::Coupled).unwrap())).collect();
    assert_eq!(digests, ["55f6d5743785c773", "9aeb39d46d9bbffe", "e1bad61eee9119af", "6a3cbaf5c43e82fd"]);
}

#[test]
fn zones_that_cannot_fit_are_an_error() {
    let config = SceneConfig::from_toml("[layout]\ngap = 3.0\nredraws = 3").unwrap();
    let error = Layout::draw(&config, 5, LadderStart::Free).unwrap_err();
    assert!(error.to_string().contains("seed 5 after 3 draws: 'ladder'"), "{error}");
}

#[test]
fn climb_is_fixed() {
    let layout = Layout::climb(&SceneConfig::default());
    let ladder = layout.ladder.world_from_place(0.0);
    // The steps look at the robot.
    assert!((ladder.rotation * -Vector3::y() + Vector3::x()).norm() < 1e-12);
    assert_eq!(layout.world_from_fixture.translation.vector, Vector3::new(1.9, 0.0, 2.8));
    assert_eq!(layout.robot, Place { position: Vector2::new(0.75, 0.0), yaw: 0.0 });
}
