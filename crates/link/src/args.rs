//! The options of a session on the command line: the names are those of Zenoh's own tools.

use std::path::PathBuf;

use clap::{Args, ValueEnum};
use zenoh::{Session, Wait};

use crate::LinkError;
use crate::config::{self, Role};

/// Where a program finds the others.
#[derive(Debug, Clone, Default, Args)]
#[command(next_help_heading = "Link (as in Zenoh's tools)")]
pub struct LinkArgs {
    /// Zenoh config file (json5); the flags below override it
    #[arg(short, long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Connect to this endpoint, such as tcp/192.168.1.7:7447; may be repeated [a client's default: tcp/127.0.0.1:7447]
    #[arg(short = 'e', long, value_name = "ENDPOINT")]
    pub connect: Vec<String>,
    /// Listen on this endpoint, such as tcp/0.0.0.0:7447; may be repeated [a server's default, unless it has -e:
    /// tcp/127.0.0.1:7447]
    #[arg(short, long, value_name = "ENDPOINT")]
    pub listen: Vec<String>,
    /// Part in the Zenoh network [default: client for a program that connects to one server, else peer]
    #[arg(long, value_name = "MODE")]
    pub mode: Option<LinkMode>,
    /// Turn multicast scouting off where a config file turns it on; without a config file it is off
    #[arg(long)]
    pub no_multicast_scouting: bool,
}

/// Part of a program in the Zenoh network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum LinkMode {
    /// Talks to what it is connected to.
    Peer,
    /// Talks through the one peer or router that it is connected to.
    Client,
    /// Passes on what others say to each other.
    Router,
}

impl LinkArgs {
    /// Opens the session. Blocks for at most [`crate::CONNECT_TIMEOUT_S`] where a client has to connect first; a
    /// connection that is lost later comes back by itself.
    ///
    /// # Errors
    /// [`LinkError`]: a config, an endpoint, or nothing answers.
    pub fn open(&self, role: Role) -> Result<Session, LinkError> {
        let config = config::layered(self, role)?;
        let plan = config::Plan::of(&config);
        zenoh::open(config).wait().map_err(|source| plan.explain(&source.to_string()))
    }
}
