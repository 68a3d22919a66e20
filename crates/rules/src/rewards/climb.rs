//! The reward of climbing alone: height gained, limbs on the ladder, arrival.

use super::motion;
use super::term::{Kind, TermSpec, View};
use crate::{Cause, Context, Row};

pub(super) fn terms() -> Vec<TermSpec> {
    let term = TermSpec::new;
    vec![
        term("height_gain", 500.0, Kind::Record(pelvis_height)),
        term("limb_contact", 0.25, Kind::Rate(limb_contact)),
        term("success_bonus", 500.0, Kind::Condition(Cause::Success)),
        term("robot_fall", -200.0, Kind::Condition(Cause::Fall)),
        term("com_sway", -0.5, Kind::Rate(motion::com_sway)),
        term("ang_vel_xy", -0.05, Kind::Rate(motion::roll_and_pitch_rate)),
        term("action_rate", -0.005, Kind::Rate(motion::action_rate)),
        term("joint_acceleration", -1.25e-7, Kind::Rate(motion::joint_acceleration)),
        term("ankle_limits", -1.0, Kind::Rate(motion::ankle_limits)),
        term("waist_deviation", -0.1, Kind::Rate(motion::waist_deviation)),
        term("finger_deviation", -0.05, Kind::Rate(motion::finger_deviation)),
    ]
}

/// m.
pub(super) fn pelvis_height(row: &Row, _cx: &Context<'_>) -> f64 {
    row.robot.pose.translation.vector.z
}

fn limb_contact(view: &View<'_>) -> f64 {
    motion::limbs_on_ladder(view.row, &motion::ALL_LIMBS, view.context.thresholds.limb_contact_n)
}
