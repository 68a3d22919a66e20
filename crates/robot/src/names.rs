//! Names of the robots that come with the library, and of their hands.

pub(crate) const ROBOTS: [&str; 2] = ["g1_inspire", "g1_bare"];
pub(crate) const HANDS: [&str; 2] = ["inspire", "bare"];
