use std::collections::BTreeMap;

use fiatlux_rules::{errand, manifest};

use super::parts::{
    AttachmentConfig, BenchConfig, BulbConfig, ClimbConfig, CrateConfig, FixtureConfig, LadderConfig, LayoutConfig,
    RoomConfig, StartConfig, Surfaces, ThingConfig,
};
use super::rule::{Checked, ensure, within};
use super::{SceneConfig, asset_check};
use crate::object::{ASSET_PLACES, Role};

/// Half of the largest extent of anything, m.
const FAR: f64 = 100.0;
/// Smallest part that collision handles well, m.
const THIN: f64 = 1e-4;

pub(super) fn check(config: &SceneConfig) -> Checked {
    room(&config.room)?;
    bench(&config.bench)?;
    crate_(&config.crate_)?;
    bulb(&config.bulb)?;
    fixture(&config.fixture, &config.room)?;
    ladder(&config.ladder)?;
    attachment(&config.attachment)?;
    surfaces(&config.surfaces)?;
    layout(&config.layout, &config.room)?;
    climb(&config.climb, &config.room)?;
    within("robot.pelvis_height", &[config.robot.pelvis_height], 0.1, 10.0)?;
    start(&config.start)?;
    things(&config.things)?;
    assets(config)
}

/// A size of a solid part.
fn size(field: &'static str, values: &[f64]) -> Checked {
    within(field, values, THIN, FAR)
}

fn place(field: &'static str, values: &[f64]) -> Checked {
    within(field, values, -FAR, FAR)
}

/// A lower and an upper bound.
fn interval(field: &'static str, values: &[f64; 2]) -> Checked {
    place(field, values)?;
    ensure(values[1] - values[0] >= THIN, field, values, "the second number must be larger than the first")
}

fn count(field: &'static str, value: u32, low: u32, high: u32) -> Checked {
    within(field, &[value.into()], low.into(), high.into())
}

fn room(c: &RoomConfig) -> Checked {
    for (field, values) in [
        ("room.zone_x", &c.zone_x),
        ("room.zone_y", &c.zone_y),
        ("room.wall_x", &c.wall_x),
        ("room.wall_side_y", &c.wall_side_y),
        ("room.wall_south_x", &c.wall_south_x),
        ("room.outer_x", &c.outer_x),
        ("room.outer_y", &c.outer_y),
    ] {
        interval(field, values)?;
    }
    place("room.wall_south_y", &[c.wall_south_y])?;
    let inside = |inner: &[f64; 2], outer: &[f64; 2]| inner[0] > outer[0] && inner[1] < outer[1];
    ensure(inside(&c.wall_x, &c.outer_x), "room.wall_x", &c.wall_x, "it must lie inside room.outer_x")?;
    ensure(inside(&c.wall_south_x, &c.wall_x), "room.wall_south_x", &c.wall_south_x, "it must lie inside room.wall_x")?;
    ensure(inside(&c.wall_side_y, &c.outer_y), "room.wall_side_y", &c.wall_side_y, "it must lie inside room.outer_y")?;
    ensure(
        c.wall_south_y > c.outer_y[0] && c.wall_south_y < c.wall_side_y[0],
        "room.wall_south_y",
        &c.wall_south_y,
        "it must lie between room.outer_y[0] and room.wall_side_y[0]",
    )?;
    ensure(inside(&c.zone_x, &c.wall_x), "room.zone_x", &c.zone_x, "it must lie inside room.wall_x")?;
    let depth = [c.wall_south_y, c.outer_y[1]];
    ensure(
        inside(&c.zone_y, &depth),
        "room.zone_y",
        &c.zone_y,
        "it must lie between the south wall and room.outer_y[1]",
    )?;
    size("room.wall_top", &[c.wall_top])?;
    within("room.ceiling_height", &[c.ceiling_height], 2.0, FAR)?;
    size("room.ceiling_thickness", &[c.ceiling_thickness])
}

