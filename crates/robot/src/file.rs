//! The robot file as it stands, before any check.

use std::collections::BTreeMap;

use serde::Deserialize;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct RobotFile {
    pub name: String,
    pub hand: String,
    pub joint_order: Vec<String>,
    pub hand_links: Vec<String>,
    pub feet: Vec<String>,
    pub palms: Vec<String>,
    #[serde(default)]
    pub exclude: Vec<Vec<String>>,
    #[serde(default)]
    pub joint_groups: JointGroupsDef,
    #[serde(default)]
    pub sensors: SensorMounts,
    #[serde(default)]
    pub camera: Vec<CameraDef>,
    pub bulb_grasp: Option<BulbGraspDef>,
    pub checks: Checks,
    pub posture: BTreeMap<String, f64>,
    pub gains: GainSets,
    pub material: Vec<MaterialDef>,
    pub link: Vec<LinkDef>,
    pub joint: Vec<JointDef>,
    #[serde(default)]
    pub couple: Vec<CoupleDef>,
    #[serde(default)]
    pub fixed: Vec<FixedDef>,
    pub shape: Vec<ShapeDef>,
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields, default)]
pub(crate) struct JointGroupsDef {
    pub legs: Vec<String>,
    pub ankles: Vec<String>,
    pub waist: Vec<String>,
    pub fingers: Vec<String>,
}

/// The last table of a file on its own.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct JointGroupsTable {
    #[serde(rename = "joint_groups")]
    _groups: JointGroupsDef,
}

#[derive(Deserialize, Default)]
#[serde(deny_unknown_fields)]
pub(crate) struct SensorMounts {
    pub lidar: Option<String>,
}

/// Cameras of several robots, outside their files.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct CameraFile {
    pub camera: Vec<CameraDef>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct CameraDef {
    pub name: String,
    pub link: String,
    #[serde(default)]
    pub xyz: [f64; 3],
    #[serde(default)]
    pub rpy: [f64; 3],
    pub aperture: f64,
    pub focal_length: f64,
    pub near: f64,
    pub hidden_link: Option<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct BulbGraspDef {
    pub link: String,
    pub glass_center: [f64; 3],
    pub glass_height: f64,
    pub glass_tilt: [f64; 2],
    pub grip: BTreeMap<String, f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Checks {
    pub joint_count: usize,
    pub total_mass: f64,
    pub standing_height: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct GainSets {
    pub sonic: TunedGains,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct TunedGains {
    pub natural_frequency_hz: f64,
    pub damping_ratio: f64,
    pub joints: Vec<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct MaterialDef {
    pub name: String,
    pub friction: f64,
    pub static_friction: f64,
    pub priority: i32,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct LinkDef {
    pub name: String,
    pub mass: Option<f64>,
    pub com: Option<[f64; 3]>,
    pub inertia: Option<[f64; 6]>,
    pub group: Option<String>,
    pub material: Option<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct JointDef {
    pub name: String,
    pub parent: String,
    pub child: String,
    #[serde(default)]
    pub xyz: [f64; 3],
    #[serde(default)]
    pub rpy: [f64; 3],
    pub axis: [f64; 3],
    pub lower: f64,
    pub upper: f64,
    pub effort_limit: f64,
    pub speed_limit: Option<f64>,
    pub stiffness: f64,
    pub damping: f64,
    pub armature: f64,
}

/// A joint that follows another.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct CoupleDef {
    pub follower: String,
    pub leader: String,
    pub ratio: f64,
    #[serde(default)]
    pub offset: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct FixedDef {
    pub name: String,
    pub parent: String,
    pub child: String,
    #[serde(default)]
    pub xyz: [f64; 3],
    #[serde(default)]
    pub rpy: [f64; 3],
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct ShapeDef {
    pub name: String,
    pub link: String,
    pub kind: ShapeKind,
    pub pos: Option<[f64; 3]>,
    pub rpy: Option<[f64; 3]>,
    pub from: Option<[f64; 3]>,
    pub to: Option<[f64; 3]>,
    pub radius: Option<f64>,
    pub half_extents: Option<[f64; 3]>,
}

#[derive(Deserialize, Clone, Copy)]
#[serde(rename_all = "lowercase")]
pub(crate) enum ShapeKind {
    Sphere,
    Capsule,
    Box,
}
