//! How a model means the numbers of an action.

/// What the numbers of an action mean.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Representation {
    /// Targets that do not depend on the posture.
    Absolute,
    /// Changes from row to row, beginning at the posture at the time of the question.
    Delta,
    /// Changes relative to the posture at the time of the question.
    Relative,
}

impl Representation {
    const ALL: [(&'static str, Self); 3] =
        [("absolute", Self::Absolute), ("delta", Self::Delta), ("relative", Self::Relative)];

    /// Parses `absolute`, `delta` or `relative`, in any case.
    pub fn by_name(name: &str) -> Option<Self> {
        Self::ALL.iter().find(|(known, _)| known.eq_ignore_ascii_case(name)).map(|(_, known)| *known)
    }

    /// Its name in mappings and in messages.
    pub fn name(self) -> &'static str {
        Self::ALL[self as usize].0
    }
}
