//! The simulation server: scenes for policies to act in, and their export to other simulators.
mod mjcf;
mod recorder;
mod scene;
mod server;

pub use mjcf::{MjcfOptions, OptionSet, to_mjcf};
#[cfg(test)]
mod rebuild_tests;

pub use recorder::{BagEnd, BagReport, Naming, OnLoss, Recorder, RecorderError, RecorderOptions, RecordsFrom};
pub use scene::{ExportError, ExportScene};
pub use server::{RecordError, RecordsTo, Server, ServerError, ServerOptions, joints};
