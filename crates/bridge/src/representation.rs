//! The representation of a model's actions.

/// The reference of an action's numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Representation {
    /// Targets that do not depend on the posture.
    Absolute,
    /// Changes from row to row, beginning at the posture at the time of the request.
    Delta,
    /// Changes relative to the posture at the time of the request.
    Relative,
}

impl Representation {
    const ALL: [(&'static str, Self); 3] =
        [("absolute", Self::Absolute), ("delta", Self::Delta), ("relative", Self::Relative)];

    /// Parses the name in any case.
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.iter().find(|(known, _)| known.eq_ignore_ascii_case(name)).map(|(_, known)| *known)
    }

    pub fn name(self) -> &'static str {
        Self::ALL[self as usize].0
    }
}
