use std::path::PathBuf;

use thiserror::Error;

#[derive(Debug, Error)]
pub enum LinkError {
    #[error("{}: cannot read it as a Zenoh config: {reason}; write json5 with the keys of Zenoh's own tools", path.display())]
    ConfigFile { path: PathBuf, reason: String },
    #[error("Zenoh refuses {key} = {value}: {reason}; check the value in the config file or on the command line")]
    Setting { key: &'static str, value: String, reason: String },
    /// The config asks for a feature that this build lacks, or that would have no effect.
    #[error("{key}: {reason}; {remedy}")]
    NotHonoured { key: &'static str, reason: String, remedy: &'static str },
    #[error(
        "{endpoint} needs a certificate, but the config has no {key}; \
         `fiatlux keys --out DIR` makes certificates and configs: start with -c DIR/CONFIG.json5"
    )]
    Certificate { endpoint: String, key: String },
    #[error(
        "no TLS connection at {endpoints} ({reason}); both sides need certificates of the same `fiatlux keys --out DIR`, \
         whose --host names the address; are they expired?"
    )]
    Tls { endpoints: String, reason: String },
    #[error("{flag} {endpoint}: {reason}")]
    Endpoint { flag: &'static str, endpoint: String, reason: String },
    #[error(
        "nothing answers at {endpoints} within {timeout_s} s ({reason}); \
         is the server running and is the address right? Name another with -e tcp/HOST:PORT"
    )]
    Connect { endpoints: String, timeout_s: f64, reason: String },
    #[error(
        "{endpoints} answers, but opens no session; it may refuse this program's user and password (those of one \
         `fiatlux keys --out DIR` fit: -c DIR/CONFIG.json5), or be another program"
    )]
    Refused { endpoints: String },
    #[error("stopped before anything answered at {endpoints}")]
    Stopped { endpoints: String },
    #[error(
        "cannot listen on {endpoints} ({reason}); \
         another program may hold the port: stop it, or name another port with -l tcp/HOST:PORT"
    )]
    Listen { endpoints: String, reason: String },
    #[error("cannot open a Zenoh session: {reason}; RUST_LOG=zenoh=debug shows more")]
    Open { reason: String },
    #[error("cannot close the Zenoh session: {reason}")]
    Close { reason: String },
}

/// Zenoh's message, without the place in its sources at its end.
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
