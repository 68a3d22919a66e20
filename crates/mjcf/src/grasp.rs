//! The grasp with which the right hand of a scene's robot holds a bulb, as a site.

use std::collections::BTreeMap;
use std::f64::consts::PI;

use fiatlux_dynamics::Site;
use fiatlux_world::Scene;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};

/// The grasp with which episodes begin that have a bulb in the hand.
#[derive(Debug, Clone, PartialEq)]
pub struct Grasp {
    /// Centre of the glass; z goes along the bulb's axis, from the cap to the glass.
    pub site: Site,
    /// Height of that centre above the bulb's origin, m.
    pub glass_height: f64,
    /// Targets of the closed hand's joints, by name, rad.
    pub grip: BTreeMap<String, f64>,
}

impl Grasp {
    /// Name of its site.
    pub const SITE: &str = "right_grasp";

    /// That of a scene's robot; none without fingers.
    pub fn of_scene(scene: &Scene) -> Option<Self> {
        let (robot, carry) = (&scene.robot, &scene.config.start.carry);
        let names = robot.joints();
        let (link, center, glass_height, tilt, grip) = match robot.bulb_grasp() {
            Some(own) => {
                let grip = own.grip.iter().map(|(joint, angle)| (names[*joint].name.clone(), *angle)).collect();
                (own.link, own.glass_center, own.glass_height, own.glass_tilt, grip)
            }
            None => {
                let grip: BTreeMap<_, _> = carry.grip.iter().map(|(name, angle)| (name.clone(), *angle)).collect();
                (robot.link_index(&carry.hand_link)?, carry.glass_center, carry.glass_height, carry.glass_tilt, grip)
            }
        };
        if grip.keys().any(|name| robot.joint_index(name).is_none()) {
            return None;
        }
        let turn = UnitQuaternion::from_euler_angles(PI + tilt[0], tilt[1], 0.0);
        let link_from_glass = Isometry3::from_parts(Translation3::from(Vector3::from(center)), turn);
        let ids = &scene.robot_ids.links[link];
        let site = Site { body: ids.body, body_from_site: ids.body_from_link * link_from_glass };
        Some(Self { site, glass_height, grip })
    }
}
