//! Plays a plan.

use fiatlux_dynamics::State;
use fiatlux_kinematics::{Stance, StanceController, Support, SupportError};
use nalgebra::{Isometry3, Point3, Vector3};

use crate::body::Body;
use crate::plan::{JOINTS, Keyframe, Plan};

/// Friction of soles that the controller counts on.
const FRICTION: f64 = 0.6;
/// Centre of mass and trunk are wanted where the plan has them so much later, s: their dampers lag.
const LEAD: f64 = 0.2;
/// Parts by which angles and speeds of the joints go to what is sensed in each control step: sensed speeds are noisy, and
/// the squares of their noise would pass for centrifugal forces.
const SHARES: (f64, f64) = (0.2, 0.1);
/// Control step, s.
const DT: f64 = 0.02;

/// Balances a robot along a plan. It needs the robot's poses alone.
#[derive(Debug, Clone)]
pub struct Player {
    body: Body,
    controller: StanceController,
    world_from_plan: Isometry3<f64>,
    plan: Plan,
    /// Since the plan began, s.
    time: f64,
    /// As averaged.
    state: State,
    pelvis: Option<Isometry3<f64>>,
    targets: Vec<f64>,
}

impl Player {
    /// A player that begins a plan.
    ///
    /// # Errors
    /// A body whose root is not free.
    pub fn new(body: Body, plan: Plan, world_from_plan: Isometry3<f64>) -> Result<Self, SupportError> {
        let controller = StanceController::new(&body.model, body.ids.root)?;
        let (state, targets) = (body.model.reference_state(), vec![0.0; body.ids.joints.len()]);
        Ok(Self { body, controller, world_from_plan, plan, time: 0.0, state, pelvis: None, targets })
    }

    /// Joint targets of the next control step, rad, from the pose of the pelvis and the joints' angles and speeds.
    ///
    /// # Errors
    /// A number that is not finite.
    pub fn step(&mut self, pelvis: &Isometry3<f64>, angles: &[f64], speeds: &[f64]) -> Result<&[f64], SupportError> {
        self.see(pelvis, angles, speeds);
        let (Some(now), Some(ahead)) = (self.plan.at(self.time), self.plan.at(self.time + LEAD)) else {
            return Ok(&self.targets);
        };
        let stance = self.stance(&now, &ahead, angles);
        let targets = self.controller.targets(&self.body.model, &self.state, &stance)?;
        for (target, joint) in self.targets.iter_mut().zip(&self.body.ids.joints) {
            *target = targets[joint.drive];
        }
        self.time += DT;
        Ok(&self.targets)
    }

    /// True if the supports bore the robot in the last step.
    pub fn is_borne(&self) -> bool {
        self.controller.is_borne()
    }

    /// Time since the plan began, s.
    pub fn time(&self) -> f64 {
        self.time
    }

    /// Where the plan has the robot now, in the player's own model.
    pub fn wanted(&self) -> Option<Keyframe> {
        self.plan.at(self.time)
    }

    fn see(&mut self, pelvis: &Isometry3<f64>, angles: &[f64], speeds: &[f64]) {
        let ids = &self.body.ids;
        let last = self.pelvis.replace(*pelvis);
        let is_first = last.is_none();
        let last = last.unwrap_or(*pelvis);
        self.state.set_pose(&self.body.model, ids.root, pelvis);
        let velocity = (pelvis.translation.vector - last.translation.vector) / DT;
        let turn = (pelvis.rotation * last.rotation.inverse()).scaled_axis() / DT;
        self.state.qvel[ids.root_dof..][..3].copy_from_slice(velocity.as_slice());
        self.state.qvel[ids.root_dof + 3..][..3].copy_from_slice(turn.as_slice());
        for ((joint, angle), speed) in ids.joints.iter().zip(angles).zip(speeds) {
            let (q, v) = (&mut self.state.qpos[joint.qpos], &mut self.state.qvel[joint.dof]);
            if is_first {
                (*q, *v) = (*angle, 0.0);
            } else {
                *v += SHARES.1 * (speed - *v);
                *q += *v * DT;
                *q += SHARES.0 * (angle - *q);
            }
        }
    }

    fn stance(&self, now: &Keyframe, ahead: &Keyframe, angles: &[f64]) -> Stance {
        let body = &self.body;
        let state = |key: &Keyframe| {
            // Fingers stay.
            let fingers = angles.iter().skip(JOINTS).map(|_| &0.0);
            let all: Vec<f64> = key.angles.iter().chain(fingers).copied().collect();
            body.state(&(self.world_from_plan * key.pelvis), &all)
        };
        let mut supports = Vec::new();
        let weight = body.robot.total_mass() * 9.81;
        for (side, sole) in body.robot.soles().iter().enumerate().filter(|(side, _)| now.bears[*side] > 0.0) {
            let link = &body.ids.links[sole.site.link];
            let [rear, front] = now.ranges[side];
            let most = if now.bears[side] < 1.0 { now.bears[side] * weight } else { f64::INFINITY };
            for [x, y] in [[front, 1.0], [front, -1.0], [rear, 1.0], [rear, -1.0]] {
                let corner = sole.site.link_from_site * Point3::new(x, y * sole.half_extents[1], 0.0);
                let point = (link.body_from_link * corner).coords;
                supports.push(Support { body: link.body, point, normal: Vector3::z_axis(), friction: FRICTION, most });
            }
        }
        let later = Stance::new(&body.model, body.ids.root, &state(ahead), Vec::new());
        let stance = Stance::new(&body.model, body.ids.root, &state(now), supports);
        Stance { com: later.com, world_from_trunk: later.world_from_trunk, ..stance }
    }
}
