//! Loads and pulls at the hands while the robot walks.

use fiatlux_dynamics::Wrench;
use fiatlux_rules::CONTROL_DT;
use fiatlux_world::{AppliedWrench, Random, Target};
use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

/// Weight of a kilogram, N.
const GRAVITY: f64 = 9.81;
/// Part of the episodes in which a hand carries something, and part of the times in which forces pull.
const CARRIES: f64 = 0.5;
const PULLS: f64 = 0.5;
/// Durations of a pull and of a pause, s.
const PULL_S: [f64; 2] = [0.3, 3.0];

/// Forces at both hands, the left one first. A load is its weight alone: its inertia is left out.
#[derive(Debug, Clone, Default, Serialize, Deserialize)]
pub(super) struct Hands {
    weight: [f64; 2],
    pull: [[f64; 3]; 2],
    left: u32,
}

impl Hands {
    /// An episode begins, with loads of up to `load_kg` in each hand.
    pub fn begin(&mut self, load_kg: f64, random: &mut Random) {
        *self = Self::default();
        for weight in &mut self.weight {
            let carries = random.unit() < CARRIES;
            *weight = GRAVITY * random.uniform(0.0, load_kg) * f64::from(u8::from(carries));
        }
    }

    /// Goes on by a control step, with pulls of up to `force_n` along each of the world's axes.
    pub fn advance(&mut self, force_n: f64, random: &mut Random) {
        if self.left == 0 {
            let size = if random.unit() < PULLS { force_n } else { 0.0 };
            self.pull = self.pull.map(|pull| pull.map(|_| random.uniform(-size, size)));
            self.left = (random.uniform(PULL_S[0], PULL_S[1]) / CONTROL_DT) as u32 + 1;
        }
        self.left = self.left.saturating_sub(1);
    }

    /// The force at a hand, world axes, N.
    pub fn force(&self, hand: usize) -> Vector3<f64> {
        Vector3::from(self.pull[hand]) - Vector3::z() * self.weight[hand]
    }

    /// Adds what is not nothing.
    pub fn act(&self, palms: [usize; 2], wrenches: &mut Vec<AppliedWrench>) {
        for (hand, palm) in palms.into_iter().enumerate() {
            let force = self.force(hand);
            if force != Vector3::zeros() {
                let wrench = Wrench { force, torque: Vector3::zeros() };
                wrenches.push(AppliedWrench { target: Target::Link(palm), point: Some(Vector3::zeros()), wrench });
            }
        }
    }
}
