//! The transport of a program's messages: its options on the command line, whose names are those of Zenoh's own tools, and what is
//! open by them. Another transport has its flag and its choice here, and a file of its own next to
//! `over_zenoh.rs`.

mod config;
mod over_zenoh;

use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

use clap::{Args, ValueEnum};
use fiatlux_carrier::Carrier;
use zenoh::{Session, Wait};

pub use self::config::Role;
use crate::endpoints::{advise, check_endpoint};
use crate::error::reason_of;
use crate::{LinkError, exposure, rules};

/// The options of a program's carrier.
#[derive(Debug, Clone, Default, Args)]
#[command(next_help_heading = "Link (as in Zenoh's tools)")]
pub struct CarrierArgs {
    /// Zenoh config file (json5); the flags below override it
    #[arg(short, long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Connect to this endpoint, such as tcp/192.168.1.7:7447; may be repeated [a client's default:
    /// tcp/127.0.0.1:7447]. Also unixsock-stream/PATH, and quic/ with the certificates of a config file (`fiatlux
    /// keys`)
    #[arg(short = 'e', long, value_name = "ENDPOINT", value_parser = parse_endpoint)]
    pub connect: Vec<String>,
    /// Listen on this endpoint, such as tcp/0.0.0.0:7447; may be repeated [a server's default, unless it has -e:
    /// tcp/127.0.0.1:7447]
    #[arg(short, long, value_name = "ENDPOINT", value_parser = parse_endpoint)]
    pub listen: Vec<String>,
    /// Role in the Zenoh network [default: client for a program that connects to one server, else peer]
    #[arg(long, value_name = "MODE")]
    pub mode: Option<LinkMode>,
    /// Turn multicast scouting off if a config file turns it on; without a config file it is off
    #[arg(long)]
    pub no_multicast_scouting: bool,
    /// The program opens sessions only for holders of tokens, which changes the warning about an open listener. Not a
    /// flag.
    #[arg(skip)]
    pub asks_tokens: bool,
    /// Name of the server that the program is: what it alone publishes is dropped where it arrives from others. Not a flag.
    #[arg(skip)]
    pub serves: Option<String>,
}

impl CarrierArgs {
    /// Opens the session. Blocks for at most [`crate::CONNECT_TIMEOUT_S`] if a client has to connect first, and until
    /// somebody answers if a server has to; a long wait is logged. A connection that is lost later recovers by itself.
    pub fn open(&self, role: Role) -> Result<Link, LinkError> {
        self.open_unless(role, &AtomicBool::new(false))
    }

    /// As [`CarrierArgs::open`]; setting `stop` ends the wait with an error.
    pub fn open_unless(&self, role: Role, stop: &AtomicBool) -> Result<Link, LinkError> {
        let mut config = config::layered(self, role)?;
        if let Some(server) = &self.serves {
            config::drop_forged(&mut config, server)?;
        }
        for endpoint in exposure::exposed(&config) {
            tracing::warn!("{}", exposure::warning(&endpoint, self.asks_tokens));
        }
        over_zenoh::open(config, stop).map(Link)
    }

    /// True if the config's access rules let the program receive what is published on a key.
    ///
    /// # Errors
    /// The config cannot be read.
    pub fn may_subscribe(&self, key: &str, role: Role) -> Result<bool, LinkError> {
        config::layered(self, role).map(|config| rules::may_subscribe(&config, key))
    }

    /// The place where others find a program with these options: `listening on ENDPOINT` or `connected to ENDPOINT`.
    pub fn place(&self, role: Role) -> Result<String, LinkError> {
        config::layered(self, role).map(|config| config::place(&config))
    }
}

/// Carries the messages of sessions over a Zenoh session that was opened elsewhere.
pub fn carrier(session: &Session) -> Carrier {
    Carrier::new(over_zenoh::ZenohTransport(session.clone()))
}

/// A Zenoh session, open until it is closed or dropped.
#[derive(Debug, Clone)]
pub struct Link(Session);

impl Link {
    /// A Zenoh session that stays within the process, for tests of code that uses Zenoh itself. The parts of our
    /// programs use [`fiatlux_carrier::memory`].
    pub fn embedded() -> Result<Self, LinkError> {
        let session = zenoh::open(config::embedded()?).wait();
        session.map(Self).map_err(|source| LinkError::Open { reason: reason_of(&source) })
    }

    pub fn carrier(&self) -> Carrier {
        carrier(&self.0)
    }

    /// The session itself, for what concerns Zenoh alone.
    pub fn session(&self) -> &Session {
        &self.0
    }

    /// Closes the session, after all messages sent before.
    pub fn close(self) -> Result<(), LinkError> {
        self.0.close().wait().map_err(|source| LinkError::Close { reason: reason_of(&source) })
    }
}

/// Checks an endpoint such as `tcp/HOST:PORT`, for the value of a flag: a wrong one is a usage error. The error says
/// how to write it.
pub fn parse_endpoint(text: &str) -> Result<String, String> {
    check_endpoint(text).map(|()| text.into()).map_err(|reason| advise(&reason))
}

/// Role of a program in the Zenoh network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum LinkMode {
    /// Talks to the programs that it is connected to.
    Peer,
    /// Talks through the one peer or router that it is connected to.
    Client,
    /// Passes messages on between other programs.
    Router,
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use clap::error::ErrorKind;

    use super::*;

    #[derive(Debug, Parser)]
    struct Cli {
        #[command(flatten)]
        link: CarrierArgs,
    }

    #[test]
    fn a_wrong_endpoint_is_wrong_usage() {
        for flag in ["-e", "-l"] {
            let parse = |endpoint| Cli::try_parse_from(["x", flag, endpoint]);
            assert!(
                parse("tcp/lab:7447").is_ok_and(|cli| [cli.link.connect, cli.link.listen].concat() == ["tcp/lab:7447"])
            );
            for (endpoint, part) in [("127.0.0.1:7447", "is not an endpoint"), ("ws/lab:1", "ws is not built in")] {
                let error = parse(endpoint).expect_err("refused");
                let text = error.to_string();
                assert_eq!((error.kind(), error.exit_code()), (ErrorKind::ValueValidation, 2));
                assert!(
                    text.contains(part) && text.contains("write tcp/HOST:PORT, such as tcp/127.0.0.1:7447"),
                    "{text}"
                );
            }
        }
    }
}
