//! Finds listening endpoints that everybody can reach without authentication.

use std::net::IpAddr;

use zenoh::Config;

use crate::endpoints::{LISTEN, endpoints, get, is_encrypted};

const DICTIONARY: &str = "transport/auth/usrpwd/dictionary_file";
const MTLS: &str = "transport/link/tls/enable_mtls";
const ACCESS_CONTROL: &str = "access_control/enabled";

/// Endpoints that other machines can reach and for which the config demands no authentication.
pub fn exposed(config: &Config) -> Vec<String> {
    // A program with a password of its own asks others for one only if it has a list of users.
    if !get(config, DICTIONARY).is_null() || get(config, ACCESS_CONTROL) == true {
        return Vec::new();
    }
    let mutual = get(config, MTLS) == true;
    let is_open = |endpoint: &String| !(is_local(endpoint) || mutual && is_encrypted(endpoint));
    endpoints(&get(config, LISTEN)).into_iter().filter(is_open).collect()
}

/// A warning about such an endpoint, with the remedy. `asks_tokens`: only holders of a token can open sessions.
pub fn warning(endpoint: &str, asks_tokens: bool) -> String {
    let lack = if is_encrypted(endpoint) { "client certificates" } else { "encryption" };
    let risk = match asks_tokens {
        true => format!(
            "without {lack}: others on the network can read observations and pose as the server to clients without \
             --known-servers; sessions need a token"
        ),
        false => "without access control: anyone who reaches it can read what others sense, pose as the server and, unless it \
                  has --tokens, open sessions"
            .into(),
    };
    format!(
        "listening on {endpoint} {risk}. `fiatlux keys --out DIR` makes certificates and configs to start with (-c \
         DIR/server.json5); or listen on tcp/127.0.0.1:PORT, for this machine alone"
    )
}

/// True if only this machine can reach an endpoint.
fn is_local(endpoint: &str) -> bool {
    let (protocol, address) = endpoint.split_once('/').unwrap_or((endpoint, ""));
    if protocol.starts_with("unix") {
        return true;
    }
    let address = address.split(['?', '#']).next().unwrap_or_default();
    let host = address.rsplit_once(':').map_or(address, |(host, _)| host);
    let host = host.trim_start_matches('[').trim_end_matches(']');
    match host.parse::<IpAddr>() {
        Ok(ip) => ip.to_canonical().is_loopback(),
        Err(_) => host.eq_ignore_ascii_case("localhost"),
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn what_counts_as_this_machine_alone() {
        for local in [
            "tcp/127.0.0.1:7447",
            "tcp/127.8.9.1:0",
            "tcp/[::1]:7447",
            "tcp/localhost:7447",
            "quic/LocalHost:7447#iface=lo",
            "tcp/[::ffff:127.0.0.1]:7447",
            "unixsock-stream//tmp/fiatlux.sock",
        ] {
            assert!(is_local(local), "{local}");
        }
        for open in [
            "tcp/0.0.0.0:7447",
            "tcp/[::]:7447",
            "tcp/192.168.1.7:7447",
            "tcp/224.0.0.224:7447",
            "tcp/lab:7447",
            "tcp/localhost.example.org:7447",
            "tcp/127.0.0.1.example.org:7447",
            "tcp/[::ffff:10.0.0.1]:7447",
            "quic/0.0.0.0:7447?rel=1#iface=eth0",
            "tcp/",
        ] {
            assert!(!is_local(open), "{open}");
        }
    }

    #[test]
    fn access_control_is_a_list_of_users_mutual_tls_or_rules() {
        let of = |rest: &str| {
            let text = format!(
                "{{listen: {{endpoints: {{router: ['tcp/0.0.0.0:1', 'tcp/127.0.0.1:2'], peer: ['quic/0.0.0.0:3']}}}}, {rest}}}"
            );
            exposed(&Config::from_json5(&text).unwrap())
        };
        assert_eq!(of(""), ["quic/0.0.0.0:3", "tcp/0.0.0.0:1"]);
        assert_eq!(of("transport: {link: {tls: {enable_mtls: true}}}"), ["tcp/0.0.0.0:1"]);
        assert_eq!(of("transport: {link: {tls: {enable_mtls: false}}}").len(), 2);
        assert_eq!(of("transport: {auth: {usrpwd: {user: 'a', password: 'b'}}}").len(), 2, "it asks for no password");
        assert!(of("transport: {auth: {usrpwd: {dictionary_file: 'users'}}}").is_empty());
        assert!(of("access_control: {enabled: true, rules: [], subjects: [], policies: []}").is_empty());
        assert!(
            [true, false].iter().all(|tokens| warning("tcp/0.0.0.0:1", *tokens).contains("fiatlux keys --out DIR"))
        );
        assert!(
            warning("tcp/0.0.0.0:1", true).contains("without encryption")
                && !warning("quic/a:1", true).contains("encryption")
        );
    }
}
