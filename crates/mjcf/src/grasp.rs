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
        let grasp = scene.bulb_grasp().ok()?;
        let joints = scene.robot.joints();
        let grip = grasp.grip.iter().map(|(joint, angle)| (joints[*joint].name.clone(), *angle)).collect();
        let turn = UnitQuaternion::from_euler_angles(PI + grasp.glass_tilt[0], grasp.glass_tilt[1], 0.0);
        let link_from_glass = Isometry3::from_parts(Translation3::from(Vector3::from(grasp.glass_center)), turn);
        let ids = &scene.robot_ids.links[grasp.link];
        let site = Site { body: ids.body, body_from_site: ids.body_from_link * link_from_glass };
        Some(Self { site, glass_height: grasp.glass_height, grip })
    }
}
