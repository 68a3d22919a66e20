//! A bulb falls onto a plate, touches it, and does not go through it.

use fiatlux_dynamics::{BodyId, Geometry};
use fiatlux_world::{Object, SceneConfig};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

use super::{Check, Findings, Trial};
use crate::error::TrialError;
use crate::rig::{Base, Setup, steps};

/// Heights of the bulb's lowest point above the plate, m.
const HEIGHTS: [f64; 2] = [0.05, 0.15];
/// Tilts about x, rad: cap down to glass down.
const TILTS: [f64; 4] = [0.0, 0.8, 1.6, 3.1];
/// Half extents of the plate, and the height of its top, m.
const PLATE: [f64; 3] = [0.2, 0.2, 0.01];
const TOP: f64 = 0.5;
/// Time in which it must touch the plate, and the whole time, s.
const TIMES: [f64; 2] = [0.5, 1.5];
/// Deepest overlap with the plate, m.
const DEPTH: f64 = 3e-3;

pub(super) fn trials(config: &SceneConfig, bulb: &Object) -> Result<Vec<Trial>, TrialError> {
    let cases = HEIGHTS.iter().flat_map(|height| TILTS.iter().map(move |tilt| (*height, *tilt)));
    cases.map(|(height, tilt)| one(config, bulb, height, tilt)).collect()
}

fn one(config: &SceneConfig, bulb: &Object, height: f64, tilt: f64) -> Result<Trial, TrialError> {
    let turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), tilt);
    let mut lowest = f64::INFINITY;
    for part in bulb.parts(0, config)? {
        let pose = turn * part.prop_from_part;
        let down = pose.inverse_transform_vector(&-Vector3::z());
        lowest = lowest.min(pose.translation.z - part.geometry.reach(&down));
    }
    let mut setup = Setup::new(config)?;
    let half_extents = Vector3::from(PLATE);
    let plate = Isometry3::translation(0.0, 0.0, TOP - PLATE[2]);
    let material = config.surfaces.bench.material();
    setup.add_shape(BodyId::WORLD, "plate", plate, Geometry::Cuboid { half_extents }, material)?;
    // The centre of mass is over the plate's middle.
    let com = turn * Vector3::from(bulb.links[0].com);
    let pose = Isometry3::from_parts(Translation3::new(-com.x, -com.y, TOP + height - lowest), turn);
    let placed = setup.add_object(bulb, "", pose, Base::Free, None)?;
    let mut rig = setup.build()?;

    let (mut first, mut peak, mut deepest) = (None, 0.0_f64, 0.0_f64);
    for step in 0..steps(TIMES[1]) {
        rig.step(&[], &[]);
        let (force, depth) = rig.touch(|shape| shape.name == "plate", |shape| shape.body != BodyId::WORLD);
        if force > 0.0 && first.is_none() {
            first = Some(step + 1);
        }
        (peak, deepest) = (peak.max(force), deepest.max(depth));
    }
    let mut findings = Findings::default();
    let first = first.map_or(f64::INFINITY, |step| step as f64 * fiatlux_world::PHYSICS_DT);
    findings.within("contact_after_s", first, 0.0, TIMES[0]);
    findings.within("overlap_m", deepest, 0.0, DEPTH);
    findings.measure("peak_force_n", peak);
    let at = rig.pose(placed.bodies[0]) * nalgebra::Point3::from(Vector3::from(bulb.links[0].com));
    let beside = at.x.abs() > PLATE[0] || at.y.abs() > PLATE[1];
    findings.require(beside || at.z > TOP - PLATE[2], "it went through the plate");
    findings.require(rig.is_finite() && rig.unconverged == 0, "the simulation did not converge");
    Ok(findings.trial(Check::BulbDrop, &[bulb], format!("height {height} m, tilt {tilt} rad")))
}
