mod command;
mod machine;

pub mod client;
pub mod recorder;
pub mod server;

pub use client::{ClientSession, SessionFailure};
pub use command::{Command, CommandError};
pub use machine::Machine;
pub use recorder::RecorderSession;
pub use server::{Host, ServerSession};
