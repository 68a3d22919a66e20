//! Endpoints as Zenoh writes them, and their places in a config.

use std::net::{Ipv6Addr, ToSocketAddrs};

use serde_json::Value;
use zenoh::Config;
use zenoh::config::EndPoint;

use crate::DEFAULT_ENDPOINT;

/// Protocols that are built in. `quic` needs certificates in the config.
const PROTOCOLS: &[&str] = &["tcp", "quic", "unixsock-stream"];

pub const CONNECT: &str = "connect/endpoints";
pub const LISTEN: &str = "listen/endpoints";

pub fn is_encrypted(endpoint: &str) -> bool {
    endpoint.starts_with("quic/")
}

/// Checks an endpoint; the error names the mistake.
pub fn check_endpoint(endpoint: &str) -> Result<(), String> {
    let parsed: EndPoint = endpoint.parse().map_err(|_| "is not an endpoint".to_string())?;
    let protocol = parsed.protocol();
    check_protocol(protocol.as_str())?;
    if protocol.as_str() == "unixsock-stream" { Ok(()) } else { check_address(parsed.address().as_str()) }
}

fn check_address(address: &str) -> Result<(), String> {
    let (host, port) = address.rsplit_once(':').ok_or_else(|| format!("{address} has no port"))?;
    port.parse::<u16>().map_err(|_| format!("the port '{port}' is not a number from 0 to 65535"))?;
    match host.strip_prefix('[').and_then(|host| host.strip_suffix(']')) {
        Some(ip) => ip.parse::<Ipv6Addr>().map(drop).map_err(|_| format!("the host '[{ip}]' is not an IPv6 address")),
        None if host.contains(':') => Err(format!("the host '{host}' needs brackets: [{host}]:{port}")),
        None if host.is_empty() => Err("the host is missing".into()),
        None => Ok(()),
    }
}

/// The first host in a list of endpoints that the system cannot resolve.
pub fn unknown_host(endpoints: &str) -> Option<(&str, &str)> {
    endpoints.split(", ").find_map(|endpoint| {
        let (_, address) = endpoint.split_once('/').filter(|(protocol, _)| !protocol.starts_with("unix"))?;
        let address = address.split(['?', '#']).next().unwrap_or(address);
        address
            .to_socket_addrs()
            .is_err()
            .then(|| (endpoint, address.rsplit_once(':').map_or(address, |(host, _)| host)))
    })
}

/// Checks a protocol; the error says why it is not built in.
pub fn check_protocol(protocol: &str) -> Result<(), String> {
    let why = match protocol {
        // Zenoh 1.10 reads and writes one TLS connection from two threads without a lock, which rustls forbids: programs died
        // of it under load (eclipse-zenoh/zenoh, issue 2557).
        "tls" => " (Zenoh's TLS link corrupts memory; quic/ is TLS 1.3 with the same certificates)",
        // Zenoh retransmits nothing over UDP, not even its own declarations.
        "udp" => " (Zenoh does not retransmit over it; use quic/)",
        _ if PROTOCOLS.contains(&protocol) => return Ok(()),
        _ => "",
    };
    Err(format!("the protocol {protocol} is not built in{why}, only {}", PROTOCOLS.join(", ")))
}

/// Adds to a message how to write an endpoint.
pub fn advise(reason: &str) -> String {
    format!("{reason}; write tcp/HOST:PORT, such as {DEFAULT_ENDPOINT}")
}

/// True if the config has only Zenoh's defaults at this key.
pub fn is_silent(config: &Config, key: &str) -> bool {
    get(config, key) == get(&Config::default(), key)
}

pub fn get(config: &Config, key: &str) -> Value {
    config.get_json(key).ok().and_then(|text| serde_json::from_str(&text).ok()).unwrap_or_default()
}

/// All endpoints in a setting, in any of Zenoh's forms.
pub fn endpoints(setting: &Value) -> Vec<String> {
    match setting {
        Value::String(endpoint) => vec![endpoint.clone()],
        Value::Array(parts) => parts.iter().flat_map(endpoints).collect(),
        // By mode, or as a group of locators with its strategy.
        Value::Object(parts) => {
            parts.iter().filter(|(key, _)| *key != "strategy").flat_map(|(_, part)| endpoints(part)).collect()
        }
        _ => Vec::new(),
    }
}
