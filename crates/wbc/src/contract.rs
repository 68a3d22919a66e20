//! The contract of a controller: robot, rates, sizes and training.

use fiatlux_robot::{GainSet, Gains, JointGains, Robot};
use serde::{Deserialize, Serialize};

use crate::{ACTION_CLAMP, ARMS, CONTROL_DT, FRAME, FRAME_LENGTH, MOVED, SCALES, WbcError};

/// Name and version of the contract's layout.
const FORMAT: &str = "fiatlux-wbc/2";
/// The robots that a controller plays: the same legs and waist, and hands that weigh the same.
const ROBOTS: [&str; 2] = ["g1_bare", Robot::NAMES[0]];
/// Part of its own effort limit that a drive needs at least: the maker's hips have 0.63 of what the benchmark gives them, ankles 0.7.
const MIN_EFFORT: f64 = 0.6;

/// The contract of a controller; it stands in its file.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Contract {
    /// Name and version of this layout.
    pub format: String,
    /// The benchmark version whose engine it was trained in.
    pub engine: String,
    /// Name and digest of the robots that it fits.
    pub robots: Vec<(String, String)>,
    /// Legs, waist and arms, in the public joint order; the first 15 are moved.
    pub joints: Vec<Joint>,
    /// Radians of joint target per unit of action, of legs and waist.
    pub scale: [f64; 2],
    /// Actions beyond it count as it.
    pub action_clamp: f64,
    /// Length of a control step, s.
    pub control_dt: f64,
    /// Frames in an observation.
    pub frames: usize,
    /// Terms of a frame, in SI units without scaling: name, count.
    pub observation: Vec<(String, usize)>,
    /// Ranges of vx, vy (m/s), wz (rad/s), height while walking and while standing (m), roll, pitch and yaw (rad).
    pub command: [[f64; 2]; 8],
    /// Numbers into each layer of the network, and out of the last one.
    pub layers: Vec<usize>,
    /// Where it comes from.
    pub training: Training,
}

/// A joint as the controller knows it.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Joint {
    /// Name in the robot's file.
    pub name: String,
    /// Angle of the standing posture, rad.
    pub q0: f64,
    /// Of its drive, N m/rad.
    pub stiffness: f64,
    /// Of its drive, N m s/rad.
    pub damping: f64,
    /// Of its drive, N m.
    pub effort_limit: f64,
}

impl Joint {
    /// The joints of a robot with these drives, in the public joint order.
    pub fn all<'a>(robot: &'a Robot, gains: &'a Gains) -> impl Iterator<Item = Self> + 'a {
        let joints = robot.joints().iter().zip(robot.q0()).zip(&gains.0);
        joints.map(|((joint, q0), drive): (_, &JointGains)| Self {
            name: joint.name.clone(),
            q0: *q0,
            stiffness: drive.stiffness,
            damping: drive.damping,
            effort_limit: drive.effort_limit,
        })
    }
}

/// Record of a controller's training.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Training {
    /// Of networks and worlds.
    pub seed: u64,
    /// Control steps of all worlds together.
    pub samples: u64,
    /// Duration, minutes of wall-clock time.
    pub minutes: f64,
    /// Machine that it ran on.
    pub hardware: String,
}

impl Contract {
    /// Of a controller trained with this version, on the first of its robots with the benchmark's gains.
    ///
    /// # Errors
    /// A robot of this program that cannot be read.
    pub fn of_this_version(
        frames: usize,
        hidden: &[usize],
        training: Training,
    ) -> Result<Self, fiatlux_robot::RobotError> {
        let robots = ROBOTS.map(Robot::by_name).into_iter().collect::<Result<Vec<_>, _>>()?;
        let layers = [frames * FRAME_LENGTH].into_iter().chain(hidden.iter().copied()).chain([MOVED]);
        Ok(Self {
            format: FORMAT.into(),
            engine: engine(),
            robots: robots.iter().map(|robot| (robot.name().into(), robot.digest().into())).collect(),
            joints: Joint::all(&robots[0], &robots[0].gains(GainSet::default())).take(MOVED + ARMS).collect(),
            scale: SCALES,
            action_clamp: ACTION_CLAMP,
            control_dt: CONTROL_DT,
            frames,
            observation: FRAME.map(|(name, count)| (name.to_owned(), count)).into(),
            command: [
                [-0.5, 1.0],
                [-0.4, 0.4],
                [-1.0, 1.0],
                [0.65, 0.79],
                [0.55, 0.79],
                [-0.3, 0.3],
                [-0.1, 0.6],
                [-0.5, 0.5],
            ],
            layers: layers.collect(),
            training,
        })
    }

