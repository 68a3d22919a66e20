//! Finds free ports.

use std::io;
use std::net::{TcpListener, UdpSocket};

/// Replaces port 0 of an endpoint by a port that is free now, so that a program can log the port on which it listens.
/// Any other endpoint stays unchanged.
pub fn choose_port(endpoint: &str) -> io::Result<String> {
    let end = endpoint.find(['?', '#']).unwrap_or(endpoint.len());
    let (locator, options) = endpoint.split_at(end);
    let parts = locator.split_once('/').and_then(|(protocol, address)| Some((protocol, address.strip_suffix(":0")?)));
    let Some((protocol, host)) = parts else { return Ok(endpoint.to_owned()) };
    let address = (host.trim_matches(['[', ']']), 0);
    let free = match protocol {
        "tcp" => TcpListener::bind(address).and_then(|socket| socket.local_addr())?,
        "quic" => UdpSocket::bind(address).and_then(|socket| socket.local_addr())?,
        _ => return Ok(endpoint.to_owned()),
    };
    Ok(format!("{protocol}/{host}:{}{options}", free.port()))
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn port_0_becomes_a_free_one() {
        for (protocol, host) in [("tcp", "127.0.0.1"), ("tcp", "localhost"), ("quic", "127.0.0.1")] {
            for options in ["", "#iface=lo", "?rel=1#iface=lo"] {
                let chosen = choose_port(&format!("{protocol}/{host}:0{options}")).unwrap();
                let rest = chosen.strip_prefix(&format!("{protocol}/{host}:")).unwrap();
                let port: u16 = rest.strip_suffix(options).unwrap().parse().unwrap();
                assert_ne!(port, 0, "{chosen}");
            }
        }
        for same in ["tcp/127.0.0.1:7447", "tcp/127.0.0.1:70", "unixsock-stream//tmp/a:0", "tcp"] {
            assert_eq!(choose_port(same).unwrap(), same);
        }
        assert!(choose_port("tcp/192.0.2.1:0").is_err(), "not an address of this machine");
    }
}
