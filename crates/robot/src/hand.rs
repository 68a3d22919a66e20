use std::fmt;
use std::str::FromStr;

use crate::RobotError;
use crate::names::HANDS;

/// The hands that a robot carries.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub enum HandKind {
    /// Inspire DFQ: 12 joints, all driven.
    #[default]
    Inspire,
    /// The same hands with their fingers welded: no joint.
    Bare,
}

impl HandKind {
    /// Every kind of hands.
    pub const ALL: [HandKind; 2] = [HandKind::Inspire, HandKind::Bare];

    fn name(self) -> &'static str {
        HANDS[self as usize]
    }
}

impl fmt::Display for HandKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for HandKind {
    type Err = RobotError;

    /// # Errors
    /// [`RobotError::Hand`] for every other hand, `dex3` among them.
    fn from_str(name: &str) -> Result<Self, RobotError> {
        let found = Self::ALL.into_iter().find(|hand| hand.name() == name);
        found.ok_or_else(|| RobotError::Hand(name.into()))
    }
}
