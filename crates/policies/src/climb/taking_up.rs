//! A robot that is already on its way takes the plan up where it is.

use fiatlux_climb::{Keyframe, Plan};
use fiatlux_wbc::MOVED;
use nalgebra::Isometry3;

/// Distance from a posture of the plan at which a robot that is already on its way takes the plan up there: of the pelvis, m, and of
/// the joints of legs and waist, rad.
const TAKES_UP: (f64, f64) = (0.1, 0.6);
/// A metre of the pelvis counts as this in the comparison, rad.
const METRE: f64 = 10.0;
/// Postures of the plan that are compared lie so far apart, s. A robot that is nearest to one of the first ones begins at the start.
const GRID_S: f64 = 0.05;
const BEGINS_S: f64 = 1.0;

/// The time at which a plan has a robot that is already on its way where it is, s; `None` at its start, or far from all postures.
pub(super) fn nearest(plan: &Plan, pelvis: &Isometry3<f64>, angles: &[f64]) -> Option<f64> {
    let off = |time: f64| {
        let due = plan.at(time)?;
        let turns: Vec<f64> = due.angles.iter().zip(angles).take(MOVED).map(|(due, now)| due - now).collect();
        let way = (due.pelvis.translation.vector - pelvis.translation.vector).norm();
        let lean = due.pelvis.rotation.angle_to(&pelvis.rotation);
        let most = turns.iter().fold(0.0_f64, |most, turn| most.max(turn.abs()));
        let squares = turns.iter().map(|turn| turn * turn).sum::<f64>() + lean * lean + (way * METRE).powi(2);
        (most < TAKES_UP.1 && way < TAKES_UP.0).then_some(squares)
    };
    let times = (0..=(plan.seconds() / GRID_S) as usize).map(|step| step as f64 * GRID_S);
    let found = times.filter_map(|time| Some((time, off(time)?)));
    let (time, _) = found.min_by(|(_, a), (_, b)| a.total_cmp(b))?;
    (time > BEGINS_S).then_some(time)
}

/// True for a robot that is on its way along a plan's mirror image, false for one along the plan; `None` where that does not say.
pub(super) fn is_mirrored(plan: &Plan, pelvis: &Isometry3<f64>, angles: &[f64]) -> Option<bool> {
    match [plan, &plan.mirrored()].map(|plan| nearest(plan, pelvis, angles).is_some()) {
        [true, false] => Some(false),
        [false, true] => Some(true),
        _ => None,
    }
}

/// The rest of a plan from a time on, s.
pub(super) fn rest_of(plan: &Plan, time: f64) -> Plan {
    let mut start = 0.0;
    let mut rest = Plan::default();
    for key in &plan.keyframes {
        start += key.seconds;
        if start <= time {
            continue;
        }
        if rest.keyframes.is_empty() {
            rest.keyframes.extend(plan.at(time).map(|here| Keyframe { seconds: GRID_S, ..here }));
            rest.keyframes.push(Keyframe { seconds: start - time, ..key.clone() });
        } else {
            rest.keyframes.push(key.clone());
        }
    }
    if rest.keyframes.is_empty() {
        rest.keyframes.extend(plan.at(time));
    }
    rest
}