    /// Range of each number of a command, from low to high, while walking or while standing.
    pub fn command_ranges(&self, walks: bool) -> [[f64; 2]; 7] {
        let [vx, vy, wz, walking, standing, roll, pitch, yaw] = self.command;
        [vx, vy, wz, if walks { walking } else { standing }, roll, pitch, yaw]
    }

    /// Reads what [`Contract::to_json`] wrote, and refuses what was made for another engine or layout.
    pub(crate) fn from_json(text: &str) -> Result<Self, WbcError> {
        let contract: Self = serde_json::from_str(text).map_err(WbcError::Contract)?;
        contract.check()?;
        Ok(contract)
    }

    /// The contract as JSON, as it is stored in the file.
    pub fn to_json(&self) -> String {
        serde_json::json!(self).to_string()
    }

    /// Refuses what was made for another engine, or observes and acts otherwise than this version does.
    fn check(&self) -> Result<(), WbcError> {
        let unfit = |what: &str, found: String, expected: String| match found == expected {
            true => Ok(()),
            false => Err(WbcError::Unfit { what: what.into(), found, expected }),
        };
        unfit("a contract of layout", self.format.clone(), FORMAT.into())?;
        unfit("engine", self.engine.clone(), engine())?;
        unfit("control steps of", format!("{} s", self.control_dt), format!("{CONTROL_DT} s"))?;
        unfit("action scales", format!("{:?}", self.scale), format!("{SCALES:?}"))?;
        unfit("actions up to", format!("{}", self.action_clamp), format!("{ACTION_CLAMP}"))?;
        let frame: Vec<_> = FRAME.iter().map(|(name, count)| format!("{name} {count}")).collect();
        let own: Vec<_> = self.observation.iter().map(|(name, count)| format!("{name} {count}")).collect();
        unfit("observations of", own.join(", "), frame.join(", "))?;
        let sides = (self.layers.first().copied(), self.layers.last().copied());
        let expected = (Some(self.frames * FRAME_LENGTH), Some(MOVED));
        unfit("a network of", format!("{sides:?}"), format!("{expected:?}"))?;
        unfit("joints in number", self.joints.len().to_string(), (MOVED + ARMS).to_string())
    }

    /// Refuses a robot that is not one of the contract's, by its digest.
    ///
    /// # Errors
    /// [`WbcError::Unfit`], with the robots' names.
    pub fn fits_robot(&self, robot: &Robot) -> Result<(), WbcError> {
        if self.robots.iter().any(|(_, digest)| digest == robot.digest()) {
            return Ok(());
        }
        let name = |(name, digest): &(String, String)| format!("{name} ({})", digest.get(..8).unwrap_or(digest));
        let found = self.robots.iter().map(name).collect::<Vec<_>>().join(", ");
        let expected = name(&(robot.name().into(), robot.digest().into()));
        Err(WbcError::Unfit { what: "robot".into(), found, expected })
    }

    /// Refuses joints that differ in name, posture or, of legs and waist, gains; more may follow. Drives may be weaker than those that
    /// it was trained with, down to 0.6 of their effort: it plays them as they are, at rates of their own.
    ///
    /// # Errors
    /// [`WbcError::Unfit`], with the joint's name.
    pub fn fits_joints(&self, joints: &[Joint]) -> Result<(), WbcError> {
        for (index, own) in self.joints.iter().enumerate() {
            let unfit = |what: String, found: String, expected: String| WbcError::Unfit { what, found, expected };
            let Some(joint) = joints.get(index) else {
                let what = format!("a robot whose joint {index} is");
                return Err(unfit(what, own.name.clone(), "missing".into()));
            };
            if joint.name != own.name {
                return Err(unfit(format!("a robot whose joint {index} is"), own.name.clone(), joint.name.clone()));
            }
            let is_weaker = (MIN_EFFORT * own.effort_limit..own.effort_limit).contains(&joint.effort_limit);
            let pairs = [
                ("q0", own.q0, joint.q0, true),
                ("stiffness", own.stiffness, joint.stiffness, index < MOVED),
                ("damping", own.damping, joint.damping, index < MOVED),
                ("effort limit", own.effort_limit, joint.effort_limit, index < MOVED && !is_weaker),
            ];
            for (name, found, expected, counts) in pairs {
                // A message may carry f32.
                if counts && (found - expected).abs() > 1e-5 * found.abs().max(1.0) {
                    let what = format!("a {name} of joint {} of", own.name);
                    return Err(unfit(what, found.to_string(), expected.to_string()));
                }
            }
        }
        Ok(())
    }
}

/// This version's engine.
fn engine() -> String {
    format!("benchmark {}", fiatlux_rules::pins::ENGINE_VERSION)
}
