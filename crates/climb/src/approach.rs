//! The way from where a robot stands to the first posture of a plan, on the level.

use fiatlux_dynamics::{Mechanics, State};
use fiatlux_kinematics::{Clearance, Work, at_once};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};

use crate::body::Body;
use crate::plan::{Keyframe, Plan};
use crate::planner::{Foothold, Planner, heading};

/// Smallest gap between two parts of the robot, m.
const GAP: f64 = 0.001;
/// Time in which the robot leaves the posture that it stands in, s.
const SETTLE: f64 = 2.0;
/// Largest turn of a foot in one step, rad, and its largest way, m.
const TURN: f64 = 1.8;
const STRIDE: f64 = 0.2;
/// Most steps to a goal.
const MAX_STEPS: usize = 8;
/// Turn of the toes outwards in the posture that the robot stands in first, rad, and at the goal.
const OUT: [f64; 2] = [0.2, 1.5];

/// A robot on the level, as a planner has it that knows nothing of what is around it.
struct Standing<'a> {
    planner: Planner<'a>,
    state: State,
    feet: [Foothold; 2],
    goals: [Foothold; 2],
}

impl<'a> Standing<'a> {
    fn new(body: &'a Body, from: &Isometry3<f64>, angles: &[f64], to: &Keyframe) -> Self {
        let mut mechanics = Mechanics::new(&body.model);
        let mut soles = |pelvis: &Isometry3<f64>, angles: &[f64]| {
            mechanics.update(&body.model, &body.state(pelvis, angles));
            let site = |side: usize| body.ids.site(&body.robot.soles()[side].site);
            [0, 1].map(|side| mechanics.world_from_site(&site(side)))
        };
        let (now, goal) = (soles(from, angles), soles(&to.pelvis, &to.angles));
        let height = (goal[0].translation.z + goal[1].translation.z) / 2.0;
        let half = body.robot.soles()[0].half_extents[0];
        let level = |pose: &Isometry3<f64>, range: [f64; 2]| {
            let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), heading(&pose.rotation));
            let at = Vector3::new(pose.translation.x, pose.translation.y, height);
            Foothold { sole: Isometry3::from_parts(at.into(), turn), range, surface: 0 }
        };
        let model = &body.model;
        let apart = |_| model.shape_pairs().map(|shapes| Clearance { shapes, margin: GAP }).collect();
        Self {
            planner: Planner::new(model, &body.robot, &body.ids, Box::new(apart)),
            state: body.state(from, angles),
            feet: [0, 1].map(|side| level(&now[side], [-half, half])),
            goals: [0, 1].map(|side| level(&goal[side], to.ranges[side])),
        }
    }

    fn here(&self) -> Keyframe {
        self.planner.keyframe(&self.state, 0.1, [1.0; 2], self.feet.map(|foot| foot.range))
    }
}

/// From the posture that a robot is in on the level, both feet down, to one that bears it evenly, with the arms as the keyframe has
/// them: an arm that is stretched out would tip it as it steps. Poses are those of the plan's frame; the keyframe is one on the same
/// surface. `None` if there is no such posture.
pub fn stand(body: &Body, from: &Isometry3<f64>, angles: &[f64], to: &Keyframe) -> Option<Plan> {
    let mut standing = Standing::new(body, from, angles, to);
    let here = standing.here();
    let arms = body.robot.joints().iter().zip(&body.ids.joints).zip(&to.angles);
    let is_arm = |name: &str| ["shoulder", "elbow", "wrist"].iter().any(|part| name.contains(part));
    for ((_, ids), angle) in arms.filter(|((joint, _), _)| is_arm(&joint.name)) {
        standing.state.qpos[ids.qpos] = *angle;
    }
    standing.planner.out = OUT[0];
    let (_, mut stand) = at_once(standing.planner.stand(&standing.state, standing.feet))?;
    stand.seconds = SETTLE;
    let mut plan = Plan::default();
    plan.extend([here, stand]);
    Some(plan)
}

/// Steps from where a robot stands on the level, at rest, to a keyframe on the same surface, first of the foot of a side, 0 for the left. Poses
/// are those of the plan's frame. `None` if no way was found. It is a search that can be done in slices.
pub async fn approach(
    body: &Body,
    from: &Isometry3<f64>,
    angles: &[f64],
    to: &Keyframe,
    leads: usize,
    work: Work,
) -> Option<Plan> {
    let standing = Standing::new(body, from, angles, to);
    let mut plan = Plan::default();
    plan.extend([standing.here()]);
    let Standing { mut planner, mut state, mut feet, goals } = standing;
    (planner.out, planner.work) = (OUT[1], work);
    // The feet take turns until both are there.
    for turn in 0..MAX_STEPS {
        let side = (leads + turn) % 2;
        let next = toward(&feet[side], &goals[side]);
        if next == feet[side] {
            continue;
        }
        let (reached, keyframes) = planner.step(&state, feet, side, next).await?;
        plan.extend(keyframes);
        (state, feet[side]) = (reached, next);
    }
    if feet != goals {
        return None;
    }
    plan.extend([Keyframe { seconds: SETTLE, ..to.clone() }]);
    Some(plan)
}

/// The next foothold on the way from one to another one.
fn toward(from: &Foothold, to: &Foothold) -> Foothold {
    let way = (to.sole.translation.vector - from.sole.translation.vector).norm();
    let turn = from.sole.rotation.angle_to(&to.sole.rotation);
    let steps = libm::ceil((way / STRIDE).max(turn / TURN));
    if steps <= 1.0 { *to } else { Foothold { sole: from.sole.lerp_slerp(&to.sole, 1.0 / steps), ..*from } }
}
