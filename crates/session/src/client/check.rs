//! What a client takes in has the right lengths.

use fiatlux_proto::v3::{Observation, Pose, Privileged, SessionInfo};

/// Rays of a scan.
const LIDAR_RAYS: usize = 5760;
/// Features of an image.
const FEATURES: usize = 512;
/// Feet and palms.
const LIMBS: usize = 4;

/// The lengths of a session's terms.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) struct Lengths {
    joints: usize,
    hand_bodies: usize,
    image: [u32; 2],
    flat: usize,
    criteria: usize,
}

impl Lengths {
    /// Of a session as the server described it.
    pub fn new(info: &SessionInfo) -> Self {
        Self {
            joints: info.joints.len(),
            hand_bodies: info.hand_bodies.len(),
            image: [info.image_width, info.image_height],
            flat: info.flat_terms.iter().map(|term| term.length as usize).sum(),
            criteria: info.task.as_ref().map_or(0, |task| task.criteria.len()),
        }
    }

    /// Passes an observation on whose terms are empty or of the right length.
    pub fn check(&self, observation: Observation) -> Result<Observation, String> {
        let joints = self.joints;
        if let Some(own) = &observation.proprioception {
            exact("base_angular_velocity", own.base_angular_velocity.len(), 3)?;
            exact("projected_gravity", own.projected_gravity.len(), 3)?;
            exact("base_linear_velocity", own.base_linear_velocity.len(), 3)?;
            exact("joint_position", own.joint_position.len(), joints)?;
            exact("joint_velocity", own.joint_velocity.len(), joints)?;
        }
        empty_or("hand_contact_force", observation.hand_contact_force.len(), 3 * self.hand_bodies)?;
        empty_or("limb_contact_force", observation.limb_contact_force.len(), 3 * LIMBS)?;
        empty_or("last_action", observation.last_action.len(), joints)?;
        empty_or("lidar", observation.lidar.len(), LIDAR_RAYS)?;
        if let Some(image) = &observation.camera {
            let [width, height] = self.image;
            if [image.width, image.height] != self.image {
                return Err(format!("camera is {} x {}, not {width} x {height} pixels", image.width, image.height));
            }
            exact("camera.rgb", image.rgb.len(), 3 * width as usize * height as usize)?;
        }
        if let Some(features) = &observation.features {
            exact("features", features.values.len(), FEATURES)?;
        }
        if let Some(flat) = &observation.flat {
            exact("flat", flat.values.len(), self.flat)?;
        }
        if let Some(exact) = &observation.privileged {
            check_privileged(exact)?;
        }
        if let Some(verdict) = &observation.verdict {
            exact("verdict.criteria", verdict.criteria.len(), self.criteria)?;
        }
        Ok(observation)
    }
}

fn exact(name: &str, found: usize, expected: usize) -> Result<(), String> {
    if found == expected { Ok(()) } else { Err(format!("{name} has {found} numbers, not {expected}")) }
}

fn empty_or(name: &str, found: usize, expected: usize) -> Result<(), String> {
    if found == 0 { Ok(()) } else { exact(name, found, expected) }
}

/// The whole errand's terms, or those of `climb`.
fn check_privileged(found: &Privileged) -> Result<(), String> {
    let pose = |name: &str, pose: &Option<Pose>| {
        let Some(pose) = pose else { return Ok(()) };
        exact(&format!("privileged.{name}.position"), pose.position.len(), 3)?;
        exact(&format!("privileged.{name}.quaternion"), pose.quaternion.len(), 4)
    };
    pose("robot", &found.robot)?;
    pose("ladder", &found.ladder)?;
    pose("socket", &found.socket)?;
    pose("fresh_bulb", &found.fresh_bulb)?;
    pose("old_bulb", &found.old_bulb)?;
    pose("crate", &found.crate_)?;
    empty_or("privileged.distances", found.distances.len(), 4)?;
    empty_or("privileged.seated", found.seated.len(), 2)?;
    empty_or("privileged.linear_velocity", found.linear_velocity.len(), 3)
}