fn bench(c: &BenchConfig) -> Checked {
    size("bench.surface_height", &[c.surface_height])?;
    size("bench.slab_half", &c.slab_half)?;
    size("bench.footprint_half", &c.footprint_half)?;
    size("bench.frame_height", &[c.frame_height])?;
    let thickness = c.surface_height - c.frame_height;
    ensure(thickness >= THIN, "bench.frame_height", &c.frame_height, "it must be below bench.surface_height")?;
    size("bench.leg_half", &c.leg_half)?;
    let inset_ok = (0..2).all(|i| (c.leg_half[i]..c.slab_half[i] - c.leg_half[i]).contains(&c.leg_inset[i]));
    ensure(inset_ok, "bench.leg_inset", &c.leg_inset, "the legs must stand below the top and apart from each other")?;
    interval("bench.beam_height", &c.beam_height)?;
    let beam_ok = c.beam_height[0] >= 0.0 && c.beam_height[1] <= c.frame_height;
    ensure(beam_ok, "bench.beam_height", &c.beam_height, "the beam must lie between floor and top")?;
    place("bench.tray_center", &c.tray_center)?;
    size("bench.tray_half", &c.tray_half)?;
    interval("bench.tray_height", &c.tray_height)?;
    size("bench.tray_wall", &[c.tray_wall])?;
    let hollow = c.tray_half.iter().all(|half| 2.0 * c.tray_wall < *half) && 2.0 * c.tray_wall < span(&c.tray_height);
    ensure(hollow, "bench.tray_wall", &c.tray_wall, "the tray would have no inside")?;
    let on_top = |p: &[f64; 2], margin: &[f64; 2]| (0..2).all(|i| p[i].abs() + margin[i] <= c.slab_half[i]);
    ensure(on_top(&c.tray_center, &c.tray_half), "bench.tray_center", &c.tray_center, "the tray must lie on the top")?;
    place("bench.bulb_spot", &c.bulb_spot)?;
    ensure(on_top(&c.bulb_spot, &[0.0, 0.0]), "bench.bulb_spot", &c.bulb_spot, "the bulb must stand on the top")?;
    let clear = (0..2).any(|i| (c.bulb_spot[i] - c.tray_center[i]).abs() >= c.tray_half[i] + 0.1);
    ensure(clear, "bench.bulb_spot", &c.bulb_spot, "it must be 0.1 m clear of the tray")
}

fn span(interval: &[f64; 2]) -> f64 {
    interval[1] - interval[0]
}

fn crate_(c: &CrateConfig) -> Checked {
    size("crate.outer_half", &c.outer_half)?;
    size("crate.interior_half", &c.interior_half)?;
    let walls = (0..2).all(|i| c.outer_half[i] - c.interior_half[i] >= THIN);
    ensure(walls, "crate.interior_half", &c.interior_half, "it must be smaller than crate.outer_half")?;
    size("crate.rim_height", &[c.rim_height])?;
    size("crate.floor_height", &[c.floor_height])?;
    ensure(c.floor_height < c.rim_height, "crate.floor_height", &c.floor_height, "it must be below crate.rim_height")?;
    within("crate.placing_height", &[c.placing_height], c.floor_height, FAR)
}

fn bulb(c: &BulbConfig) -> Checked {
    within("bulb.mass", &[c.mass], 1e-3, 10.0)?;
    within("bulb.axial_inertia", &[c.axial_inertia], 1e-8, 1.0)?;
    within("bulb.transverse_inertia", &[c.transverse_inertia], 1e-8, 1.0)?;
    ensure(
        c.axial_inertia <= 2.0 * c.transverse_inertia,
        "bulb.axial_inertia",
        &c.axial_inertia,
        "no solid has more than twice bulb.transverse_inertia",
    )?;
    place("bulb.com_z", &[c.com_z])?;
    ensure((2..=256).contains(&c.outline.len()), "bulb.outline", &c.outline.len(), "it needs 2 to 256 points")?;
    for point in &c.outline {
        within("bulb.outline", point, 0.0, 1.0)?;
    }
    let ascending = c.outline.windows(2).all(|w| w[0][0] < w[1][0]);
    ensure(ascending, "bulb.outline", &"not ascending", "the points must ascend in z")?;
    let seat_ok = c.seat_z == c.outline[0][0];
    ensure(seat_ok, "bulb.seat_z", &c.seat_z, "it must be the first z of bulb.outline, the cap's bottom")?;
    let solids = 1..=16;
    ensure(solids.contains(&c.solids.len()), "bulb.solids", &c.solids.len(), "it needs 1 to 16 entries")?;
    for solid in &c.solids {
        within("bulb.solids", &solid[..2], 0.0, 1.0)?;
        size("bulb.solids", &solid[2..])?;
        ensure(solid[1] >= solid[0], "bulb.solids", solid, "the second z must not be below the first")?;
    }
    count("bulb.cap_balls", c.cap_balls, 3, 16)?;
    size("bulb.cap_ball_radius", &[c.cap_ball_radius])?;
    size("bulb.cap_ring_radius", &[c.cap_ring_radius])?;
    size("bulb.lying_height", &[c.lying_height])
}

