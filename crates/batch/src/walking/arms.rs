//! Motions of the arms while the robot walks.

use fiatlux_robot::Robot;
use fiatlux_rules::CONTROL_DT;
use fiatlux_wbc::{ARMS, MOVED};
use fiatlux_world::Random;
use serde::{Deserialize, Serialize};

/// Part of the episodes in which the arms rest in q0, and in which they take a posture and keep it; in the others they go
/// slowly from posture to posture.
const REST: f64 = 0.35;
const STILL: f64 = 0.30;
/// Speed of their targets, rad/s.
const SPEED: [f64; 2] = [0.3, 2.0];

#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(super) struct Arms {
    target: [f64; ARMS],
    goal: [f64; ARMS],
    speed: f64,
    moves: bool,
}

impl Arms {
    /// An episode begins with the arms in a posture.
    pub fn begin(&mut self, robot: &Robot, posture: &[f64], range: f64, random: &mut Random) {
        self.target.copy_from_slice(posture);
        self.goal.copy_from_slice(&robot.q0()[MOVED..MOVED + ARMS]);
        let kind = random.unit();
        self.speed = random.uniform(SPEED[0], SPEED[1]);
        self.moves = kind >= REST + STILL;
        if kind >= REST {
            self.draw_goal(robot, range, random);
        }
    }

    /// Moves the targets on and writes them.
    pub fn advance(&mut self, robot: &Robot, range: f64, random: &mut Random, joint_target: &mut [f64]) {
        let most = self.speed * CONTROL_DT;
        for (target, goal) in self.target.iter_mut().zip(&self.goal) {
            *target += (goal - *target).clamp(-most, most);
        }
        if self.moves && self.target == self.goal {
            self.speed = random.uniform(SPEED[0], SPEED[1]);
            self.draw_goal(robot, range, random);
        }
        joint_target.copy_from_slice(&self.target);
    }

    fn draw_goal(&mut self, robot: &Robot, range: f64, random: &mut Random) {
        let joints = robot.joints()[MOVED..].iter().zip(&robot.q0()[MOVED..]);
        for (goal, (joint, q0)) in self.goal.iter_mut().zip(joints) {
            *goal = q0 + range * (random.uniform(joint.lower, joint.upper) - q0);
        }
    }
}
