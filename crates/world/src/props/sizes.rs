use fiatlux_rules::{Bulb, manifest};

use crate::config::{BulbConfig, FixtureConfig, LadderConfig, SceneConfig};
use crate::{PropScale, SceneError};

/// The props whose size may vary, as they are in a scene.
#[derive(Debug, Clone, PartialEq)]
pub struct PropSizes {
    /// Ladder. Its rails stay round and as thick as they were.
    pub ladder: LadderConfig,
    /// Socket. Its mount, the rod and the height it hangs at are not scaled.
    pub fixture: FixtureConfig,
    /// Seat point of the socket on its z axis, m.
    pub seat_z: f64,
    /// Old and fresh bulb; `seat_z` is the plug point.
    pub bulbs: [BulbConfig; 2],
}

impl PropSizes {
    /// The sizes of a config's props times their factors. Masses stay.
    ///
    /// # Errors
    /// [`SceneError::Scale`] for a factor out of its range.
    pub fn new(config: &SceneConfig, scale: &PropScale) -> Result<Self, SceneError> {
        scale.check()?;
        Ok(Self {
            ladder: ladder(&config.ladder, scale.ladder),
            fixture: fixture(&config.fixture, scale.socket),
            seat_z: config.bulb.seat_z * scale.socket,
            bulbs: Bulb::ALL.map(|which| {
                let own = config.asset(place(which)).and_then(|asset| asset.bulb.as_ref());
                let nominal = own.map_or_else(|| config.bulb.clone(), |shape| config.bulb.with_shape(shape));
                bulb(&nominal, scale.bulb(which))
            }),
        })
    }
}

/// The place of a bulb among those that take objects from files.
pub(crate) fn place(bulb: Bulb) -> &'static str {
    &manifest().things[bulb.thing()].name
}

fn ladder(config: &LadderConfig, [x, y, z]: [f64; 3]) -> LadderConfig {
    let across = |[at_y, at_z]: [f64; 2]| [at_y * y, at_z * z];
    let all = |[a, b, c]: [f64; 3]| [a * x, b * y, c * z];
    LadderConfig {
        mass: config.mass,
        com_z: config.com_z * z,
        size: all(config.size),
        rail_radius: config.rail_radius,
        rail_top: across(config.rail_top),
        leg_top: across(config.leg_top),
        tread_heights: config.tread_heights.iter().map(|height| height * z).collect(),
        tread_depth: config.tread_depth * y,
        tread_thickness: config.tread_thickness * z,
        tread_half_width: config.tread_half_width * x,
        platform_x: config.platform_x.map(|at| at * x),
        platform_y: config.platform_y.map(|at| at * y),
        platform_height: config.platform_height * z,
        platform_thickness: config.platform_thickness * z,
        guard_y: config.guard_y * y,
        top_point: all(config.top_point),
    }
}

fn fixture(config: &FixtureConfig, factor: f64) -> FixtureConfig {
    let scaled = |pair: [f64; 2]| pair.map(|length| length * factor);
    FixtureConfig {
        base_half: scaled(config.base_half),
        collar_half: config.collar_half * factor,
        stop_height: config.stop_height * factor,
        mouth_height: config.mouth_height * factor,
        mouth_radius: config.mouth_radius * factor,
        sleeve_height: scaled(config.sleeve_height),
        sleeve_radius: scaled(config.sleeve_radius),
        ..config.clone()
    }
}

fn bulb(config: &BulbConfig, factor: f64) -> BulbConfig {
    BulbConfig {
        axial_inertia: config.axial_inertia * factor * factor,
        transverse_inertia: config.transverse_inertia * factor * factor,
        com_z: config.com_z * factor,
        seat_z: config.seat_z * factor,
        outline: config.outline.iter().map(|point| point.map(|length| length * factor)).collect(),
        solids: config.solids.iter().map(|solid| solid.map(|length| length * factor)).collect(),
        cap_ball_radius: config.cap_ball_radius * factor,
        cap_ring_radius: config.cap_ring_radius * factor,
        lying_height: config.lying_height * factor,
        ..config.clone()
    }
}

#[cfg(test)]
mod tests;
