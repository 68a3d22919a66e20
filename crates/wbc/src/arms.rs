//! Compensates the weight of the arms, so that they rest at the angles that are commanded.

use fiatlux_robot::Robot;
use fiatlux_rules::GRAVITY;

use crate::frame::first_unsound;
use crate::{ARMS, BODY, Joint, MOVED, Sensed, WbcError};

/// Share of the difference by which the vertical goes to the sensed one in each control step: the noise is averaged over
/// about ten steps, and the torso leans slower than that.
const VERTICAL_GAIN: f64 = 0.1;

/// Adds to the targets of the arms what their own weight takes from them: their drives are soft, and sag otherwise. It does
/// not know what the hands hold.
#[derive(Debug, Clone)]
pub struct Arms {
    robot: Robot,
    /// Legs, waist and arms of the session.
    joints: Vec<Joint>,
    /// Direction of gravity in the pelvis frame, averaged.
    down: Option<[f64; 3]>,
}

impl Arms {
    /// For the drives of a session: legs, waist and arms, in the public joint order; others may follow.
    ///
    /// # Errors
    /// [`WbcError::Arms`]: other joints, or an arm's drive without stiffness.
    pub fn new(joints: &[Joint]) -> Result<Self, WbcError> {
        let robot = Robot::by_name("g1_bare").map_err(|error| WbcError::Arms(error.to_string()))?;
        let body = joints.get(..BODY).unwrap_or(joints);
        if !body.iter().map(|joint| &joint.name).eq(robot.joints().iter().map(|joint| &joint.name)) {
            return Err(WbcError::Arms(format!("the first {BODY} joints are not the G1's")));
        }
        let is_sound = |joint: &Joint| joint.stiffness > 0.0 && joint.effort_limit >= 0.0;
        if let Some(joint) = body[MOVED..].iter().find(|joint| !is_sound(joint)) {
            let Joint { name, stiffness, effort_limit, .. } = joint;
            let drive = format!("{name} has stiffness {stiffness} N m/rad and effort limit {effort_limit} N m");
            return Err(WbcError::Arms(drive));
        }
        Ok(Self { robot, joints: body.to_vec(), down: None })
    }

    /// Forgets the episode that was played, before another one begins.
    pub fn restart(&mut self) {
        self.down = None;
    }

    /// Targets of both arms' joints with which they rest at these angles, rad. To be called once a control step.
    ///
    /// # Errors
    /// [`WbcError::Sensed`]: gravity or the waist's angles are missing or not finite; [`WbcError::Angle`]: an angle is not
    /// finite.
    pub fn targets(&mut self, sensed: &Sensed<'_>, angles: &[f64; ARMS]) -> Result<[f64; ARMS], WbcError> {
        let terms: [(&'static str, &[f64], usize); 2] =
            [("projected_gravity", &sensed.projected_gravity, 3), ("joint_position", sensed.joint_position, BODY)];
        if let Some((term, problem)) = first_unsound(&terms) {
            return Err(WbcError::Sensed { term, problem });
        }
        if let Some(index) = angles.iter().position(|angle| !angle.is_finite()) {
            return Err(WbcError::Angle(self.joints[MOVED + index].name.clone()));
        }
        let down = self.down.get_or_insert(sensed.projected_gravity);
        for (down, sensed) in down.iter_mut().zip(sensed.projected_gravity) {
            *down += VERTICAL_GAIN * (sensed - *down);
        }
        // The waist as it is, the arms as they are wanted: noise of theirs would come back through the targets.
        let turned = self.joints.iter().zip(sensed.joint_position);
        let mut q: Vec<f64> = turned.map(|(joint, turned)| joint.q0 + turned).collect();
        q[MOVED..BODY].copy_from_slice(angles);
        let efforts = self.robot.holding_efforts(&q, down.map(|part| GRAVITY * part));
        let efforts = efforts.map_err(|_| WbcError::Sensed { term: "joint_position", problem: "is not finite" })?;
        let mut targets = *angles;
        for ((target, effort), joint) in targets.iter_mut().zip(&efforts[MOVED..]).zip(&self.joints[MOVED..]) {
            *target += effort.clamp(-joint.effort_limit, joint.effort_limit) / joint.stiffness;
        }
        Ok(targets)
    }
}
