#![allow(clippy::unwrap_used)]

use super::*;

/// (config text, field or word that the message must name, line)
const BAD: &[(&str, &str, usize)] = &[
    ("[room\n", "", 1),
    ("[romm]\nwall_top = 3.0", "romm", 1),
    ("[room]\nwall_top = 3.0\nwall_tpo = 3.0", "wall_tpo", 3),
    ("[room]\nwall_top = '3'", "string", 2),
    ("[room]\nwall_x = [1.0]", "length", 2),
    ("room = 3", "RoomConfig", 1),
    ("\n\n[room]\nceiling_height = nan", "room.ceiling_height", 4),
    ("[room]\nzone_x = [4.0, -4.0]", "room.zone_x", 2),
    ("[room]\nzone_x = [-9.0, 4.0]", "room.zone_x", 2),
    ("[room]\nwall_south_y = -2.0", "room.wall_south_y", 2),
    ("[bench]\nsurface_height = -1.0", "bench.surface_height", 2),
    ("[bench]\nslab_half = [1e9, 1.0]", "bench.slab_half", 2),
    ("[bench]\nbulb_spot = [0.75, 0.0]", "bench.bulb_spot", 2),
    ("[bench]\nbulb_spot = [2.0, 0.0]", "bench.bulb_spot", 2),
    ("[bench]\ntray_wall = 0.05", "bench.tray_wall", 2),
    ("[crate]\ninterior_half = [0.31, 0.1]", "crate.interior_half", 2),
    ("[crate]\nfloor_height = 0.2", "crate.floor_height", 2),
    ("[fixture]\nheight = 4.5", "fixture.height", 2),
    ("[fixture]\nheight = inf", "fixture.height", 2),
    ("[fixture]\nsleeve_facets = 4000000000", "fixture.sleeve_facets", 2),
    ("[fixture]\nmouth_radius = 0.05", "fixture.mouth_radius", 2),
    ("[bulb]\nmass = 0", "bulb.mass", 2),
    ("[bulb]\naxial_inertia = 1.0", "bulb.axial_inertia", 2),
    ("[bulb]\noutline = []", "bulb.outline", 2),
    ("[bulb]\noutline = [[0.1, 0.0], [0.1, 0.1]]", "bulb.outline", 2),
    ("[bulb]\nsolids = [[0.2, 0.1, 0.01]]", "bulb.solids", 2),
    ("[ladder]\ntread_heights = [0.47, 0.235]", "ladder.tread_heights", 2),
    ("[ladder]\ntread_heights = [0.47, inf]", "ladder.tread_heights", 2),
    ("[ladder]\nplatform_height = 1.9", "ladder.platform_height", 2),
    ("[ladder]\nrail_radius = 0.5", "ladder.rail_radius", 2),
    ("[ladder]\nmass = -10.9", "ladder.mass", 2),
    ("[attachment]\nhold_range = 0.0", "attachment.hold_range", 2),
    ("[attachment]\nrelease_steps = -1", "release_steps", 2),
    ("[surfaces]\nbulb.friction = -0.1", "surfaces.bulb", 2),
    ("[surfaces]\nbulb = 1.0", "Surface", 2),
    ("[layout]\nredraws = 0", "layout.redraws", 2),
    ("[layout]\nredraws = 201", "layout.redraws", 2),
    ("[layout]\nplacement_tries = 1001", "layout.placement_tries", 2),
    ("[layout]\ntable_half = 4.0", "layout.table_half", 2),
    ("[climb]\nfixture = [0.0, 0.0, 9.0]", "climb.fixture", 2),
    ("[climb]\nbulb_parking = [[0.0, 0.0], [0.0, 0.0]]", "climb.bulb_parking", 2),
    ("[robot]\npelvis_height = -inf", "robot.pelvis_height", 2),
    ("[start]\nnoise.joint = -0.1", "start.noise", 2),
    ("[start]\nredraws = 201", "start.redraws", 2),
    ("[start]\nturn_step = 0.04", "start.turn_step", 2),
    ("[start]\nmounting_distance = nan", "start.mounting_distance", 2),
    ("[start.carry]\nclosing_time = 2.9", "start.carry.closing_time", 2),
    ("[start.carry]\narm.right_elbow_joint = inf", "start.carry.arm", 2),
];

#[test]
fn bad_configs_are_refused_by_field_and_line() {
    for (text, named, line) in BAD {
        let error = SceneConfig::from_toml(text).expect_err(text);
        let (SceneError::Toml { line: found, .. } | SceneError::Value { line: found, .. }) = &error else {
            panic!("{text}: {error}");
        };
        let message = error.to_string();
        assert!(message.contains(named), "{text}: {message}");
        assert!(*found == Some(*line), "{text}: {message}");
    }
}

#[test]
fn text_changes_only_what_it_names() {
    let changed = SceneConfig::from_toml("[ladder]\nmass = 12.0\n[surfaces.bulb]\nfriction = 0.5").unwrap();
    let mut expected = SceneConfig::default();
    expected.ladder.mass = 12.0;
    expected.surfaces.bulb.friction = 0.5;
    assert_eq!(changed, expected);
}

#[test]
fn config_survives_a_round_trip() {
    let config = SceneConfig::default();
    assert_eq!(SceneConfig::from_toml(PUBLISHED_SCENE).unwrap(), config);
    assert_eq!(SceneConfig::from_toml(&toml::to_string(&config).unwrap()).unwrap(), config);
}
