//! The options of a session on the command line: the names are those of Zenoh's own tools.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use crate::endpoints::{advise, check_endpoint};

/// The options of a program's link.
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
    /// The program opens sessions only for holders of tokens, which changes the warning about an open listener. Not a
    /// flag.
    #[arg(skip)]
    pub asks_tokens: bool,
    /// Name of the server that the program is: what it alone publishes is dropped where it arrives from others. Not a flag.
    #[arg(skip)]
    pub serves: Option<String>,
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
