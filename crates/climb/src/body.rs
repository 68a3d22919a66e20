//! The robot alone, as a policy has it that sees poses.

use fiatlux_dynamics::{Mechanics, Model, ModelBuilder, Site, State};
use fiatlux_robot::{BuildOptions, Gains, Robot, RobotIds};
use nalgebra::{Isometry3, Quaternion, UnitQuaternion, Vector3};

use crate::plan::Keyframe;

/// A model of one robot and nothing else.
#[derive(Debug, Clone)]
pub struct Body {
    /// The robot.
    pub robot: Robot,
    /// Its model.
    pub model: Model,
    /// Where its parts are in the model.
    pub ids: RobotIds,
}

impl Body {
    /// A robot with these drives; `None` if they do not fit it.
    pub fn new(robot: Robot, gains: Gains) -> Option<Self> {
        let mut builder = ModelBuilder::new();
        let placed = robot.add_to(&mut builder, &BuildOptions { gains, ..BuildOptions::new(&robot) }).ok()?;
        let model = builder.build().ok()?;
        let ids = placed.ids(&model).ok()?;
        Some(Self { robot, model, ids })
    }

    /// A state at rest: pose of the pelvis and joint angles, rad; joints beyond the end of `angles` are at 0.
    pub fn state(&self, pelvis: &Isometry3<f64>, angles: &[f64]) -> State {
        let mut state = self.model.reference_state();
        state.qvel.fill(0.0);
        state.set_pose(&self.model, self.ids.root, pelvis);
        for (index, joint) in self.ids.joints.iter().enumerate() {
            state.qpos[joint.qpos] = angles.get(index).copied().unwrap_or(0.0);
        }
        state
    }

    /// Sites of the soles, left first.
    pub(crate) fn soles(&self) -> [Site; 2] {
        [0, 1].map(|side| self.ids.site(&self.robot.soles()[side].site))
    }

    /// The state of a posture, poses of its soles, left first, and its centre of mass, m.
    pub(crate) fn posture(
        &self,
        mechanics: &mut Mechanics,
        key: &Keyframe,
    ) -> (State, [Isometry3<f64>; 2], Vector3<f64>) {
        let state = self.state(&key.pelvis, &key.angles);
        mechanics.update(&self.model, &state);
        let soles = self.soles().map(|site| mechanics.world_from_site(&site));
        (state, soles, mechanics.center_of_mass(&self.model, self.ids.root).1)
    }

    /// Makes a state the posture.
    pub(crate) fn keep(&self, state: &State, key: &mut Keyframe) {
        key.pelvis = pelvis(&self.ids, state);
        key.angles.iter_mut().zip(&self.ids.joints).for_each(|(angle, joint)| *angle = state.qpos[joint.qpos]);
    }
}

/// Pose of the pelvis in a state.
pub(crate) fn pelvis(ids: &RobotIds, state: &State) -> Isometry3<f64> {
    let q = &state.qpos[ids.root_qpos..][..7];
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(q[3], q[4], q[5], q[6]));
    Isometry3::from_parts(Vector3::new(q[0], q[1], q[2]).into(), rotation)
}
