//! A plan for a ladder that is higher or lower than the one that it was made for.

use fiatlux_dynamics::{BodyId, Mechanics};
use fiatlux_kinematics::{Goal, InverseKinematics, Outcome, SearchOptions};
use fiatlux_robot::JointIds;
use nalgebra::Isometry3;

use crate::body::Body;
use crate::plan::Plan;

const OPTIONS: SearchOptions = SearchOptions {
    position_tolerance: 2e-3,
    rotation_tolerance: 1e-2,
    tries: 1,
    steps: 60,
    limit_margin: 0.005,
    spread: 0.0,
    rest_pull: 0.1,
};

/// A search that bends the waist, or moves legs, pelvis and waist, and their joints.
pub(crate) fn inverse(body: &Body, moves_legs: bool) -> Option<(InverseKinematics, Vec<JointIds>)> {
    let words: &[&str] = if moves_legs { &["hip", "knee", "ankle", "waist"] } else { &["waist_roll", "waist_pitch"] };
    let joints = body.robot.joints().iter().zip(&body.ids.joints);
    let joints = joints.filter(|(joint, _)| words.iter().any(|word| joint.name.contains(word)));
    let joints: Vec<_> = joints.map(|(_, ids)| *ids).collect();
    let bodies: Vec<BodyId> = joints.iter().map(|joint| joint.body).collect();
    let mut inverse = InverseKinematics::new(&body.model, body.ids.root, &bodies, moves_legs).ok()?;
    inverse.options = OPTIONS;
    Some((inverse, joints))
}

/// The plan with the soles this many times as high above the floor; legs and waist keep the centre of mass over the same point of the
/// level. `None` if a posture is out of reach.
pub fn raised(body: &Body, plan: &Plan, factor: f64) -> Option<Plan> {
    let (model, ids) = (&body.model, &body.ids);
    let sites = body.soles();
    let (mut inverse, joints) = inverse(body, true)?;
    let (mut mechanics, mut plan) = (Mechanics::new(model), plan.clone());
    for key in &mut plan.keyframes {
        let (mut state, soles, com) = body.posture(&mut mechanics, key);
        let rest: Vec<f64> = joints.iter().map(|joint| state.qpos[joint.qpos]).collect();
        inverse.set_rest(&rest).ok()?;
        let up = |height: f64| Isometry3::translation(0.0, 0.0, (factor - 1.0) * height);
        let between = soles.iter().map(|sole| sole.translation.z).sum::<f64>() / 2.0;
        state.set_pose(model, ids.root, &(up(between) * key.pelvis));
        let goal = |side: usize| Goal::pose(sites[side], up(soles[side].translation.z) * soles[side]);
        let goals = [goal(0), goal(1), Goal::com_over(com.x, com.y)];
        if inverse.solve(model, &mut state, &goals).ok()?.outcome != Outcome::Reached {
            return None;
        }
        body.keep(&state, key);
    }
    Some(plan)
}
