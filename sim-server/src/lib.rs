//! The simulation server: scenes for policies to act in, the recorder of what they do, and the export to other simulators.
//!
//! - [`Server`] takes sessions over Zenoh and steps them on worker threads; with [`RecordsTo`] it says where records go.
//! - [`Recorder`] follows the sessions of servers and writes a bag for each episode.
//! - [`to_mjcf`] writes an [`ExportScene`] as a model of MuJoCo.
//!
//! The rules of a session are in `fiatlux_session`, what is simulated in `fiatlux_world`; this crate joins the two and carries
//! their messages.
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
