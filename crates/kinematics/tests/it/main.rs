//! Readings against MuJoCo and Pinocchio, inverse kinematics over random targets, and the solver against other methods.
#![allow(clippy::unwrap_used, missing_docs)]

mod holding;
mod inverse;
mod ladder_stances;
mod oracle;
mod program;
mod room;
mod stances;

use fiatlux_dynamics::{BodyId, Model, ModelBuilder, State};
use fiatlux_kinematics::Site;
use fiatlux_robot::{BuildOptions, Robot, RobotIds};

use room::Draws;

impl Draws {
    fn many(&mut self, count: usize, scale: f64) -> Vec<f64> {
        (0..count).map(|_| scale * self.one()).collect()
    }
}

/// A robot in the air.
struct Alone {
    robot: Robot,
    model: Model,
    ids: RobotIds,
}

impl Alone {
    fn new(name: &str) -> Self {
        let robot = Robot::by_name(name).unwrap();
        let mut builder = ModelBuilder::new();
        let placed = robot.add_to(&mut builder, &BuildOptions::new(&robot)).unwrap();
        let model = builder.build().unwrap();
        let ids = placed.ids(&model).unwrap();
        Self { robot, model, ids }
    }

    fn site(&self, name: &str) -> Site {
        self.ids.site(self.robot.sites().iter().find(|site| site.name == name).unwrap())
    }

    /// Bodies of the joints whose names contain one of these parts.
    fn joints(&self, parts: &[&str]) -> Vec<BodyId> {
        let joints = self.robot.joints().iter().zip(&self.ids.joints);
        let named = joints.filter(|(joint, _)| parts.iter().any(|part| joint.name.contains(part)));
        named.map(|(_, ids)| ids.body).collect()
    }

    /// Standing in posture q0.
    fn standing(&self) -> State {
        let mut state = self.model.reference_state();
        self.ids.joints.iter().zip(self.robot.q0()).for_each(|(joint, q0)| state.qpos[joint.qpos] = *q0);
        state
    }

    /// Draws the angles of some joints within their limits.
    fn draw(&self, joints: &[BodyId], draws: &mut Draws, state: &mut State) {
        for (joint, ids) in
            self.robot.joints().iter().zip(&self.ids.joints).filter(|(_, ids)| joints.contains(&ids.body))
        {
            state.qpos[ids.qpos] = joint.lower + (joint.upper - joint.lower) * (draws.one() + 1.0) / 2.0;
        }
    }
}
