//! The conditions that a controller was made for: joints, control step and gains.

use std::str::FromStr;

use fiatlux_robot::{GainSet, Robot};
use fiatlux_wbc::{CONTROL_DT, Joint, MOVED};

use crate::{BODY, ForeignError, Reading, gear, sonic};

/// Gains count as equal if their relative difference is smaller: armatures are published with five digits or more.
const TOLERANCE: f64 = 1e-3;

/// The rule for joints with other gains than the controller was made for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum GainsRule {
    /// Refuse the session.
    #[default]
    Own,
    /// Accept the session, with a warning that names the joints.
    Any,
}

impl FromStr for GainsRule {
    type Err = String;

    /// The error lists the known rules.
    fn from_str(name: &str) -> Result<Self, String> {
        match name {
            "own" => Ok(Self::Own),
            "any" => Ok(Self::Any),
            _ => Err(format!("'{name}' is not a known rule for gains; use own or any")),
        }
    }
}

/// The robot and the session that a controller was made for.
#[derive(Debug, Clone)]
pub struct Plant {
    controller: &'static str,
    /// The set of gains that it was made for.
    gains: GainSet,
    /// Name, stiffness and damping of the joints of legs, waist and arms, in the public order.
    joints: Vec<(String, f64, f64)>,
    /// Number of joints, from the first on, that it moves.
    moved: usize,
}

impl Plant {
    /// The plant of GEAR's decoupled controller, which moves legs and waist.
    pub fn gear(reading: Reading) -> Result<Self, ForeignError> {
        let gains = match reading {
            Reading::Nvidia => GainSet::Gear,
            Reading::Lerobot => GainSet::GearLerobot,
        };
        Self::new(gear::NAME, gains, MOVED)
    }

    /// The plant of GEAR-SONIC, which moves legs, waist and arms.
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

    /// The set of gains that the controller was made for.
    pub fn gains(&self) -> GainSet {
        self.gains
    }

    /// Compares a session with the plant. Further joints may follow the plant's own. Effort limits belong to the motors
    /// and are not compared.
    ///
    /// Returns an allowed difference, for a warning: the first joint with other gains. Gains of joints that the
    /// controller does not move may always differ.
    ///
    /// # Errors
    /// [`ForeignError::Unfit`]: a joint of another name, another control step, or, under [`GainsRule::Own`], other
    /// gains of a joint that the controller moves.
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
                // The comparison also fails for NaN.
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
