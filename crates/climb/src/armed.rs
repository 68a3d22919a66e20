//! A plan with other arms than it was made with.

use fiatlux_dynamics::Mechanics;
use fiatlux_kinematics::{Goal, Outcome};

use crate::body::Body;
use crate::plan::Plan;
use crate::planner::Arm;
use crate::raised::inverse;

/// The plan with shoulders and elbows as an arm has them. The waist keeps the centre of mass over the same point of the level, and
/// pelvis and legs stay; where it cannot, they move from there on, on the same soles, and gaps become smaller. `None` if a posture is
/// out of reach.
pub fn armed(body: &Body, plan: &Plan, arm: &Arm) -> Option<Plan> {
    let (model, ids) = (&body.model, &body.ids);
    let sites = body.soles();
    let mut ways = [inverse(body, false)?, inverse(body, true)?];
    let (mut mechanics, mut plan) = (Mechanics::new(model), plan.clone());
    for key in &mut plan.keyframes {
        let (mut state, soles, com) = body.posture(&mut mechanics, key);
        for (joint, ids) in body.robot.joints().iter().zip(&ids.joints) {
            if let Some(angle) = arm.reaching(&joint.name) {
                state.qpos[ids.qpos] = angle;
            }
        }
        let goals = [Goal::com_over(com.x, com.y), Goal::pose(sites[0], soles[0]), Goal::pose(sites[1], soles[1])];
        let mut is_found = false;
        for ((inverse, joints), goals) in ways.iter_mut().zip([&goals[..1], &goals]) {
            let rest: Vec<f64> = joints.iter().map(|joint| state.qpos[joint.qpos]).collect();
            inverse.set_rest(&rest).ok()?;
            is_found = inverse.solve(model, &mut state, goals).ok()?.outcome == Outcome::Reached;
            if is_found {
                break;
            }
        }
        if !is_found {
            return None;
        }
        body.keep(&state, key);
    }
    Some(plan)
}
