//! Sessions and runs as a client plays them, on any carrier.
//!
//! A [`Policy`] turns observations into commands. [`Client`] opens a session on a server and runs episodes in it;
//! [`Client::evaluate`] plays a whole run. [`ClientSession`](fiatlux_session::ClientSession) holds the rules of the
//! exchange and does no I/O. The built-in policies are in `fiatlux_policies`. `policy-client/examples/wave.rs` is a
//! complete program with its own policy.
mod client;
mod lists;
mod policy;
mod replay;
mod run;
mod session_args;
mod shard;
mod stats;

pub use client::{Access, AccessArgs, Client, ClientError, describe_servers, find_server, live_servers};
pub use fiatlux_session::{Command, SessionFailure};
pub use lists::{SeedList, TaskList, fresh_seeds, is_fresh, parse_seed, parse_seeds, parse_tasks};
pub use policy::{Policy, PolicyError, check_tasks, request_of};
pub use replay::Replay;
pub use run::{
    Attempt, AttemptEnd, EpisodeFate, EpisodeOutcome, Playing, RunError, RunFile, RunFileError, RunOptions, RunOutcome,
    RunProgress, WantedEpisode, play_each,
};
pub use session_args::SessionArgs;
pub use shard::{Shard, ShardRecord};
pub use stats::RoundTrips;
