//! The old bulb in a rig's right hand, grasped as `[start.carry]` of the scene's config says.
#![allow(clippy::unwrap_used, clippy::missing_panics_doc)]

use fiatlux_rules::errand;
use std::f64::consts::PI;

use fiatlux_world::Scene;
use nalgebra::{Isometry3, UnitQuaternion, Vector3};

use crate::Rig;

/// The joints that close the hand and their targets, by index in the public order, rad.
pub fn grip_targets(scene: &Scene) -> Vec<(usize, f64)> {
    let grip = &scene.config.start.carry.grip;
    grip.iter().map(|(name, &target)| (scene.robot.joint_index(name).unwrap(), target)).collect()
}

/// Pose of a bulb in the hand that will close around it.
pub fn world_from_held_bulb(rig: &Rig) -> Isometry3<f64> {
    let carry = &rig.scene.config.start.carry;
    let [about_x, about_y] = carry.glass_tilt;
    let hand_from_glass = Isometry3::from_parts(
        Vector3::from(carry.glass_center).into(),
        UnitQuaternion::from_euler_angles(PI + about_x, about_y, 0.0),
    );
    rig.link_pose(&carry.hand_link) * hand_from_glass * Isometry3::translation(0.0, 0.0, -carry.glass_height)
}

/// Puts the old bulb into the open hand and closes it, everything else held still. From then on the bulb is free; the
/// robot stays locked but for the joints of the grip.
pub fn close_hand(rig: &mut Rig) {
    let scene = rig.scene.clone();
    let bulb = world_from_held_bulb(rig);
    rig.place(scene.body(errand::OLD_BULB).unwrap(), &bulb);
    rig.lock_body(scene.body(errand::OLD_BULB).unwrap(), true);
    rig.lock_robot(true);
    for (joint, target) in grip_targets(&scene) {
        let ids = &scene.robot_ids.joints[joint];
        rig.locked[ids.dof] = false;
        rig.targets[ids.drive] = target;
    }
    rig.run(scene.config.start.carry.closing_time);
    rig.lock_body(scene.body(errand::OLD_BULB).unwrap(), false);
}
