//! The simulation server: scenes for policies to act in, and their export to other simulators.
mod mjcf;
mod scene;

pub use mjcf::{Laws, MjcfOptions, to_mjcf};
pub use scene::{ExportError, ExportScene};
