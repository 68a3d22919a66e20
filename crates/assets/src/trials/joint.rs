//! Each hinge of an object goes from limit to limit, its root held.

use std::f64::consts::FRAC_PI_2;

use fiatlux_dynamics::Drive;
use fiatlux_world::{JointKind, LinkJoint, Object, SceneConfig};
use nalgebra::{Isometry3, Vector3};

use super::{Check, Findings, Trial};
use crate::error::TrialError;
use crate::rig::{Base, Setup, steps, weight};

/// Time for each way, s, and the largest distance to its end, rad.
const TIME: f64 = 3.0;
const REACH: f64 = 0.05;
/// The targets turn at this rate, rad/s.
const RATE: f64 = 1.5;
/// Effort of the drive as a multiple of what holds the links beyond it up.
const STRENGTH: f64 = 5.0;
/// Stiffness, N m/rad, and damping, N m s/rad, for 1 N m of effort.
const GAINS: [f64; 2] = [20.0, 2.0];
/// Height of the root above the floor, m, out of the way.
const HEIGHT: f64 = 3.0;

pub(super) fn trials(config: &SceneConfig, object: &Object) -> Result<Vec<Trial>, TrialError> {
    let joints = object.links.iter().filter_map(|link| link.joint.as_ref());
    let hinges = joints.filter(|joint| joint.kind == JointKind::Revolute).enumerate();
    hinges.map(|(moved, hinge)| one(config, object, moved, hinge)).collect()
}

/// Moves one hinge, which is at that place among those of the object.
fn one(config: &SceneConfig, object: &Object, moved: usize, hinge: &LinkJoint) -> Result<Trial, TrialError> {
    let bounded = |limit: f64, free: f64| if limit.is_finite() { limit } else { free };
    let (lower, upper) = (bounded(hinge.lower, -FRAC_PI_2), bounded(hinge.upper, FRAC_PI_2));
    let anchor = Vector3::from(hinge.anchor);
    let moment: f64 =
        object.links.iter().map(|link| weight(link.mass) * (Vector3::from(link.com) - anchor).norm()).sum();
    let effort_limit = STRENGTH * moment;
    let [stiffness, damping] = GAINS.map(|gain| gain * moment);
    let drive = Drive { stiffness, damping, effort_limit, speed_limit: f64::INFINITY };
    let mut setup = Setup::new(config)?;
    setup.add_object(object, "", Isometry3::translation(0.0, 0.0, HEIGHT), Base::Fixed, Some(drive))?;
    let mut rig = setup.build()?;
    // Coordinates of all hinges are in the order of the links, as targets are.
    let mut targets = vec![0.0; rig.model.drives().len()];
    let mut findings = Findings::default();
    for (way, goal) in [("upper", upper), ("lower", lower)] {
        for _ in 0..steps(TIME) {
            let most = RATE * fiatlux_world::PHYSICS_DT;
            targets[moved] += (goal - targets[moved]).clamp(-most, most);
            rig.step(&targets, &[]);
        }
        findings.within(&format!("error_at_{way}_rad"), (rig.state.qpos[moved] - goal).abs(), 0.0, REACH);
    }
    let slack = 0.02;
    let inside = (lower - slack..=upper + slack).contains(&rig.state.qpos[moved]);
    findings.require(inside, "the joint is beyond its limits");
    findings.require(rig.is_finite() && rig.unconverged == 0, "the simulation did not converge");
    Ok(findings.trial(Check::JointMotion, &[object], format!("{}, {lower:.3} to {upper:.3} rad", hinge.name)))
}
