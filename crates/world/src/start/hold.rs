//! A bulb in the hand: the hand closes around it in simulation, while all the rest is held still.
//!
//! With a settling time it closes with slippery surfaces, so that bulb and fingers slide to where the grasp encloses the bulb
//! without friction: no contact then pulls along its surface but for the bulb's weight. A grasp that is squeezed askew creeps
//! instead, in every engine whose friction is regularised.

use std::collections::BTreeMap;
use std::f64::consts::PI;

use fiatlux_dynamics::Variation;
use fiatlux_robot::BulbGrasp;
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

impl Scene {
    /// The right hand around a bulb, as episodes begin with one in it: by the robot's file, else by the scene's.
    ///
    /// # Errors
    /// [`StartError::Name`]: the robot has no such hand.
    pub fn bulb_grasp(&self) -> Result<BulbGrasp, StartError> {
        let (robot, carry) = (&self.robot, &self.config.start.carry);
        if let Some(grasp) = robot.bulb_grasp() {
            return Ok(grasp.clone());
        }
        let unknown = |field, name: &str| StartError::Name { field, name: name.into() };
        let find_link = |name: &str| robot.link_index(name).ok_or_else(|| unknown("start.carry.hand_link", name));
        let find_joint = |name: &str| robot.joint_index(name).ok_or_else(|| unknown("start.carry.grip", name));
        Ok(BulbGrasp {
            link: find_link(&carry.hand_link)?,
            glass_center: carry.glass_center,
            glass_height: carry.glass_height,
            glass_tilt: carry.glass_tilt,
            grip: carry
                .grip
                .iter()
                .map(|(name, &angle)| Ok((find_joint(name)?, angle)))
                .filter(|found| !found.as_ref().is_ok_and(|(joint, _)| robot.joints()[*joint].follows.is_some()))
                .collect::<Result<_, StartError>>()?,
        })
    }
}

impl Start<'_> {
    /// Pose of a bulb in the hand that will close around it.
    pub(super) fn world_from_held_bulb(&self, row: &Row, bulb: Bulb) -> Result<Isometry3<f64>, StartError> {
        let grasp = self.scene.bulb_grasp()?;
        let links = self.scene.robot.forward_kinematics(&row.joint_position, &row.robot.pose)?;
        let [about_x, about_y] = grasp.glass_tilt;
        let hand_from_glass = Isometry3::from_parts(
            Translation3::from(Vector3::from(grasp.glass_center)),
            UnitQuaternion::from_euler_angles(PI + about_x, about_y, 0.0),
        );
        Ok(links[grasp.link]
            * hand_from_glass
            * Translation3::new(0.0, 0.0, -grasp.glass_height * self.scene.spec.scale.bulb(bulb)))
    }

    /// Closes the hand, first around the bulb held still, then around the free bulb, in between with slippery surfaces where a
    /// settling time asks for that.
    pub(super) fn close_hand(&self, world: &mut World, row: &Row, bulb: Bulb) -> Result<(), StartError> {
        let scene = self.scene;
        let carry = &scene.config.start.carry;
        let mut locked = vec![true; scene.model.nv()];
        for (joint, _) in scene.bulb_grasp()?.grip {
            locked[scene.robot_ids.joints[joint].dof] = false;
        }
        let steps = |time: f64| libm::round(time / PHYSICS_DT) as usize;
        let settles = carry.settling_time > 0.0;
        if settles {
            let mut slippery = Variation::default();
            scene.set_hand_friction(carry.settling_friction, &mut slippery);
            world.set_variation(&slippery)?;
        }
        let mut is_finite = world.stage(&row.joint_target, &locked, steps(carry.closing_time));
        let body = scene.body(bulb.thing());
        // A task's scene has its bulbs.
        if let Some(body) = body {
            let dof = scene.model.bodies()[body.0].dof_start;
            locked[dof..dof + 6].fill(false);
        }
        if settles {
            is_finite &= world.stage(&row.joint_target, &locked, steps(carry.settling_time));
            world.set_variation(&Variation::default())?;
        }
        is_finite &= world.stage(&row.joint_target, &locked, steps(carry.holding_time));

        let (least_n, most_n) = (self.thresholds.touch_n, self.thresholds.fragility_n);
        let forces = world.row().force(errand::HAND_FORCE[bulb as usize]);
        let largest = forces.iter().fold(0.0, |largest: f64, force| largest.max(force.norm()));
        let force_n = if is_finite { largest } else { f64::INFINITY };
        if force_n > least_n && force_n <= most_n {
            return Ok(());
        }
        let Start { task, seed, episode, .. } = *self;
        Err(StartError::Hold { task, seed, episode, force_n, least_n, most_n })
    }
}
