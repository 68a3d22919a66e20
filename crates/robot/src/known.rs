//! Robots from their files: those that come with the library, and others.

use crate::names::{NAMES, ROBOTS};
use crate::{Robot, RobotError};

impl Robot {
    /// Names of the robots that [`Robot::by_name`] knows, one for each file of `robots/`. The first is the benchmark's.
    pub const NAMES: [&str; ROBOTS.len()] = NAMES;

    /// Reads and checks a robot file: a whole robot, or one made from a known robot, as `g1_bare.toml`.
    /// The headers of these files describe the formats.
    ///
    /// # Errors
    /// [`RobotError::Syntax`] and [`RobotError::Value`], with the line at fault.
    pub fn from_toml(text: &str) -> Result<Self, RobotError> {
        if names_base(text) { crate::variant::load(text, text_of) } else { crate::load::load(text) }
    }

    /// A robot that comes with the library, by its own name or that of its hands.
    ///
    /// # Errors
    /// [`RobotError::Name`] for any other name; it lists the known ones.
    pub fn by_name(name: &str) -> Result<Self, RobotError> {
        Self::from_toml(text_of(name)?)
    }

    /// The name of a known robot as [`Robot::NAMES`] has it, for that name or the name of its hands; of the benchmark's where none is
    /// given.
    ///
    /// # Errors
    /// [`RobotError::Name`] for any other name; it lists the known ones.
    pub fn known(name: &str) -> Result<&'static str, RobotError> {
        if name.is_empty() { Ok(NAMES[0]) } else { Ok(found(name)?.0) }
    }

    /// The robot of a session or a bag: that of the name, which must have these joints in this order. Peers from before sessions
    /// named their robot leave the name empty; then it is the first of [`Robot::NAMES`] with these joints.
    ///
    /// # Errors
    /// [`RobotError::Name`] for an unknown name, [`RobotError::OtherJoints`] for one whose robot has other joints, and
    /// [`RobotError::Joints`] when there is no name and no known robot has them.
    pub fn of_session<'a>(name: &str, joints: impl Iterator<Item = &'a str> + Clone) -> Result<Self, RobotError> {
        let has_them = |robot: &Self| robot.joints.iter().map(|joint| joint.name.as_str()).eq(joints.clone());
        if !name.is_empty() {
            let robot = Self::by_name(name)?;
            let (expected, found) = (robot.joints.len(), joints.clone().count());
            return if has_them(&robot) {
                Ok(robot)
            } else {
                Err(RobotError::OtherJoints { name: name.into(), expected, found })
            };
        }
        for known in Self::NAMES {
            let robot = Self::by_name(known)?;
            if has_them(&robot) {
                return Ok(robot);
            }
        }
        Err(RobotError::Joints { found: joints.count() })
    }

    /// The benchmark's robot, the first of [`Robot::NAMES`].
    ///
    /// # Errors
    /// As [`Robot::from_toml`].
    pub fn benchmark() -> Result<Self, RobotError> {
        Self::by_name(NAMES[0])
    }
}

/// The embedded file of a known robot.
fn text_of(name: &str) -> Result<&'static str, RobotError> {
    Ok(found(name)?.1)
}

/// Name and embedded file of the robot of that name, or with hands of that name.
fn found(name: &str) -> Result<(&'static str, &'static str), RobotError> {
    let known = ROBOTS.into_iter().find(|(known, hand, _)| [*known, *hand].contains(&name));
    known.map(|(known, _, text)| (known, text)).ok_or_else(|| RobotError::Name(name.into()))
}

/// True if a text says that it is made from another robot. One that is not TOML says nothing; its reader will complain.
fn names_base(text: &str) -> bool {
    toml::de::DeTable::parse(text).is_ok_and(|table| table.get_ref().contains_key("base"))
}
