//! Poses, joint axes and velocities of every body, from `qpos` and `qvel`.

use nalgebra::{Isometry3, Matrix3, Quaternion, Translation3, UnitQuaternion};

use crate::model::{Model, State};
use crate::spatial::{Motion, V3, Velocity};
use crate::spec::Joint;

/// Rotation of a hinge as `fixed + sin(q) * sine + cos(q) * cosine`: the parent-from-body rotation without trigonometry
/// of axes at run time.
#[derive(Debug, Clone)]
struct HingeRotation {
    fixed: Matrix3<f64>,
    sine: Matrix3<f64>,
    cosine: Matrix3<f64>,
    axis: V3,
    /// Of the joint in the parent.
    position: V3,
}

#[derive(Debug, Clone)]
pub(crate) struct Kinematics {
    hinges: Vec<Option<HingeRotation>>,
    /// World-from-body rotation per body.
    pub rotation: Vec<Matrix3<f64>>,
    /// Position of each body's origin, world.
    pub position: Vec<V3>,
    /// Origin that each body's spatial vectors are taken about: the position of its root.
    pub origin: Vec<V3>,
    /// Motion of a unit rate of each degree of freedom, about its tree's origin.
    pub axes: Vec<Motion>,
    /// Motion of each body about its tree's origin.
    pub motion: Vec<Motion>,
}

impl Kinematics {
    pub fn new(model: &Model) -> Self {
        let bodies = model.bodies.len();
        let hinges = model.bodies.iter().map(|body| match &body.spec.joint {
            Joint::Free => None,
            Joint::Hinge(hinge) => {
                let rotation = *body.spec.parent_from_body.rotation.to_rotation_matrix().matrix();
                let axis = hinge.axis.into_inner();
                let outer = axis * axis.transpose();
                Some(HingeRotation {
                    fixed: rotation * outer,
                    sine: rotation * axis.cross_matrix(),
                    cosine: rotation * (Matrix3::identity() - outer),
                    axis,
                    position: body.spec.parent_from_body.translation.vector,
                })
            }
        });
        Self {
            hinges: hinges.collect(),
            rotation: vec![Matrix3::identity(); bodies],
            position: vec![V3::zeros(); bodies],
            origin: vec![V3::zeros(); bodies],
            axes: vec![Motion::ZERO; model.nv],
            motion: vec![Motion::ZERO; bodies],
        }
    }

    /// Computes everything for a state.
    pub fn update(&mut self, model: &Model, state: &State) {
        for index in 1..model.nodes.len() {
            self.place(model, state, index);
        }
    }

    /// Computes everything of one body, whose parent is up to date.
    #[inline(always)]
    pub fn place(&mut self, model: &Model, state: &State, index: usize) {
        let node = &model.nodes[index];
        let (q, v, parent) = (node.qpos, node.dof, node.parent);
        let Some(hinge) = &self.hinges[index] else {
            let qpos = &state.qpos[q..q + 7];
            let quaternion = Quaternion::new(qpos[3], qpos[4], qpos[5], qpos[6]);
            let position = V3::new(qpos[0], qpos[1], qpos[2]);
            let qvel = &state.qvel[v..v + 6];
            self.rotation[index] = *UnitQuaternion::new_normalize(quaternion).to_rotation_matrix().matrix();
            self.position[index] = position;
            self.origin[index] = position;
            for k in 0..3 {
                let unit = V3::ith(k, 1.0);
                self.axes[v + k] = Motion { angular: V3::zeros(), linear: unit };
                self.axes[v + 3 + k] = Motion { angular: unit, linear: V3::zeros() };
            }
            self.motion[index] =
                Motion { angular: V3::new(qvel[3], qvel[4], qvel[5]), linear: V3::new(qvel[0], qvel[1], qvel[2]) };
            return;
        };
        let (sine, cosine) = libm::sincos(state.qpos[q]);
        let parent_rotation = self.rotation[parent];
        let rotation = parent_rotation * (hinge.fixed + hinge.sine * sine + hinge.cosine * cosine);
        let position = self.position[parent] + parent_rotation * hinge.position;
        // A tree that hangs on the world by a hinge takes its root's constant position.
        let origin = if parent == 0 { position } else { self.origin[parent] };
        let angular = rotation * hinge.axis;
        let axis = Motion { angular, linear: (position - origin).cross(&angular) };
        let mut motion = self.motion[parent];
        motion.add_scaled(&axis, state.qvel[v]);
        self.rotation[index] = rotation;
        self.position[index] = position;
        self.origin[index] = origin;
        self.axes[v] = axis;
        self.motion[index] = motion;
    }

    pub fn world_from_body(&self, body: usize) -> Isometry3<f64> {
        let rotation = nalgebra::Rotation3::from_matrix_unchecked(self.rotation[body]);
        Isometry3::from_parts(Translation3::from(self.position[body]), UnitQuaternion::from_rotation_matrix(&rotation))
    }

    /// Velocity of the body's own origin.
    pub fn velocity(&self, body: usize) -> Velocity {
        Velocity { linear: self.velocity_at(body, &V3::zeros()), angular: self.motion[body].angular }
    }

    /// Velocity of a point of the body, given in its frame.
    pub fn velocity_at(&self, body: usize, point: &V3) -> V3 {
        let motion = &self.motion[body];
        let arm = self.position[body] - self.origin[body] + self.rotation[body] * point;
        motion.linear + motion.angular.cross(&arm)
    }
}

/// Moves a state along its own velocity for `dt` s: hinges linearly, free bodies by the exponential of their rotation.
pub(crate) fn integrate(model: &Model, state: &mut State, dt: f64) {
    move_freely(model, state, dt);
    model.follow_positions(state);
}

fn move_freely(model: &Model, state: &mut State, dt: f64) {
    for node in &model.nodes[1..] {
        let (q, v) = (node.qpos, node.dof);
        if !node.is_free {
            state.qpos[q] += dt * state.qvel[v];
            continue;
        }
        let (qpos, qvel) = (&mut state.qpos[q..q + 7], &state.qvel[v..v + 6]);
        if qvel.iter().all(|&speed| speed == 0.0) {
            continue;
        }
        for k in 0..3 {
            qpos[k] += dt * qvel[k];
        }
        let turn = V3::new(qvel[3], qvel[4], qvel[5]) * (0.5 * dt);
        let angle = turn.norm();
        let (sine, cosine) = libm::sincos(angle);
        // Below 1e-8 rad the series' second term is lost in rounding.
        let factor = if angle > 1e-8 { sine / angle } else { 1.0 };
        let step = Quaternion::from_parts(cosine, turn * factor);
        let rotation = step * Quaternion::new(qpos[3], qpos[4], qpos[5], qpos[6]);
        let rotation = rotation / rotation.norm();
        qpos[3..7].copy_from_slice(&[rotation.w, rotation.i, rotation.j, rotation.k]);
    }
}
