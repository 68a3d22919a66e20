//! Errors of opening a session.

use std::path::PathBuf;

use thiserror::Error;

/// Why a Zenoh session cannot be opened.
#[derive(Debug, Error)]
pub enum LinkError {
    /// The config file cannot be read, or is not a Zenoh config.
    #[error("{}: cannot read it as a Zenoh config: {reason}; write json5 with the keys of Zenoh's own tools", path.display())]
    ConfigFile {
        path: PathBuf,
        /// What Zenoh says is wrong with it.
        reason: String,
    },
    /// Zenoh refuses a setting.
    #[error("Zenoh refuses {key} = {value}: {reason}; check the value in the config file or on the command line")]
    Setting {
        key: &'static str,
        value: String,
        /// What Zenoh says is wrong with it.
        reason: String,
    },
    /// The config asks for something that this build lacks, or that would have no effect.
    #[error("{key}: {reason}; {remedy}")]
    NotHonoured {
        key: &'static str,
        /// Why this build does not honour it.
        reason: String,
        /// What to do about it, for the end of the message.
        remedy: &'static str,
    },
    /// An encrypted endpoint has no certificate.
    #[error(
        "{endpoint} needs a certificate, but the config has no {key}; \
         `fiatlux keys --out DIR` makes certificates and configs: start with -c DIR/CONFIG.json5"
    )]
    Certificate { endpoint: String, key: String },
    /// Certificates cannot be read, or the other side refuses them.
    #[error(
        "no TLS connection at {endpoints} ({reason}); both sides need certificates of the same `fiatlux keys --out DIR`, \
         whose --host names the address; are they expired?"
    )]
    Tls {
        /// The endpoints that were tried, separated by commas.
        endpoints: String,
        reason: String,
    },
    /// An endpoint cannot be parsed, or its protocol is not built in.
    #[error("{flag} {endpoint}: {reason}")]
    Endpoint {
        /// The flag or setting that it was given with.
        flag: &'static str,
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
        /// Endpoints that were tried, separated by commas.
        endpoints: String,
        /// How long the session tried, s.
        timeout_s: f64,
        reason: String,
    },
    /// Something answers where the session should connect, but lets it in no further.
    #[error(
        "at {endpoints} something answers, but opens no session; it may refuse this program's user and password (those of one \
         `fiatlux keys --out DIR` fit: -c DIR/CONFIG.json5), or be another program"
    )]
    Refused {
        /// Endpoints that were tried, separated by commas.
        endpoints: String,
    },
    /// A signal ended the wait for the other side.
    #[error("stopped before anything answered at {endpoints}")]
    Stopped {
        /// Endpoints that were tried, separated by commas.
        endpoints: String,
    },
    /// The program cannot listen on an address.
    #[error(
        "cannot listen on {endpoints} ({reason}); \
         another program may hold the port: stop it, or name another port with -l tcp/HOST:PORT"
    )]
    Listen {
        /// Endpoints to listen on, separated by commas.
        endpoints: String,
        reason: String,
    },
    /// Any other failure that Zenoh reports.
    #[error("cannot open a Zenoh session: {reason}; RUST_LOG=zenoh=debug shows more")]
    Open { reason: String },
    /// Zenoh cannot close the session.
    #[error("cannot close the Zenoh session: {reason}")]
    Close { reason: String },
}

/// What Zenoh says, without the place in its sources that it ends with.
pub(crate) fn reason_of(source: &impl ToString) -> String {
    let said = source.to_string();
    match said.split_once(" at /") {
        Some((reason, place)) if place.contains(".rs:") => reason.into(),
        _ => said,
    }
}

#[cfg(test)]
mod tests {
    use super::reason_of;

    #[test]
    fn a_reason_names_no_place_in_zenoh() {
        assert_eq!(reason_of(&"no such file at /crates/zenoh-config-1.10.2/src/lib.rs:1507."), "no such file");
        assert_eq!(reason_of(&"cannot read the key at /etc/keys/a.pem"), "cannot read the key at /etc/keys/a.pem");
    }
}
