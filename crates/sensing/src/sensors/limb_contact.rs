//! Force of the ladder on feet and palms.

use fiatlux_robot::Robot;
use fiatlux_rules::{LIMBS, Limb, Row, errand};
use nalgebra::Vector3;

use crate::sensor::{Class, Entry, Needs, Term};
use crate::{Setup, foot_force_estimate};

pub(crate) const ENTRY: Entry = Entry {
    name: "limb_contact",
    class: Class::Standard,
    is_large: false,
    needs: Needs::ROW,
    terms,
    compute: |view, _, out| {
        limb_force(&view.scene.robot, view.row).iter().for_each(|force| out.extend(force.as_slice()));
        Ok(())
    },
    encode: |view, devices, observation| {
        observation.limb_contact_force = ENTRY.numbers(view, devices)?;
        Ok(())
    },
};

fn terms(_: &Setup) -> Vec<Term> {
    let meaning = "force of the ladder on left and right foot (estimated) and on left and right palm, world axes";
    vec![Term::new("limb_contact", "limb_contact_force", &[LIMBS, 3], "N", meaning)]
}

/// Force of the ladder on each limb as a policy sees it, by [`Limb`], world axes, N: on the feet as the ankles' torques
/// tell it, on the palms as their contacts do.
pub fn limb_force(robot: &Robot, row: &Row) -> [Vector3<f64>; LIMBS] {
    let [left, right] = foot_force_estimate(robot, row);
    let [left_palm, right_palm] =
        [Limb::LeftPalm, Limb::RightPalm].map(|limb| row.force(errand::LADDER_FORCE)[limb as usize]);
    [left, right, left_palm, right_palm]
}
