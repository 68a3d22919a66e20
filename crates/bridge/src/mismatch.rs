//! Differences between a mapping and a model server.

use std::fmt;

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MismatchKind {
    /// A camera that only one side has.
    Camera,
    Size,
    /// Number or age of the frames of a camera or of the state.
    Frames,
    /// A key of the state that only one side has.
    State,
    /// A key of the actions that only one side has.
    Action,
    Dimension,
    Horizon,
    Representation,
    Language,
}

impl MismatchKind {
    pub fn name(self) -> &'static str {
        match self {
            Self::Camera => "camera",
            Self::Size => "picture size",
            Self::Frames => "frames",
            Self::State => "state key",
            Self::Action => "action key",
            Self::Dimension => "dimension",
            Self::Horizon => "horizon",
            Self::Representation => "representation",
            Self::Language => "language key",
        }
    }
}

#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Mismatch {
    pub kind: MismatchKind,
    /// The key that differs; empty if the difference belongs to none.
    pub key: String,
    /// The server's value, in words.
    pub server: String,
    /// The mapping's value, in words.
    pub mapping: String,
}

impl fmt::Display for Mismatch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { kind, key, server, mapping } = self;
        write!(f, "{}", kind.name())?;
        if !key.is_empty() {
            write!(f, " '{key}'")?;
        }
        write!(f, ": the server has {server}, the mapping has {mapping}")
    }
}
