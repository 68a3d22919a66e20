use std::fmt;
use std::str::FromStr;

use crate::RobotError;

/// The hands that a robot carries.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum HandKind {
    /// Inspire DFQ: 12 joints, all driven.
    Inspire,
}

impl fmt::Display for HandKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            HandKind::Inspire => "inspire",
        })
    }
}

impl FromStr for HandKind {
    type Err = RobotError;

    /// # Errors
    /// [`RobotError::Hand`] for every other hand, `dex3` among them.
    fn from_str(name: &str) -> Result<Self, RobotError> {
        match name {
            "inspire" => Ok(HandKind::Inspire),
            _ => Err(RobotError::Hand(name.into())),
        }
    }
}
