//! Looks of things.

/// Appearance of things. The bytes of a sensor's pictures depend on it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Look {
    /// Things as the robot's cameras see them: part of the benchmark's version.
    One,
    /// Things as people see them: the robot's own surfaces, a lamp that lights what is near it.
    Two,
}
