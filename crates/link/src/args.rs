//! The options of a session on the command line: the names are those of Zenoh's own tools.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::Duration;

use clap::{Args, ValueEnum};
use zenoh::Wait;

use crate::config::{self, Role};
use crate::{Link, LinkError, Waiting, exposure};

/// How often a program that opens its session looks for a signal.
const POLL: Duration = Duration::from_millis(20);

/// Where a program finds the others.
#[derive(Debug, Clone, Default, Args)]
#[command(next_help_heading = "Link (as in Zenoh's tools)")]
pub struct LinkArgs {
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
    /// Whether the program opens sessions for holders of tokens alone, for the warning about an open listener. Not a flag.
    #[arg(skip)]
    pub asks_tokens: bool,
}

/// Checks an endpoint such as `tcp/HOST:PORT`, for the value of a flag: a wrong one is a usage error.
///
/// # Errors
/// What is wrong with the endpoint, and how to write it.
pub fn parse_endpoint(text: &str) -> Result<String, String> {
    config::check_endpoint(text).map(|()| text.into()).map_err(|reason| config::advise(&reason))
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

impl LinkArgs {
    /// Opens the session. Blocks for at most [`crate::CONNECT_TIMEOUT_S`] if a client has to connect first, and until somebody
    /// answers if a server has to; a wait is said in the log. A connection that is lost later recovers by itself.
    ///
    /// # Errors
    /// [`LinkError`]: a wrong config or endpoint, or nothing answers.
    pub fn open(&self, role: Role) -> Result<Link, LinkError> {
        self.open_unless(role, &AtomicBool::new(false))
    }

    /// As [`LinkArgs::open`]; setting `stop` ends the wait.
    ///
    /// # Errors
    /// [`LinkError`], also where it was stopped.
    pub fn open_unless(&self, role: Role, stop: &AtomicBool) -> Result<Link, LinkError> {
        let config = config::layered(self, role)?;
        for endpoint in exposure::exposed(&config) {
            tracing::warn!("{}", exposure::warning(&endpoint, self.asks_tokens));
        }
        let plan = config::Plan::of(&config);
        // Zenoh tries for ever where a server has to connect, so another thread does that.
        let (opened, session) = mpsc::channel();
        let open = move || opened.send(zenoh::open(config).wait());
        let thread = std::thread::Builder::new().name("open".into()).spawn(open);
        thread.map_err(|source| LinkError::Open { reason: source.to_string() })?;
        let mut waiting = Waiting::default();
        loop {
            match session.recv_timeout(POLL) {
                Ok(session) => return session.map(Link).map_err(|source| plan.explain(&source.to_string())),
                Err(RecvTimeoutError::Disconnected) => {
                    return Err(LinkError::Open { reason: "a thread panicked".into() });
                }
                Err(RecvTimeoutError::Timeout) if stop.load(Ordering::Relaxed) => return Err(plan.stopped()),
                Err(RecvTimeoutError::Timeout) if plan.is_patient() => waiting.say(|| plan.peers()),
                Err(RecvTimeoutError::Timeout) => {}
            }
        }
    }

    /// Where others find a program that opened its session with these options: `listening on ENDPOINT` or `connected to
    /// ENDPOINT`.
    ///
    /// # Errors
    /// [`LinkError`]: a wrong config or endpoint.
    pub fn place(&self, role: Role) -> Result<String, LinkError> {
        config::layered(self, role).map(|config| config::place(&config))
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use clap::error::ErrorKind;

    use super::*;

    #[derive(Debug, Parser)]
    struct Cli {
        #[command(flatten)]
        link: LinkArgs,
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
