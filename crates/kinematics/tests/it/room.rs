//! A robot in a scene as a session plays it: noise on the angles, targets clamped to the joints' limits. The tests of
//! `crates/climb` use it, too.

use fiatlux_dynamics::{Dynamics, Input, State};
use fiatlux_world::{PHYSICS_DT, SUBSTEPS, Scene};

/// SplitMix64, as in `tests/oracle/kinematics.py`: numbers in [-1, 1).
pub struct Draws(pub u64);

impl Draws {
    pub fn one(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        ((z ^ (z >> 31)) >> 11) as f64 * 2.0_f64.powi(-52) - 1.0
    }
}

pub struct Room<'a> {
    pub scene: &'a Scene,
    pub state: State,
    pub dynamics: Dynamics,
    /// Largest effort relative to its limit, and the joint.
    pub effort: (f64, String),
    noise: Option<Draws>,
    targets: Vec<f64>,
}

impl<'a> Room<'a> {
    pub fn new(scene: &'a Scene, state: State, noise: Option<Draws>) -> Self {
        let (dynamics, targets) = (Dynamics::new(&scene.model), vec![0.0; scene.model.drives().len()]);
        Self { scene, state, dynamics, effort: (0.0, String::new()), noise, targets }
    }

    /// Angles of the joints as they are sensed, rad.
    pub fn angles(&mut self) -> Vec<f64> {
        let mut noise = || self.noise.as_mut().map_or(0.0, |draws| 0.01 * draws.one());
        self.scene.robot_ids.joints.iter().map(|joint| self.state.qpos[joint.qpos] + noise()).collect()
    }

    /// A control step to these targets of the joints, rad.
    pub fn step(&mut self, targets: impl IntoIterator<Item = f64>) {
        let joints = || self.scene.robot.joints().iter().zip(&self.scene.robot_ids.joints);
        for ((joint, there), target) in joints().zip(targets) {
            self.targets[there.drive] = target.clamp(joint.lower, joint.upper);
        }
        for _ in 0..SUBSTEPS {
            let input = Input { targets: &self.targets, ..Input::default() };
            self.dynamics.step(&self.scene.model, &mut self.state, &input, PHYSICS_DT);
        }
        for (joint, there) in joints() {
            let share = self.dynamics.efforts()[there.drive].abs() / joint.gains.effort_limit;
            if share > self.effort.0 {
                self.effort = (share, joint.name.clone());
            }
        }
    }
}
