//! What can go wrong when a session is opened.

use std::path::PathBuf;

use thiserror::Error;

/// Why there is no session.
#[derive(Debug, Error)]
pub enum LinkError {
    /// The config file cannot be read, or is no Zenoh config.
    #[error("{}: no Zenoh config can be read from it: {reason}; it is json5, with the keys of Zenoh's own tools", path.display())]
    ConfigFile {
        /// The file.
        path: PathBuf,
        /// What Zenoh says.
        reason: String,
    },
    /// Zenoh refuses a setting.
    #[error("Zenoh refuses {key} = {value}: {reason}; check the value in the config file or on the command line")]
    Setting {
        /// Path of the setting.
        key: &'static str,
        /// JSON.
        value: String,
        /// What Zenoh says.
        reason: String,
    },
    /// The config asks for what this build does not have, or for what would have no effect.
    #[error("{key}: {reason}; {remedy}")]
    NotHonoured {
        /// Path of the setting.
        key: &'static str,
        /// Why.
        reason: String,
        /// What to do.
        remedy: &'static str,
    },
    /// An encrypted endpoint without a certificate.
    #[error(
        "{endpoint} needs a certificate, and the config has no {key}; \
         `fiatlux keys --out DIR` makes certificates and configs: start with -c DIR/CONFIG.json5"
    )]
    Certificate {
        /// The endpoint.
        endpoint: String,
        /// Path of the setting.
        key: String,
    },
    /// Certificates that cannot be read or that the other side does not take.
    #[error(
        "no TLS connection at {endpoints} ({reason}); both sides need certificates of the same `fiatlux keys --out DIR`, \
         whose --host names the address; are they expired?"
    )]
    Tls {
        /// Where.
        endpoints: String,
        /// What Zenoh says.
        reason: String,
    },
    /// An endpoint cannot be read, or its protocol is not built in.
    #[error("{flag} {endpoint}: {reason}")]
    Endpoint {
        /// The flag or setting that it was given with.
        flag: &'static str,
        /// As given.
        endpoint: String,
        /// What is wrong, and how it is written.
        reason: String,
    },
    /// Nothing answers where the session should connect.
    #[error(
        "nothing answers at {endpoints} within {timeout_s} s ({reason}); \
         is the server running and is the address right? Name another with -e tcp/HOST:PORT"
    )]
    Connect {
        /// Where it should connect.
        endpoints: String,
        /// s.
        timeout_s: f64,
        /// What Zenoh says.
        reason: String,
    },
    /// An address cannot be listened on.
    #[error(
        "cannot listen on {endpoints} ({reason}); \
         another program may hold the port: stop it, or name another port with -l tcp/HOST:PORT"
    )]
    Listen {
        /// Where it should listen.
        endpoints: String,
        /// What Zenoh says.
        reason: String,
    },
    /// Anything else that Zenoh reports.
    #[error("no Zenoh session can be opened: {reason}; RUST_LOG=zenoh=debug shows more")]
    Open {
        /// What Zenoh says.
        reason: String,
    },
}