fn fixture(c: &FixtureConfig, room: &RoomConfig) -> Checked {
    size("fixture.height", &[c.height])?;
    let rod = room.ceiling_height - 2.0 * c.rod_radius;
    size("fixture.rod_radius", &[c.rod_radius])?;
    ensure(c.height < rod, "fixture.height", &c.height, "it must be below room.ceiling_height, with room for the rod")?;
    let roomy = span(&room.zone_x).min(span(&room.zone_y)) / 2.0;
    within("fixture.standoff_ceiling", &[c.standoff_ceiling], 0.0, roomy)?;
    within("fixture.standoff_wall", &[c.standoff_wall], 0.0, roomy)?;
    size("fixture.base_half", &c.base_half)?;
    size("fixture.collar_half", &[c.collar_half])?;
    place("fixture.stop_height", &[c.stop_height])?;
    place("fixture.mouth_height", &[c.mouth_height])?;
    let deep = c.mouth_height - c.stop_height >= THIN;
    ensure(deep, "fixture.mouth_height", &c.mouth_height, "it must be above fixture.stop_height")?;
    size("fixture.mouth_radius", &[c.mouth_radius])?;
    let walled = c.collar_half - c.mouth_radius >= THIN;
    ensure(walled, "fixture.mouth_radius", &c.mouth_radius, "it must be smaller than fixture.collar_half")?;
    interval("fixture.sleeve_height", &c.sleeve_height)?;
    interval("fixture.sleeve_radius", &c.sleeve_radius)?;
    size("fixture.sleeve_radius", &c.sleeve_radius)?;
    count("fixture.sleeve_facets", c.sleeve_facets, 6, 64)
}

fn ladder(c: &LadderConfig) -> Checked {
    within("ladder.mass", &[c.mass], 0.1, 1000.0)?;
    size("ladder.size", &c.size)?;
    within("ladder.com_z", &[c.com_z], 0.0, c.size[2])?;
    size("ladder.rail_radius", &[c.rail_radius])?;
    let stout = c.size.iter().all(|s| *s > 4.0 * c.rail_radius);
    ensure(stout, "ladder.rail_radius", &c.rail_radius, "it must be below a quarter of every ladder.size")?;
    place("ladder.rail_top", &c.rail_top)?;
    place("ladder.leg_top", &c.leg_top)?;
    let guard_z = c.size[2] - c.rail_radius;
    for (field, [y, z]) in [("ladder.rail_top", c.rail_top), ("ladder.leg_top", c.leg_top)] {
        let ok = y.abs() < 0.5 * c.size[1] && z > 2.0 * c.rail_radius && z <= c.platform_height;
        ensure(ok, field, &[y, z], "it must lie over the footprint, above the feet and not above the platform")?;
    }
    size("ladder.platform_height", &[c.platform_height])?;
    ensure(
        c.platform_height < guard_z,
        "ladder.platform_height",
        &c.platform_height,
        "it must be below the guard rail, the top of ladder.size",
    )?;
    let first = c.tread_heights.first().copied().unwrap_or(c.tread_thickness);
    size("ladder.tread_depth", &[c.tread_depth])?;
    size("ladder.tread_thickness", &[c.tread_thickness])?;
    size("ladder.tread_half_width", &[c.tread_half_width])?;
    ensure(c.tread_heights.len() <= 32, "ladder.tread_heights", &c.tread_heights.len(), "at most 32 treads")?;
    within("ladder.tread_heights", &c.tread_heights, c.tread_thickness, c.platform_height)?;
    let ascending = c.tread_heights.windows(2).all(|w| w[1] - w[0] >= c.tread_thickness);
    let rule = "the heights must ascend, a thickness apart, above the floor and below the platform";
    ensure(ascending && first >= c.tread_thickness, "ladder.tread_heights", &c.tread_heights, rule)?;
    interval("ladder.platform_x", &c.platform_x)?;
    interval("ladder.platform_y", &c.platform_y)?;
    within("ladder.platform_thickness", &[c.platform_thickness], THIN, c.platform_height)?;
    let wide = c.platform_x.iter().all(|x| x.abs() <= 0.5 * c.size[0]);
    ensure(wide, "ladder.platform_x", &c.platform_x, "the platform must not be wider than the ladder")?;
    let deep = c.platform_y.iter().all(|y| y.abs() <= 0.5 * c.size[1]);
    ensure(deep, "ladder.platform_y", &c.platform_y, "the platform must not be deeper than the ladder")?;
    let narrow = c.tread_half_width <= 0.5 * c.size[0];
    ensure(narrow, "ladder.tread_half_width", &c.tread_half_width, "the treads must not be wider than the ladder")?;
    let guard_ok = c.guard_y.abs() < 0.5 * c.size[1];
    ensure(guard_ok, "ladder.guard_y", &c.guard_y, "the guard rail must be over the footprint")?;
    place("ladder.top_point", &c.top_point)
}

