//! Messages over Zenoh: the options of a program on the command line, their defaults, and the
//! [`Carrier`](fiatlux_carrier::Carrier) that sessions use. No other library names a type of Zenoh's.
//!
//! Nothing leaves the loopback interface unless a flag or a config file asks for it: without them a server listens on
//! [`DEFAULT_ENDPOINT`], a client connects to it, and neither scouts.
#![allow(missing_docs)] // Used in this repository alone.
mod carrier_args;
mod endpoints;
mod error;
mod exposure;
mod honoured;
mod ports;
mod rules;
mod waiting;

pub use carrier_args::{CarrierArgs, Link, LinkMode, Role, carrier, parse_endpoint};
pub use error::LinkError;
pub use ports::choose_port;
pub use waiting::WaitLog;

/// Default endpoint: servers listen on it and clients connect to it.
pub const DEFAULT_ENDPOINT: &str = "tcp/127.0.0.1:7447";

/// Time limit for a client that connects to its server, s. A server keeps trying without limit.
pub const CONNECT_TIMEOUT_S: f64 = 5.0;
