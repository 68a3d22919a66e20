//! The Zenoh configs of all parts. A config holds its own certificate and key, so a machine needs only this file, and
//! programs in other languages read the same file.

use std::path::Path;

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use serde_json::{Value, json};

use super::certificates::Credentials;
use super::roles::access_control;
use super::{KeysOptions, Role, is_local};

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

fn config(role: Role, options: &KeysOptions, protocol: &str, transport: Value, subject: &str) -> String {
    let port = options.port;
    let local = is_local(&options.hosts);
    let host = options.hosts.first().map_or("127.0.0.1", String::as_str);
    let host = if host.contains(':') { format!("[{host}]") } else { host.to_owned() };
    let (mode, connect, listen) = match role {
        Role::Router if local => ("router", None, Some(format!("{protocol}/127.0.0.1:{port}"))),
        Role::Router => ("router", None, Some(format!("{protocol}/0.0.0.0:{port}"))),
        _ => ("client", Some(format!("{protocol}/{host}:{port}")), None),
    };
    let list = |endpoint: Option<String>| endpoint.into_iter().collect::<Vec<_>>();
    let config = json!({
        "mode": mode,
        "connect": { "endpoints": list(connect) },
        "listen": { "endpoints": list(listen) },
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
