//! Longer phases of taking a bulb: what the arm and the fingers do, and what comes next.

use fiatlux_client::PolicyError;
use fiatlux_kinematics::at_once;
use fiatlux_skills::heading;
use fiatlux_wbc::CONTROL_DT;
use nalgebra::Translation3;

use super::params::Params;
use super::{Grab, MAX_LOOSE, Phase, TURNED, above, arrival};
use crate::hands::arm::Arm;
use crate::hands::skill::Seen;

impl Grab {
    pub(super) fn raise(&mut self, params: &Params, seen: &Seen, arm: &mut Arm) -> Result<Option<Phase>, PolicyError> {
        let posture = match self.posture {
            Some(posture) => posture,
            None => {
                self.heading = heading(&seen.pelvis);
                self.size = self.size_of(&seen.fresh_bulb);
                let ready = Translation3::from(params.motion.ready);
                let goal = self.grasp_from(seen, [params.stand.ahead, params.stand.left]) * ready;
                *self.posture.insert(at_once(arm.posture(&goal))?.angles)
            }
        };
        Ok((arm.turn_to(&posture, params.motion.rate) < TURNED).then_some(Phase::StepUp))
    }

    pub(super) fn pre_grasp(
        &mut self,
        params: &Params,
        seen: &Seen,
        arm: &mut Arm,
    ) -> Result<Option<Phase>, PolicyError> {
        let motion = &params.motion;
        self.goal = self.world_from_grasp(seen);
        let goal = match (self.from_above, &params.lying) {
            (Some(_), Some(lying)) => above(&self.goal, lying.above),
            _ => self.goal * Translation3::from(motion.pre_grasp),
        };
        if let (true, Some(posture)) = (self.turning, self.posture) {
            self.turning = arm.turn_to(&posture, motion.rate) > TURNED;
            self.phases.restart(seen.time);
            return Ok(None);
        }
        let elapsed = self.phases.elapsed(seen.time);
        let left = arm.move_to(false, &goal, motion.speed)?;
        Ok(arrival(left, elapsed, arm.distance_to(&goal), motion, Phase::Approach))
    }

    /// Each finger closes after its delay, and presses with its torque once it feels the bulb.
    pub(super) fn close(&mut self, params: &Params, seen: &Seen, arm: &mut Arm) -> Result<Option<Phase>, PolicyError> {
        let Params { motion, close, .. } = params;
        let (elapsed, closing) = (self.phases.elapsed(seen.time), CONTROL_DT / close.time);
        let (thumb_delay, finger_delay, torque) = match (self.from_above, &params.lying) {
            (Some(_), Some(lying)) => (lying.thumb_delay, lying.finger_delay, lying.torque),
            _ => (close.thumb_delay, close.finger_delay, close.torque),
        };
        for (index, (finger, force)) in self.fingers.iter_mut().zip(seen.touch.fingers).enumerate() {
            let delay = if index == 0 { thumb_delay } else { finger_delay };
            finger.share += if elapsed > delay { closing } else { 0.0 };
            finger.torque = finger.torque.or((force > close.touch).then_some(torque));
        }
        let goal = self.goal;
        arm.move_to(false, &goal, motion.approach_speed)?;
        self.bulb_height = self.glass(seen).z;
        let is_loose = self.from_above.is_none() && seen.touch.fingers[0] < close.firm;
        let is_over = elapsed > close.time + thumb_delay.max(finger_delay) + close.hold;
        Ok(is_over.then(|| {
            if is_loose && self.loose < MAX_LOOSE {
                self.loose += 1;
                return Phase::Open;
            }
            self.goal.translation.vector.z += motion.lift;
            Phase::Lift
        }))
    }
}
