//! Kinds of reward terms, and measures that several tasks pay for.

pub(crate) mod hints;
pub(crate) mod motion;
pub(crate) mod term;
