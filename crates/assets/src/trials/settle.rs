//! Dropped from a small height, an object comes to rest on the floor.

use fiatlux_world::{Object, SceneConfig};
use nalgebra::{Isometry3, Vector3};

use super::{Check, Findings, Trial};
use crate::error::TrialError;
use crate::rig::{Base, Rig, Setup, steps};

/// Height of the fall, m, and turn about the vertical, rad.
const CASES: [(f64, f64); 3] = [(0.01, 0.0), (0.03, 1.0), (0.05, 2.0)];
/// Time to settle, and the time after it in which the object rests, s.
const TIMES: [f64; 2] = [6.0, 0.5];
/// Largest speeds at rest, m/s and rad/s.
const AT_REST: [f64; 2] = [0.01, 0.05];
/// Deepest overlap with the floor at rest, m.
const DEPTH: f64 = 2e-3;
/// Farthest from where it fell, m.
const DRIFT: f64 = 1.0;

pub(super) fn trials(config: &SceneConfig, object: &Object) -> Result<Vec<Trial>, TrialError> {
    CASES.iter().map(|&(height, yaw)| one(config, object, height, yaw)).collect()
}

fn one(config: &SceneConfig, object: &Object, height: f64, yaw: f64) -> Result<Trial, TrialError> {
    let mut setup = Setup::new(config)?;
    let lift = height - lowest(config, object)?;
    let pose = Isometry3::new(Vector3::z() * lift, Vector3::z() * yaw);
    let placed = setup.add_object(object, "", pose, Base::Free, None)?;
    let mut rig = setup.build()?;
    let root = placed.bodies[0];
    rig.rest(TIMES[0], &[]);
    let (mut speed, mut rate) = (0.0_f64, 0.0_f64);
    for _ in 0..steps(TIMES[1]) {
        rig.step(&[], &[]);
        let (linear, angular) = rig.speeds(root);
        (speed, rate) = (speed.max(linear), rate.max(angular));
    }
    let mut findings = Findings::default();
    findings.within("speed_m_s", speed, 0.0, AT_REST[0]);
    findings.within("turning_rate_rad_s", rate, 0.0, AT_REST[1]);
    findings.within("overlap_m", floor_overlap(&rig), 0.0, DEPTH);
    let drift = rig.pose(root).translation.vector.xy().norm();
    findings.within("drift_m", drift, 0.0, DRIFT);
    findings.require(rig.is_finite() && rig.unconverged == 0, "the simulation did not converge");
    Ok(findings.trial(Check::BasicPhysics, &[object], format!("fall of {height} m, yaw {yaw}")))
}

/// Deepest overlap of a shape with the floor, m.
fn floor_overlap(rig: &Rig) -> f64 {
    rig.touch(|shape| shape.name == "floor", |_| true).1
}

/// The lowest point of an object in its frame, m.
pub(super) fn lowest(config: &SceneConfig, object: &Object) -> Result<f64, TrialError> {
    let mut lowest = f64::INFINITY;
    for link in 0..object.links.len() {
        for part in object.parts(link, config)? {
            let down = part.prop_from_part.inverse_transform_vector(&-Vector3::z());
            lowest = lowest.min(part.prop_from_part.translation.z - part.geometry.reach(&down));
        }
    }
    Ok(lowest)
}
