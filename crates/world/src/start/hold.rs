//! A bulb in the hand: the hand closes around it in simulation, while all the rest is held still.

use std::collections::BTreeMap;
use std::f64::consts::PI;

use fiatlux_rules::{Bulb, Row, errand};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

use super::{Start, StartError};
use crate::{PHYSICS_DT, Scene, World};

/// Writes angles by joint name into a posture, kept within the joints' limits.
pub(super) fn set_joints(
    scene: &Scene,
    field: &'static str,
    angles: &BTreeMap<String, f64>,
    posture: &mut [f64],
) -> Result<(), StartError> {
    for (name, angle) in angles {
        let joint = scene.robot.joint_index(name).ok_or_else(|| StartError::Name { field, name: name.clone() })?;
        let limits = &scene.robot.joints()[joint];
        posture[joint] = angle.clamp(limits.lower, limits.upper);
    }
    Ok(())
}

impl Start<'_> {
    /// Pose of a bulb in the hand that will close around it.
    pub(super) fn world_from_held_bulb(&self, row: &Row, bulb: Bulb) -> Result<Isometry3<f64>, StartError> {
        let (robot, carry) = (&self.scene.robot, &self.scene.config.start.carry);
        let unknown = || StartError::Name { field: "start.carry.hand_link", name: carry.hand_link.clone() };
        let link = robot.link_index(&carry.hand_link).ok_or_else(unknown)?;
        let links = robot.forward_kinematics(&row.joint_position, &row.robot.pose)?;
        let [about_x, about_y] = carry.glass_tilt;
        let hand_from_glass = Isometry3::from_parts(
            Translation3::from(Vector3::from(carry.glass_center)),
            UnitQuaternion::from_euler_angles(PI + about_x, about_y, 0.0),
        );
        Ok(links[link]
            * hand_from_glass
            * Translation3::new(0.0, 0.0, -carry.glass_height * self.scene.spec.scale.bulb(bulb)))
    }

    /// Closes the hand, first around the bulb held still, then around the free bulb.
    pub(super) fn close_hand(&self, world: &mut World, row: &Row, bulb: Bulb) -> Result<(), StartError> {
        let scene = self.scene;
        let carry = &scene.config.start.carry;
        let mut locked = vec![true; scene.model.nv()];
        for joint in carry.grip.keys().filter_map(|name| scene.robot.joint_index(name)) {
            locked[scene.robot_ids.joints[joint].dof] = false;
        }
        let steps = |time: f64| libm::round(time / PHYSICS_DT) as usize;
        let closed = world.stage(&row.joint_target, &locked, steps(carry.closing_time));
        let body = scene.body(bulb.thing());
        // A task's scene has its bulbs.
        if let Some(body) = body {
            let dof = scene.model.bodies()[body.0].dof_start;
            locked[dof..dof + 6].fill(false);
        }
        let held = world.stage(&row.joint_target, &locked, steps(carry.holding_time));

        let (least_n, most_n) = (self.thresholds.touch_n, self.thresholds.fragility_n);
        let forces = world.row().force(errand::HAND_FORCE[bulb as usize]);
        let largest = forces.iter().fold(0.0, |largest: f64, force| largest.max(force.norm()));
        let force_n = if closed && held { largest } else { f64::INFINITY };
        if force_n > least_n && force_n <= most_n {
            return Ok(());
        }
        let Start { task, seed, episode, .. } = *self;
        Err(StartError::Hold { task, seed, episode, force_n, least_n, most_n })
    }
}
