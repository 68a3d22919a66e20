use std::fmt;
use std::str::FromStr;

use crate::RobotError;

/// A named set of drive gains.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum GainSet {
    /// The gains of the published benchmark.
    #[default]
    Fiatlux,
    /// Gains of one natural frequency and damping ratio for every motor, which many whole-body controllers are trained on.
    Sonic,
}

impl fmt::Display for GainSet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            GainSet::Fiatlux => "fiatlux",
            GainSet::Sonic => "sonic",
        })
    }
}

impl FromStr for GainSet {
    type Err = RobotError;

    /// # Errors
    /// [`RobotError::GainSet`] for any other name.
    fn from_str(name: &str) -> Result<Self, RobotError> {
        match name {
            "fiatlux" => Ok(GainSet::Fiatlux),
            "sonic" => Ok(GainSet::Sonic),
            _ => Err(RobotError::GainSet(name.into())),
        }
    }
}

/// Drive of one joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointGains {
    /// N m/rad.
    pub stiffness: f64,
    /// N m s/rad.
    pub damping: f64,
    /// N m.
    pub effort_limit: f64,
    /// Rated speed of the motor seen at the joint, rad/s, beyond which it does not accelerate it further; may be infinite.
    pub speed_limit: f64,
    /// Inertia of the motor's rotor seen at the joint, kg m^2.
    pub armature: f64,
}

impl JointGains {
    /// The same drive with the stiffness and damping that give its armature alone this natural frequency (rad/s) and
    /// damping ratio.
    pub(crate) fn tuned(self, frequency: f64, damping_ratio: f64) -> Self {
        Self {
            stiffness: self.armature * frequency * frequency,
            damping: 2.0 * damping_ratio * self.armature * frequency,
            ..self
        }
    }
}

/// Drives of all joints, by joint index.
#[derive(Debug, Clone, PartialEq)]
pub struct Gains(pub Vec<JointGains>);

impl Gains {
    /// Multiplies stiffness and damping of the given joints; limits and armature stay.
    pub fn scale(&mut self, joints: impl IntoIterator<Item = usize>, factor: f64) {
        for index in joints {
            if let Some(gains) = self.0.get_mut(index) {
                gains.stiffness *= factor;
                gains.damping *= factor;
            }
        }
    }
}
