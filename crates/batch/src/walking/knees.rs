//! Angle of the knees at a height of the pelvis.

use fiatlux_world::World;

/// Share of that bend for which the reward asks: a leg leans, and is longest at the end of a step.
const PART: f64 = 0.7;

/// A leg in its plane: thigh and shin. Straight legs are a trap, since a knee that is pressed beyond them lowers the pelvis
/// too; a learner needs to know which way is down.
#[derive(Debug, Clone, Copy)]
pub(super) struct Knees {
    thigh_m: f64,
    shin_m: f64,
    /// Height of the pelvis less the distance from hip to ankle, m.
    above_m: f64,
    /// Angle of the joint when the leg is straight, rad.
    straight: f64,
    /// Both knees in the joint order.
    pub joints: [usize; 2],
}

impl Knees {
    /// From a robot as it stands in q0.
    pub fn of(world: &World) -> Option<Self> {
        let robot = &world.scene().robot;
        let place = |link: &str| Some(world.world_from_link(robot.link_index(link)?).translation.vector);
        let [hip, knee, ankle] =
            [place("left_hip_pitch_link")?, place("left_knee_link")?, place("left_ankle_pitch_link")?]
                .map(|place| nalgebra::Vector2::new(place.x, place.z));
        let (thigh_m, shin_m, leg_m) = ((hip - knee).norm(), (knee - ankle).norm(), (hip - ankle).norm());
        let joints = [robot.joint_index("left_knee_joint")?, robot.joint_index("right_knee_joint")?];
        let above_m = world.row().robot.pose.translation.z - leg_m;
        let mut knees = Self { thigh_m, shin_m, above_m, straight: 0.0, joints };
        knees.straight = robot.q0()[joints[0]] - knees.turn(leg_m);
        Some(knees)
    }

    /// Angle of the knee from straight where hip and ankle are this far apart, rad.
    fn turn(&self, leg_m: f64) -> f64 {
        let (a, b) = (self.thigh_m, self.shin_m);
        let cosine = (a * a + b * b - leg_m * leg_m) / (2.0 * a * b);
        std::f64::consts::PI - libm::acos(cosine.clamp(-1.0, 1.0))
    }

    /// The least angle of the knee at a height of the pelvis, rad.
    pub fn least(&self, height: f64) -> f64 {
        self.straight + PART * self.turn(height - self.above_m)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn knees_bend_as_the_pelvis_sinks() {
        let knees = Knees { thigh_m: 0.3, shin_m: 0.4, above_m: 0.1, straight: -0.05, joints: [0, 1] };
        assert!((knees.least(0.8) - -0.05).abs() < 1e-6);
        // A right angle between thigh and shin.
        assert!((knees.least(0.6) - (PART * std::f64::consts::FRAC_PI_2 - 0.05)).abs() < 1e-9);
        assert!(knees.least(0.55) > knees.least(0.6));
    }
}
