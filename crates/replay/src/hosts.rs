//! Names under which a page of this machine may be asked for.
//!
//! A page of another host can lead its own name to this machine (DNS rebinding), and would then read what is served here as its own.
//! So a request must name this machine by an address in digits, by `localhost` or a name below it, which browsers lead to their own
//! machine and nobody can own, or by a name that its user gave. The port may be any: `ssh -L` and `adb reverse` listen on another one.

use std::net::IpAddr;

use axum::http::{HeaderMap, header};

/// The header `Host` of a request; empty where there is none, or more than one: a proxy before this server may have looked at another.
pub fn host_of(headers: &HeaderMap) -> &str {
    let mut hosts = headers.get_all(header::HOST).iter();
    match (hosts.next(), hosts.next()) {
        (Some(host), None) => host.to_str().unwrap_or_default(),
        _ => "",
    }
}

/// The name in `name:port`, without the brackets of an IPv6 address; `None` if it is not one of that form.
pub fn name_of(authority: &str) -> Option<&str> {
    let is_number = |port: &str| port.bytes().all(|byte| byte.is_ascii_digit()) && port.parse::<u16>().is_ok();
    let is_port =
        |rest: &str| rest.is_empty() || rest.strip_prefix(':').is_some_and(|port| port.is_empty() || is_number(port));
    if let Some(rest) = authority.strip_prefix('[') {
        let (name, rest) = rest.split_once(']')?;
        return is_port(rest).then_some(name);
    }
    let end = authority.find(':').unwrap_or(authority.len());
    is_port(&authority[end..]).then_some(authority[..end].trim_end_matches('.'))
}

/// True if a request with this header `Host` is meant for this machine, which is also called `names`.
pub fn is_own(host: &str, names: &[String]) -> bool {
    name_of(host).is_some_and(|name| {
        let last = name.rsplit('.').next().unwrap_or_default();
        name.parse::<IpAddr>().is_ok() || last.eq_ignore_ascii_case("localhost") || is_one_of(name, names)
    })
}

/// True if a page with this header `Origin` is one that was asked for as `host`. Tunnels that change `Host` keep `Origin`: then its name
/// must be one of `names`.
pub fn is_same_origin(origin: &str, host: &str, names: &[String]) -> bool {
    let parts = [("http://", ":80"), ("https://", ":443")]
        .into_iter()
        .find_map(|(scheme, port)| Some((origin.strip_prefix(scheme)?, port)));
    let Some((authority, port)) = parts else { return false };
    let plain = |authority: &str| authority.strip_suffix(port).unwrap_or(authority).to_ascii_lowercase();
    plain(authority) == plain(host) || name_of(authority).is_some_and(|name| is_one_of(name, names))
}

fn is_one_of(name: &str, names: &[String]) -> bool {
    names.iter().any(|own| own.trim_end_matches('.').eq_ignore_ascii_case(name))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names() -> Vec<String> {
        vec!["Lab.local".into(), "fe80::1".into()]
    }

    #[test]
    fn addresses_and_own_names_are_answered_on_every_port() {
        let own = [
            "127.0.0.1:8420",
            "127.0.0.1",
            "localhost:9000",
            "LOCALHOST.:1",
            "robot.localhost:9000",
            "Robot.LocalHost.",
            "[::1]:80",
            "[::1]",
            "192.168.1.7:8443",
            "lab.local:8443",
            "lab.local.",
        ];
        for host in own {
            assert!(is_own(host, &names()), "{host}");
        }
        let others = [
            "",
            "example.org",
            "evil.example:8420",
            "localhost.evil.example",
            "robot.localhost.evil.example:9000",
            "evillocalhost",
            "evil-localhost:80",
            "localhost%2eevil.example",
            "127.0.0.1.evil.example:8420",
            "user@localhost:8420",
            "localhost:8420@evil.example",
            "localhost:8420/",
            "localhost:99999",
            "localhost:+80",
            "::1",
            "[::1",
            "[localhost]x",
            "127.1",
            "0x7f000001",
            "lab.local.evil",
        ];
        for host in others {
            assert!(!is_own(host, &names()), "{host}");
        }
    }

    #[test]
    fn a_page_connects_to_its_own_server_alone() {
        let cases = [
            ("http://localhost:9000", "localhost:9000", true),
            ("http://LOCALHOST:9000", "localhost:9000", true),
            ("http://localhost", "localhost:80", true),
            ("https://192.168.1.7", "192.168.1.7", true),
            // Behind a tunnel that changes `Host`.
            ("https://lab.local", "127.0.0.1:8420", true),
            ("http://evil.example", "localhost:9000", false),
            ("http://localhost:9000.evil.example", "localhost:9000", false),
            ("http://localhost:3000", "localhost:9000", false),
            ("http://robot.localhost:9000", "robot.localhost:9000", true),
            // Another program of this machine.
            ("http://evil.localhost:9000", "robot.localhost:9000", false),
            ("http://evil.localhost:9000", "127.0.0.1:9000", false),
            ("https://localhost", "localhost:80", false),
            ("null", "null", false),
            ("", "", false),
            ("file://", "", false),
        ];
        for (origin, host, expected) in cases {
            assert_eq!(is_same_origin(origin, host, &names()), expected, "{origin} at {host}");
        }
    }
}
