//! What rewards are made of: the kinds of terms, and measures that several tasks pay for.

pub(crate) mod hints;
pub(crate) mod motion;
pub(crate) mod term;
