//! Parameters, as `grab.toml` explains them.

use fiatlux_skills::grip::Angles;
use fiatlux_wbc::ARMS;
use serde::Deserialize;

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Params {
    pub stand: Stand,
    pub grasp: Grasp,
    pub motion: Motion,
    pub close: Close,
    /// Without it, a bulb that lies is left alone.
    pub lying: Option<Lying>,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Stand {
    pub ahead: f64,
    pub left: f64,
    pub close: f64,
    pub clear: f64,
    pub tolerance: f64,
    pub speed: f64,
    pub height: f64,
    pub walk_height: f64,
    pub settle: f64,
    pub patience: f64,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Grasp {
    pub hand_from_glass: [f64; 3],
    pub growth: [f64; 3],
    pub tilt: [f64; 2],
    pub turn: f64,
    pub turns: Turns,
}

#[derive(Debug, Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Turns {
    pub first: f64,
    pub last: f64,
    pub count: u32,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Motion {
    pub rest: [f64; ARMS / 2],
    pub ready: [f64; 3],
    pub pre_grasp: [f64; 3],
    pub rate: f64,
    pub speed: f64,
    pub approach_speed: f64,
    pub lift: f64,
    pub lift_speed: f64,
    pub error: f64,
    pub patience: f64,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Close {
    pub thumb_delay: f64,
    pub finger_delay: f64,
    pub touch: f64,
    pub torque: f64,
    pub excess: f64,
    pub time: f64,
    pub hold: f64,
    pub firm: f64,
    pub verify: f64,
    pub risen: f64,
    pub open: Angles,
    #[serde(default)]
    pub grip: Angles,
}

#[derive(Debug, Clone, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Lying {
    pub hand_from_glass: [f64; 3],
    pub turns: Vec<f64>,
    pub rolls: Vec<f64>,
    pub pitches: Vec<f64>,
    pub neck: [f64; 3],
    pub neck_weight: f64,
    pub margin: f64,
    pub least_margin: f64,
    pub above: f64,
    pub thumb_delay: f64,
    pub finger_delay: f64,
    pub torque: f64,
    #[serde(default)]
    pub grip: Angles,
}
