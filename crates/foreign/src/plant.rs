//! What a controller was made for: joints, control step, gains.

use std::str::FromStr;

use fiatlux_robot::{GainSet, Robot};
use fiatlux_wbc::{CONTROL_DT, Joint, MOVED};

use crate::{BODY, ForeignError, Reading, gear, sonic};

/// Gains that differ by less than this part are the same: armatures are published with five digits and more.
const TOLERANCE: f64 = 1e-3;

/// What happens where the gains of a joint that the controller moves are not its own.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum GainsRule {
    /// The session is refused.
    #[default]
    Own,
    /// It plays on, and the joints are named.
    Any,
}

impl FromStr for GainsRule {
    type Err = String;

    /// # Errors
    /// A text that names the known rules.
    fn from_str(name: &str) -> Result<Self, String> {
        match name {
            "own" => Ok(Self::Own),
            "any" => Ok(Self::Any),
            _ => Err(format!("there is no rule of gains '{name}'; use own or any")),
        }
    }
}

/// The robot and session that a controller was made for.
#[derive(Debug, Clone)]
pub struct Plant {
    controller: &'static str,
    /// The gains that it plays on.
    gains: GainSet,
    /// Legs, waist and arms in the public joint order: name, stiffness, damping.
    joints: Vec<(String, f64, f64)>,
    /// How many of them it moves.
    moved: usize,
}

impl Plant {
    /// Of GEAR's decoupled controller, which moves legs and waist.
    ///
    /// # Errors
    /// None that a test would not have found: the robot comes with this version.
    pub fn gear(reading: Reading) -> Result<Self, ForeignError> {
        let gains = match reading {
            Reading::Nvidia => GainSet::Gear,
            Reading::Lerobot => GainSet::GearLerobot,
        };
        Self::new(gear::NAME, gains, MOVED)
    }

    /// Of GEAR-SONIC, which moves legs, waist and arms.
    ///
    /// # Errors
    /// None that a test would not have found: the robot comes with this version.
    pub fn sonic() -> Result<Self, ForeignError> {
        Self::new(sonic::NAME, GainSet::Sonic, BODY)
    }

    fn new(controller: &'static str, gains: GainSet, moved: usize) -> Result<Self, ForeignError> {
        let robot = Robot::by_name("g1_bare")?;
        let set = robot.gains(gains).0;
        let joints = robot.joints().iter().zip(set).take(BODY);
        let joints = joints.map(|(joint, gains)| (joint.name.clone(), gains.stiffness, gains.damping)).collect();
        Ok(Self { controller, gains, joints, moved })
    }

    /// The gains that it plays on.
    pub fn gains(&self) -> GainSet {
        self.gains
    }

    /// Compares a session with it. More joints may follow its own. Efforts are the motors' and not compared.
    ///
    /// Returns what differs and is allowed, for a warning: the first joint of other gains, by name. Gains of joints that it
    /// does not move are always allowed to differ.
    ///
    /// # Errors
    /// [`ForeignError::Unfit`]: a joint of another name, another control step, or other gains of a joint that it moves under
    /// [`GainsRule::Own`].
    pub fn fits(&self, joints: &[Joint], control_dt: f64, rule: GainsRule) -> Result<Option<String>, ForeignError> {
        let unfit = |what: String, expected: String, found: String, remedy: String| ForeignError::Unfit {
            controller: self.controller,
            what,
            expected,
            found,
            remedy,
        };
        for (index, (name, ..)) in self.joints.iter().enumerate() {
            let found = joints.get(index).map_or("none", |joint| &joint.name);
            if found != name {
                let remedy = "it plays a G1 of 29 joints in the SDK's order".into();
                return Err(unfit(format!("joint {index}"), name.clone(), found.into(), remedy));
            }
        }
        if (control_dt - CONTROL_DT).abs() > 1e-9 {
            let remedy = "use a server of this version".into();
            return Err(unfit(
                "a control step of".into(),
                format!("{CONTROL_DT} s"),
                format!("{control_dt} s"),
                remedy,
            ));
        }
        let mut first = None;
        for (index, ((name, stiffness, damping), joint)) in self.joints.iter().zip(joints).enumerate() {
            for (term, own, found) in [("stiffness", *stiffness, joint.stiffness), ("damping", *damping, joint.damping)]
            {
                // NaN differs, too.
                if (found - own).abs() <= TOLERANCE * own {
                    continue;
                }
                if index < self.moved && rule == GainsRule::Own {
                    let gains = self.gains;
                    let remedy = format!(
                        "open the session with --gains {gains}, or add ,gains=any after the controller's folder"
                    );
                    let what = format!("a {term} of {name} of");
                    return Err(unfit(what, format!("{own:.3}"), format!("{found:.3}"), remedy));
                }
                first.get_or_insert_with(|| format!("{term} of {name} is {found:.3} instead of {own:.3}"));
            }
        }
        Ok(first)
    }
}
