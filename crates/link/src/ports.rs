//! Ports that are free.

use std::io;
use std::net::TcpListener;

/// An endpoint with a port that is free now in place of port 0, so that a program can say where it listens. Any other
/// endpoint stays as it is.
///
/// # Errors
/// No port of that host is free, or it is none of this machine's.
pub fn choose_port(endpoint: &str) -> io::Result<String> {
    match endpoint.strip_prefix("tcp/").and_then(|address| address.strip_suffix(":0")) {
        None => Ok(endpoint.to_owned()),
        Some(host) => {
            let free = TcpListener::bind((host.trim_matches(['[', ']']), 0)).and_then(|socket| socket.local_addr())?;
            Ok(format!("tcp/{host}:{}", free.port()))
        }
    }
}