fn attachment(c: &AttachmentConfig) -> Checked {
    for (field, value) in [
        ("attachment.seat_gap", c.seat_gap),
        ("attachment.seat_lateral", c.seat_lateral),
        ("attachment.release_gap", c.release_gap),
        ("attachment.hold_range", c.hold_range),
    ] {
        within(field, &[value], 1e-6, 1.0)?;
    }
    within("attachment.seat_tilt", &[c.seat_tilt], 1e-6, 3.2)?;
    count("attachment.release_steps", c.release_steps, 1, 100_000)?;
    for (field, value) in [
        ("attachment.hold_force", c.hold_force),
        ("attachment.axial_damping", c.axial_damping),
        ("attachment.axial_limit", c.axial_limit),
        ("attachment.lateral_stiffness", c.lateral_stiffness),
        ("attachment.lateral_damping", c.lateral_damping),
        ("attachment.lateral_limit", c.lateral_limit),
        ("attachment.tilt_stiffness", c.tilt_stiffness),
        ("attachment.tilt_damping", c.tilt_damping),
        ("attachment.torque_limit", c.torque_limit),
    ] {
        within(field, &[value], 0.0, 1e4)?;
    }
    Ok(())
}

fn things(things: &BTreeMap<String, ThingConfig>) -> Checked {
    let others = || manifest().things.iter().skip(errand::THINGS).map(|thing| &thing.name);
    for name in things.keys() {
        ensure(
            others().any(|other| other == name),
            "things",
            name,
            "it must be a thing of the manifest without a section of its own",
        )?;
    }
    for name in others() {
        ensure(
            things.contains_key(name),
            "things",
            name,
            "the manifest has it; describe it in a section [things.NAME]",
        )?;
    }
    for (name, thing) in things {
        within("things.NAME.mass", &[thing.mass], 1e-3, 1000.0)?;
        place("things.NAME.at", &thing.at)?;
        place("things.NAME.yaw", &[thing.yaw])?;
        within("things.NAME.surface", &[thing.surface.friction, thing.surface.static_friction], 0.0, 10.0)?;
        within("things.NAME.surface", &[thing.surface.torsion, thing.surface.rolling], 0.0, 0.1)?;
        for [low, high] in &thing.boxes {
            (0..3).try_for_each(|axis| interval("things.NAME.boxes", &[low[axis], high[axis]]))?;
        }
        for [x, y, z, radius] in &thing.balls {
            place("things.NAME.balls", &[*x, *y, *z])?;
            size("things.NAME.balls", &[*radius])?;
        }
        let rule = "it must have boxes or balls";
        ensure(!thing.boxes.is_empty() || !thing.balls.is_empty(), "things", name, rule)?;
    }
    Ok(())
}

fn assets(config: &SceneConfig) -> Checked {
    for (place, asset) in &config.assets {
        let role = ASSET_PLACES.into_iter().find(|(name, _)| name == place).map(|(_, role)| role);
        let places = ASSET_PLACES.map(|(name, _)| name).join(", ");
        ensure(role.is_some(), "assets", place, &format!("it must be one of {places}"))?;
        let is_bulb = role == Some(Role::Bulb);
        ensure(asset.bulb.is_some() == is_bulb, "assets.PLACE.bulb", place, "bulbs have it, other things do not")?;
        if let Some(shape) = &asset.bulb {
            bulb(&config.bulb.with_shape(shape))?;
            let rule = "it must be bulb.seat_z; build the object for this scene";
            ensure((shape.seat_z - config.bulb.seat_z).abs() < 1e-9, "assets.PLACE.bulb.seat_z", &shape.seat_z, rule)?;
        }
        if let Some(role) = role {
            asset_check::check(config, place, role, asset)?;
        }
    }
    Ok(())
}

