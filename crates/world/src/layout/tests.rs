#![allow(clippy::unwrap_used)]

use serde::Deserialize;

use super::*;

/// A room of `tests/oracle/rooms.py`.
#[derive(Deserialize)]
struct Published {
    seed: u64,
    mount: String,
    fixture: [f64; 3],
    anchor: [f64; 3],
    ladder: [f64; 3],
    robot: [f64; 3],
    bench: [f64; 2],
    #[serde(rename = "crate")]
    crate_: [f64; 2],
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

/// The anchor keeps to the floor's inset: where that moves it, the ladder is nearer to the fixture, as published.
fn is_moved(config: &SceneConfig, layout: &Layout) -> bool {
    let (room, inset) = (&config.room, config.layout.fixture_inset);
    let on_edge = |value: f64, zone: [f64; 2]| value == zone[0] + inset || value == zone[1] - inset;
    on_edge(layout.anchor.position.x, room.zone_x) || on_edge(layout.anchor.position.y, room.zone_y)
}

#[test]
fn coupled_ladder_stands_before_the_fixture_steps_away() {
    let config = SceneConfig::default();
    let mut moved = Vec::new();
    for seed in 0..200 {
        let free = Layout::draw(&config, seed, LadderStart::Free).unwrap();
        let coupled = Layout::draw(&config, seed, LadderStart::Coupled).unwrap();
        assert_eq!(Layout { ladder: free.ladder, ..coupled }, free, "seed {seed}: the room differs");
        // Walls may move the ladder off it: see below.
        let ladder = coupled.anchor.world_from_place(0.0);
        let fixture = coupled.world_from_fixture.translation.vector;
        let away = (ladder.translation.vector - fixture).xy();
        let standoff = if coupled.mount == Mount::Ceiling { 0.48 } else { 0.60 };
        // The socket opens downwards, or towards the ladder.
        let axis = coupled.world_from_fixture.rotation * Vector3::z();
        let expected = if coupled.mount == Mount::Ceiling { -Vector3::z() } else { away.push(0.0) / standoff };
        assert!((axis - expected).norm() < 1e-12, "seed {seed}: {axis}");
        let steps = ladder.rotation * -Vector3::y();
        if is_moved(&config, &coupled) {
            moved.push(seed);
            assert!(away.norm() < standoff && steps.xy().dot(&away) > 0.0, "seed {seed}");
            continue;
        }
        assert!((away.norm() - standoff).abs() < 1e-12, "seed {seed}");
        assert!((steps.xy().dot(&away) / standoff - 1.0).abs() < 1e-12, "seed {seed}");
        let top = measure::world_point(&ladder, &Vector3::new(0.0, 0.10, 1.18));
        assert!((measure::horizontal_distance(&top, &fixture) - (standoff - 0.10)).abs() < 1e-12, "seed {seed}");
    }
    assert_eq!(moved, [67, 165]);
}

/// True if a ladder of the nominal size would stand in a wall. Tries the points of a grid.
fn in_wall(config: &SceneConfig, place: &Place) -> bool {
    let ladder = place.world_from_place(0.0);
    let [half_x, half_y] = [config.ladder.size[0] / 2.0, config.ladder.size[1] / 2.0];
    (0..=600).any(|i| {
        (0..=980).any(|j| {
            let local = Vector3::new(half_x * (f64::from(i) / 300.0 - 1.0), half_y * (f64::from(j) / 490.0 - 1.0), 0.0);
            let point = measure::world_point(&ladder, &local);
            let room = &config.room;
            // The panels run at 45 degrees.
            let to_panel = room.wall_x[1] - room.wall_side_y[0];
            let [x, y] = [point.x.abs(), point.y];
            y < room.wall_south_y || x - y > to_panel || (x > room.wall_south_x[1] && y > room.wall_side_y[1])
        })
    })
}

/// A coupled ladder is at the published place, but for rooms in which that is in a wall: there it is moved just out.
#[test]
fn coupled_ladders_stand_clear_of_the_walls() {
    let config = SceneConfig::default();
    let mut moved = Vec::new();
    for seed in 0..400 {
        let layout = Layout::draw(&config, seed, LadderStart::Coupled).unwrap();
        let by = (layout.ladder.position - layout.anchor.position).norm();
        assert_eq!(layout.ladder.yaw, layout.anchor.yaw, "seed {seed}");
        if by > 0.0 {
            assert!(in_wall(&config, &layout.anchor) && !in_wall(&config, &layout.ladder), "seed {seed}");
            moved.push((seed, (by * 1e3) as u32));
        } else if layout.anchor.position.x.abs() > 3.1 || layout.anchor.position.y < -2.7 {
            assert!(!in_wall(&config, &layout.anchor), "seed {seed}");
        }
    }
    let expected = [(59, 11), (174, 18), (208, 69), (218, 79), (236, 63), (286, 47), (315, 21), (357, 89), (381, 245)];
    assert_eq!(moved, expected, "seed and millimetres");
}

/// Seed n is the published room n. The fixture was drawn by Python; a difference of 1e-12 is that of two libraries of
/// trigonometry.
#[test]
fn rooms_are_the_published_ones() {
    #[derive(Deserialize)]
    struct Fixture {
        rooms: Vec<Published>,
    }
    let fixture: Fixture = serde_json::from_str(include_str!("../../../../tests/oracle/fixtures/rooms.json")).unwrap();
    let config = SceneConfig::default();
    let turned = |place: Place, yaw: f64| measure::wrap_angle(place.yaw - yaw);
    for (index, room) in fixture.rooms.iter().enumerate() {
        let seed = room.seed;
        assert_eq!(seed, index as u64);
        let layout = Layout::draw(&config, seed, LadderStart::Free).unwrap();
        assert_eq!(format!("{:?}", layout.mount).to_lowercase(), room.mount, "seed {seed}");
        let fixture = layout.world_from_fixture.translation.vector - Vector3::from(room.fixture);
        assert!(fixture.amax() < 1e-12, "seed {seed}: fixture");
        for (name, place, [x, y, yaw]) in [
            ("anchor", layout.anchor, room.anchor),
            ("ladder", layout.ladder, room.ladder),
            ("robot", layout.robot, room.robot),
        ] {
            assert!((place.position - Vector2::new(x, y)).amax() < 1e-12, "seed {seed}: {name}");
            assert!(turned(place, yaw).abs() < 1e-12, "seed {seed}: {name} is turned by {}", turned(place, yaw));
        }
        for (name, center, published) in [("bench", layout.bench, room.bench), ("crate", layout.crate_, room.crate_)] {
            assert!((center.unwrap() - Vector2::from(published)).amax() < 1e-12, "seed {seed}: {name}");
        }
    }
    assert_eq!(fixture.rooms.len(), 64);
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
