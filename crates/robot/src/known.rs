//! Robots from their files: those that come with the library, and others.

use crate::names::{NAMES, ROBOTS};
use crate::{Robot, RobotError};

impl Robot {
    /// Names of the robots that [`Robot::by_name`] knows, one for each file of `robots/`. The first is the benchmark's.
    pub const NAMES: [&str; ROBOTS.len()] = NAMES;

    /// Reads and checks a robot file: a whole robot, as `g1_inspire.toml`, or one made from a known robot, as `g1_bare.toml`.
    /// The headers of these files describe the formats.
    ///
    /// # Errors
    /// [`RobotError::Syntax`] and [`RobotError::Value`], with the line at fault.
    pub fn from_toml(text: &str) -> Result<Self, RobotError> {
        if names_base(text) { crate::variant::load(text, text_of) } else { crate::load::load(text) }
    }

    /// A robot that comes with the library.
    ///
    /// # Errors
    /// [`RobotError::Name`] for any other name; it lists the known ones.
    pub fn by_name(name: &str) -> Result<Self, RobotError> {
        Self::from_toml(text_of(name)?)
    }

    /// The name of a known robot as [`Robot::NAMES`] has it; of the benchmark's where none is given.
    ///
    /// # Errors
    /// [`RobotError::Name`] for any other name; it lists the known ones.
    pub fn known(name: &str) -> Result<&'static str, RobotError> {
        match NAMES.into_iter().find(|known| *known == name) {
            None if name.is_empty() => Ok(NAMES[0]),
            None => Err(RobotError::Name(name.into())),
            Some(known) => Ok(known),
        }
    }

    /// The robot that has these joints in this order, for peers that know the joints alone.
    ///
    /// # Errors
    /// [`RobotError::Joints`] when no known robot has them.
    pub fn with_joints<'a>(names: impl Iterator<Item = &'a str> + Clone) -> Result<Self, RobotError> {
        for known in Self::NAMES {
            let robot = Self::by_name(known)?;
            if robot.joints.iter().map(|joint| joint.name.as_str()).eq(names.clone()) {
                return Ok(robot);
            }
        }
        Err(RobotError::Joints { found: names.count() })
    }

    /// The Unitree G1 with 29 body joints and two Inspire hands of 12 joints each.
    ///
    /// # Errors
    /// As [`Robot::from_toml`].
    pub fn g1_inspire() -> Result<Self, RobotError> {
        Self::by_name(NAMES[0])
    }
}

/// The embedded file of a known robot.
fn text_of(name: &str) -> Result<&'static str, RobotError> {
    let known = ROBOTS.into_iter().find(|(known, _)| *known == name);
    known.map(|(_, text)| text).ok_or_else(|| RobotError::Name(name.into()))
}

/// True if a text says that it is made from another robot. One that is not TOML says nothing; its reader will complain.
fn names_base(text: &str) -> bool {
    toml::de::DeTable::parse(text).is_ok_and(|table| table.get_ref().contains_key("base"))
}