fn surfaces(c: &Surfaces) -> Checked {
    let fields = [
        ("surfaces.floor", &c.floor),
        ("surfaces.room", &c.room),
        ("surfaces.bench", &c.bench),
        ("surfaces.crate", &c.crate_),
        ("surfaces.fixture", &c.fixture),
        ("surfaces.sleeve", &c.sleeve),
        ("surfaces.bulb", &c.bulb),
        ("surfaces.ladder", &c.ladder),
    ];
    for (field, surface) in fields {
        within(field, &[surface.friction, surface.static_friction], 0.0, 10.0)?;
        within(field, &[surface.torsion, surface.rolling], 0.0, 0.1)?;
    }
    Ok(())
}

fn layout(c: &LayoutConfig, room: &RoomConfig) -> Checked {
    within("layout.ceiling_probability", &[c.ceiling_probability], 0.0, 1.0)?;
    let reach = 0.5 * span(&room.zone_x).min(span(&room.zone_y));
    let panel = 0.5 * span(&room.wall_side_y).min(span(&room.wall_south_x));
    for (field, half) in [
        ("layout.fixture_inset", c.fixture_inset),
        ("layout.robot_half", c.robot_half),
        ("layout.table_half", c.table_half),
        ("layout.ladder_half", c.ladder_half),
        ("layout.crate_half", c.crate_half),
    ] {
        within(field, &[half], THIN, reach)?;
    }
    within("layout.fixture_inset", &[c.fixture_inset], THIN, panel)?;
    within("layout.gap", &[c.gap], 0.0, FAR)?;
    count("layout.placement_tries", c.placement_tries, 1, 1_000)?;
    count("layout.redraws", c.redraws, 1, 200)?;
    within("layout.robot_yaw_spread", &[c.robot_yaw_spread], 0.0, 3.2)
}

fn climb(c: &ClimbConfig, room: &RoomConfig) -> Checked {
    place("climb.ladder", &c.ladder)?;
    place("climb.robot", &c.robot)?;
    place("climb.fixture", &c.fixture)?;
    let low = c.fixture[2] > 0.0 && c.fixture[2] < room.ceiling_height - 0.1;
    ensure(low, "climb.fixture", &c.fixture, "its height must be 0.1 m or more below room.ceiling_height")?;
    for spot in &c.bulb_parking {
        place("climb.bulb_parking", spot)?;
    }
    let apart = (0..2).any(|i| (c.bulb_parking[0][i] - c.bulb_parking[1][i]).abs() > 0.1);
    ensure(apart, "climb.bulb_parking", &c.bulb_parking, "the bulbs must stand 0.1 m apart")
}

fn start(c: &StartConfig) -> Checked {
    for (field, noise) in [("start.noise", &c.noise), ("start.ladder_noise", &c.ladder_noise)] {
        within(field, &[noise.shift, noise.turn, noise.joint], 0.0, 1.0)?;
    }
    size("start.mounting_distance", &[c.mounting_distance])?;
    size("start.dispose_distance", &[c.dispose_distance])?;
    size("start.leave_distance", &[c.leave_distance])?;
    place("start.grab_place", &c.grab_place)?;
    place("start.carry_place", &c.carry_place)?;
    within("start.platform_pelvis", &[c.platform_pelvis], 0.1, 10.0)?;
    within("start.clearance", &[c.clearance], 0.0, 0.1)?;
    within("start.head_start", &[c.head_start], 0.0, 10.0)?;
    within("start.turn_step", &[c.turn_step], 0.05, 3.2)?;
    within("start.back_step", &[c.back_step], 0.0, 0.02)?;
    count("start.redraws", c.redraws, 1, 200)?;
    let carry = &c.carry;
    within("start.carry.glass_center", &carry.glass_center, -1.0, 1.0)?;
    within("start.carry.glass_height", &[carry.glass_height], 0.0, 1.0)?;
    within("start.carry.glass_tilt", &carry.glass_tilt, -3.2, 3.2)?;
    for (field, angles) in [
        ("start.carry.arm", &carry.arm),
        ("start.carry.platform_arm", &carry.platform_arm),
        ("start.carry.grip", &carry.grip),
    ] {
        within(field, &angles.values().copied().collect::<Vec<_>>(), -3.2, 3.2)?;
    }
    within("start.carry.settling_friction", &[carry.settling_friction], 0.0, 10.0)?;
    within("start.carry.holding_time", &[carry.holding_time], 0.0, 1.0)?;
    within("start.carry.settling_time", &[carry.settling_time], 0.0, 3.0 - carry.holding_time)?;
    let closing_most = 3.0 - carry.holding_time - carry.settling_time;
    within("start.carry.closing_time", &[carry.closing_time], 0.0, closing_most)
}
