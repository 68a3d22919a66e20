use std::fmt;
use std::str::FromStr;

use crate::RobotError;

/// A named set of drive gains.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum GainSet {
    /// The gains of the published benchmark.
    #[default]
    Fiatlux,
    /// Gains of one natural frequency and damping ratio for every motor, which many whole-body controllers are trained on;
    /// those of GEAR-SONIC.
    Sonic,
    /// Those that GEAR's decoupled whole-body controller is played with by its makers.
    Gear,
    /// [`GainSet::Gear`] with the stiffer knees of the port in LeRobot.
    GearLerobot,
}

impl GainSet {
    /// All gain sets, the benchmark's own first.
    pub const ALL: [Self; 4] = [Self::Fiatlux, Self::Sonic, Self::Gear, Self::GearLerobot];

    /// As a session asks for it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Fiatlux => "fiatlux",
            Self::Sonic => "sonic",
            Self::Gear => "gear",
            Self::GearLerobot => "gear-lerobot",
        }
    }
}

/// Stiffness, N m/rad, and damping, N m s/rad, of the set [`GainSet::Gear`], by the joint's name without its side: MOTOR_KP
/// and MOTOR_KD of `g1_29dof_gear_wbc.yaml` in NVlabs/GR00T-WholeBodyControl.
const GEAR: [(&str, f64, f64); 16] = [
    ("hip_pitch_joint", 150.0, 2.0),
    ("hip_roll_joint", 150.0, 2.0),
    ("hip_yaw_joint", 150.0, 2.0),
    (KNEE, 200.0, 4.0),
    ("ankle_pitch_joint", 40.0, 2.0),
    ("ankle_roll_joint", 40.0, 2.0),
    ("waist_yaw_joint", 250.0, 5.0),
    ("waist_roll_joint", 250.0, 5.0),
    ("waist_pitch_joint", 250.0, 5.0),
    ("shoulder_pitch_joint", 100.0, 5.0),
    ("shoulder_roll_joint", 100.0, 5.0),
    ("shoulder_yaw_joint", 40.0, 2.0),
    ("elbow_joint", 40.0, 2.0),
    ("wrist_roll_joint", 20.0, 2.0),
    ("wrist_pitch_joint", 20.0, 2.0),
    ("wrist_yaw_joint", 20.0, 2.0),
];
const KNEE: &str = "knee_joint";
/// Stiffness of the knees in [`GainSet::GearLerobot`], N m/rad: `config_unitree_g1.py` in huggingface/lerobot.
const LEROBOT_KNEE: f64 = 300.0;

impl fmt::Display for GainSet {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for GainSet {
    type Err = RobotError;

    /// # Errors
    /// [`RobotError::GainSet`] for any other name.
    fn from_str(name: &str) -> Result<Self, RobotError> {
        let known = Self::ALL.into_iter().find(|set| set.name() == name);
        known.ok_or_else(|| RobotError::GainSet(name.into()))
    }
}

/// Drive of one joint.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct JointGains {
    /// Stiffness of the drive, N m/rad.
    pub stiffness: f64,
    /// Damping of the drive, N m s/rad.
    pub damping: f64,
    /// Largest torque of the drive, N m.
    pub effort_limit: f64,
    /// Rated speed of the motor seen at the joint, rad/s, beyond which it does not accelerate it further; may be infinite.
    pub speed_limit: f64,
    /// Inertia of the motor's rotor seen at the joint, kg m^2.
    pub armature: f64,
}

impl JointGains {
    /// The same drive with the stiffness and damping that a set of GEAR gives a joint of this name; fingers keep their own.
    pub(crate) fn of_gear(self, name: &str, set: GainSet) -> Self {
        let joint = name.trim_start_matches("left_").trim_start_matches("right_");
        let Some((_, stiffness, damping)) = GEAR.into_iter().find(|(known, ..)| *known == joint) else { return self };
        let is_stiffer = joint == KNEE && set == GainSet::GearLerobot;
        Self { stiffness: if is_stiffer { LEROBOT_KNEE } else { stiffness }, damping, ..self }
    }

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
