//! The Zenoh configs of all parts. A config holds its own certificate and key, so a machine needs only this file, and
//! programs in other languages read the same file.

use std::net::IpAddr;
use std::path::Path;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde_json::{Value, json};

use super::certificates::Credentials;
use super::roles::access_control;
use super::{KeysOptions, Role};

/// A config with mutual TLS over QUIC.
pub fn with_certificates(role: Role, options: &KeysOptions, credentials: &Credentials) -> String {
    let (certificate, key) = (STANDARD.encode(&credentials.certificate), STANDARD.encode(&credentials.key));
    let mut tls = json!({
        "enable_mtls": true,
        "close_link_on_expiration": true,
        "root_ca_certificate_base64": STANDARD.encode(&credentials.authority),
    });
    let side = if role == Role::Router { "listen" } else { "connect" };
    tls[format!("{side}_certificate_base64")] = certificate.into();
    tls[format!("{side}_private_key_base64")] = key.into();
    let transport = json!({ "link": { "protocols": ["quic"], "tls": tls } });
    config(role, options, "quic", transport, "cert_common_names")
}

/// A config with a user and a password, without encryption. The router reads the list of users from a file.
pub fn with_passwords(role: Role, options: &KeysOptions, password: &str, users: &Path) -> String {
    let usrpwd = match role {
        Role::Router => json!({ "dictionary_file": users }),
        _ => json!({ "user": role.name(), "password": password }),
    };
    let transport = json!({ "link": { "protocols": ["tcp"] }, "auth": { "usrpwd": usrpwd } });
    config(role, options, "tcp", transport, "usernames")
}

/// Clients and servers that a router admits at once; Zenoh's own limit is 1,000.
const MAX_SESSIONS: u32 = 10_000;

fn config(role: Role, options: &KeysOptions, protocol: &str, mut transport: Value, subject: &str) -> String {
    let port = options.port;
    let host = options.hosts.first().map_or("127.0.0.1", String::as_str);
    let host = if host.contains(':') { format!("[{host}]") } else { host.to_owned() };
    let endpoint = |host: &str| format!("{protocol}/{host}:{port}");
    let (mode, connect, listen) = match role {
        Role::Router => ("router", Vec::new(), addresses(&options.hosts).into_iter().map(endpoint).collect()),
        _ => ("client", vec![endpoint(&host)], Vec::new()),
    };
    if role == Role::Router {
        transport["unicast"] = json!({ "max_sessions": MAX_SESSIONS });
    }
    let config = json!({
        "mode": mode,
        "connect": { "endpoints": connect },
        "listen": { "endpoints": listen },
        "scouting": { "multicast": { "enabled": false }, "gossip": { "enabled": false } },
        "transport": transport,
        "access_control": access_control(role, subject),
    });
    let name = role.name();
    // Writing to a string cannot fail.
    let text = serde_json::to_string_pretty(&config).unwrap_or_default();
    format!(
        "// Zenoh config of the {name}, made by `fiatlux keys`. It holds secrets: only the {name} may read it.\n{text}\n"
    )
}

/// Addresses that the router listens on: of the loopback interface if only this machine is named, else all. `[::]` is
/// reached by IPv4 as well.
fn addresses(hosts: &[String]) -> Vec<&'static str> {
    let has = |is_v6: bool| hosts.iter().any(|host| host.contains(':') == is_v6);
    match (is_local(hosts), has(true)) {
        (true, true) if has(false) => vec!["127.0.0.1", "[::1]"],
        (true, true) => vec!["[::1]"],
        (true, false) => vec!["127.0.0.1"],
        (false, true) => vec!["[::]"],
        (false, false) => vec!["0.0.0.0"],
    }
}

/// True if only this machine is named.
fn is_local(hosts: &[String]) -> bool {
    hosts.iter().all(|host| host == "localhost" || host.parse::<IpAddr>().is_ok_and(|ip| ip.is_loopback()))
}
