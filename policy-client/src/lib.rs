//! Policies and their session loop.
//!
//! A [`Policy`] turns observations into commands. [`Client`] opens a session on a server and runs episodes of it;
//! [`ClientSession`] holds the rules of the exchange and does no I/O. A new policy is one file in `policies/`, with a line
//! in [`policies::by_name`].
pub mod balance;
mod client;
pub mod policies;
mod policy;
mod session;
mod session_args;
mod stats;

pub use client::{Client, ClientError, describe_servers, find_server};
pub use policy::{Command, Policy, PolicyError};
pub use session::{ClientSession, Output, SessionFailure};
pub use session_args::SessionArgs;
pub use stats::RoundTrips;
