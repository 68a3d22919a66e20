//! The published flat vector.

use fiatlux_rules::{LIMBS, Task};
use nalgebra::Vector3;

use super::Proprioception;
use super::table::{FEATURES, Signal, observation_length, observation_terms};
use crate::lidar::LIDAR_RAYS;

/// Everything that goes into a flat vector, in SI units, its noise already in it.
#[derive(Debug, Clone)]
pub struct StandardTerms<'a> {
    /// What the robot senses of its own body.
    pub proprioception: &'a Proprioception,
    /// Force on each hand body, world axes, N; see [`super::hand_force`]. Not read in `climb`.
    pub hand_force: &'a [Vector3<f64>],
    /// Force on each limb, world axes, N; see [`super::limb_force`]. Read in `climb` only.
    pub limb_force: [Vector3<f64>; LIMBS],
    /// Features of the head camera's image.
    pub features: &'a [f32; FEATURES],
    /// Ranges of the LiDAR, m; see [`crate::Lidar::scan`].
    pub lidar: &'a [f32; LIDAR_RAYS],
    /// The last action, as [`fiatlux_rules::Row::action`] has it.
    pub last_action: &'a [f64],
}

/// The flat vector of a task, as [`observation_terms`] lays it out.
pub fn flat_standard(terms: &StandardTerms<'_>, task: Task) -> Vec<f32> {
    let mut flat = Vec::with_capacity(observation_length(task));
    let (right, left) = terms.hand_force.split_at(terms.hand_force.len() / 2);
    let sensed = terms.proprioception;
    for term in observation_terms(task) {
        let numbers = |flat: &mut Vec<f32>, values: &[f64]| {
            flat.extend(values.iter().map(|value| (value * term.scale) as f32));
        };
        let forces = |flat: &mut Vec<f32>, forces: &[Vector3<f64>]| {
            forces.iter().for_each(|force| numbers(flat, force.as_slice()));
        };
        let singles = |flat: &mut Vec<f32>, values: &[f32]| {
            flat.extend(values.iter().map(|value| (f64::from(*value) * term.scale) as f32));
        };
        match term.signal {
            Signal::BaseAngularVelocity => numbers(&mut flat, &sensed.base_angular_velocity),
            Signal::ProjectedGravity => numbers(&mut flat, &sensed.projected_gravity),
            Signal::BaseLinearVelocity => numbers(&mut flat, &sensed.base_linear_velocity),
            Signal::BaseHeight => numbers(&mut flat, &[sensed.base_height]),
            Signal::JointPosition => numbers(&mut flat, &sensed.joint_position),
            Signal::JointVelocity => numbers(&mut flat, &sensed.joint_velocity),
            Signal::RightHandContact => forces(&mut flat, right),
            Signal::LeftHandContact => forces(&mut flat, left),
            Signal::LimbContact => forces(&mut flat, &terms.limb_force),
            Signal::CameraFeatures => singles(&mut flat, terms.features),
            Signal::Lidar => singles(&mut flat, terms.lidar),
            Signal::LastAction => numbers(&mut flat, terms.last_action),
        }
    }
    flat
}
