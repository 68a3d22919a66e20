//! Config keys that this build would ignore: they are refused by name before a session opens.

use std::path::Path;

use serde_json::Value;
use zenoh::Config;

use crate::LinkError;
use crate::endpoints::{self, check_protocol, get, is_silent};

/// Sections that Zenoh parses in any build but uses only in some, with the remedy. Each may only have the values of
/// [`Config::default`], which have no effect.
const NOT_BUILT_IN: &[(&str, &str)] = &[
    (
        "transport/auth/pubkey",
        "use transport/auth/usrpwd, or mutual TLS by transport/link/tls/enable_mtls; `fiatlux keys` makes either",
    ),
    ("transport/unicast/compression/enabled", "set it to false"),
    ("transport/multicast/compression/enabled", "set it to false"),
    ("transport/unicast/max_links", "set it to 1: several links to one peer are not built in"),
    ("transport/link/unixpipe", "remove it; a Unix socket is unixsock-stream/PATH"),
    ("plugins", "remove it, and run Zenoh's own router (zenohd) for plugins"),
    ("plugins_loading", "remove it, and run Zenoh's own router (zenohd) for plugins"),
    ("stats", "remove it"),
];

const SHARED_MEMORY: &str = "transport/shared_memory";
const ACCESS_CONTROL: &str = "access_control";
const LINK_PROTOCOLS: &str = "transport/link/protocols";
const DICTIONARY: &str = "transport/auth/usrpwd/dictionary_file";
/// Largest file of users, bytes.
const MAX_DICTIONARY_BYTES: u64 = 1 << 20;

/// Refuses settings that this build cannot honour.
pub fn check(config: &Config) -> Result<(), LinkError> {
    for &(key, remedy) in NOT_BUILT_IN {
        if !is_silent(config, key) {
            return Err(refused(key, "it is not built in, so it would be ignored", remedy));
        }
    }
    let shared = get(config, SHARED_MEMORY);
    if shared["enabled"] != false && !is_silent(config, SHARED_MEMORY) {
        return Err(refused(
            SHARED_MEMORY,
            "it is not built in, so it would be ignored",
            "remove it or set enabled: false",
        ));
    }
    for protocol in get(config, LINK_PROTOCOLS).as_array().into_iter().flatten().filter_map(Value::as_str) {
        check_protocol(protocol).map_err(|reason| refused(LINK_PROTOCOLS, &reason, "name only these"))?;
    }
    for key in [endpoints::CONNECT, endpoints::LISTEN] {
        for endpoint in endpoints::endpoints(&get(config, key)) {
            endpoints::check_endpoint(&endpoint).map_err(|reason| LinkError::Endpoint {
                flag: key,
                endpoint,
                reason: endpoints::advise(&reason),
            })?;
        }
    }
    // Zenoh accepts these two in any form when it opens a session.
    let rules = get(config, ACCESS_CONTROL);
    let has_rules = ["rules", "subjects", "policies"].iter().any(|part| !rules[part].is_null());
    if has_rules && rules["enabled"] != true {
        let reason = "it has rules but is not enabled, so they would have no effect";
        return Err(refused(ACCESS_CONTROL, reason, "set access_control/enabled: true, or remove the rules"));
    }
    match get(config, DICTIONARY).as_str() {
        None => Ok(()),
        Some(path) => check_dictionary(path),
    }
}

/// An empty list of users would let everybody in.
fn check_dictionary(path: &str) -> Result<(), LinkError> {
    let remedy = "it has a line USER:PASSWORD for each user; paths are relative to the working folder";
    let text = fiatlux_files::read_stream(Path::new(path), MAX_DICTIONARY_BYTES)
        .map_err(|error| refused(DICTIONARY, &format!("cannot read {path}: {error}"), remedy))?;
    if text.trim().is_empty() {
        return Err(refused(DICTIONARY, &format!("{path} names no user, so everybody would be let in"), remedy));
    }
    Ok(())
}

/// Refuses keys of a config file that Zenoh ignores: misspelled ones below a section that takes any key, and ones that
/// no longer have an effect.
pub fn check_keys(text: &str, config: &Config) -> Result<(), String> {
    // The section takes any value, so Zenoh's own reader parses the text here.
    let mut parser = Config::default();
    if parser.insert_json5(ANY, text).is_err() {
        return Ok(());
    }
    let Value::Object(sections) = get(&parser, ANY) else { return Ok(()) };
    for (section, written) in &sections {
        if let Some(key) = unread(written, &get(config, section), section) {
            return Err(format!("{key}: Zenoh has no such key, or it has no effect; check its spelling or remove it"));
        }
    }
    Ok(())
}

const ANY: &str = "metadata";

/// The first key of the written config that the parsed one lacks.
fn unread(written: &Value, read: &Value, path: &str) -> Option<String> {
    match (written, read) {
        (Value::Object(written), Value::Object(read)) => written.iter().find_map(|(key, value)| {
            let path = format!("{path}/{key}");
            match read.get(key) {
                Some(read) => unread(value, read, &path),
                // Secrets are not printed.
                None if value.is_null() || key.ends_with("_base64") => None,
                None => Some(path),
            }
        }),
        (Value::Array(written), Value::Array(read)) => {
            let pairs = written.iter().zip(read).enumerate();
            pairs.into_iter().find_map(|(index, (written, read))| unread(written, read, &format!("{path}/{index}")))
        }
        _ => None,
    }
}

fn refused(key: &'static str, reason: &str, remedy: &'static str) -> LinkError {
    LinkError::NotHonoured { key, reason: reason.to_owned(), remedy }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn config(text: &str) -> Config {
        Config::from_json5(text).unwrap()
    }

    /// Guards that a protection, or any other setting, either works or gives an error.
    #[test]
    fn what_is_not_built_in_is_refused_by_name() {
        for (text, key) in [
            ("{transport: {auth: {pubkey: {key_size: 2048}}}}", "transport/auth/pubkey"),
            ("{transport: {auth: {pubkey: {known_keys_file: 'keys'}}}}", "transport/auth/pubkey"),
            ("{transport: {unicast: {compression: {enabled: true}}}}", "transport/unicast/compression/enabled"),
            ("{transport: {multicast: {compression: {enabled: true}}}}", "transport/multicast/compression/enabled"),
            ("{transport: {unicast: {max_links: 2}}}", "transport/unicast/max_links"),
            ("{transport: {shared_memory: {mode: 'init'}}}", "transport/shared_memory"),
            ("{transport: {link: {unixpipe: {file_access_mask: 384}}}}", "transport/link/unixpipe"),
            ("{transport: {link: {protocols: ['tcp', 'ws']}}}", "the protocol ws is not built in"),
            ("{plugins: {rest: {http_port: 8000}}}", "plugins"),
            ("{plugins_loading: {enabled: true}}", "plugins_loading"),
            ("{stats: {filters: [{key: 'a/b'}]}}", "stats"),
            ("{connect: {endpoints: ['ws/lab:1']}}", "connect/endpoints ws/lab:1: the protocol ws"),
            ("{listen: {endpoints: {peer: ['serial/tty0']}}}", "listen/endpoints serial/tty0: the protocol serial"),
            ("{access_control: {rules: []}}", "set access_control/enabled: true"),
            ("{access_control: {enabled: false, subjects: [{id: 'a'}]}}", "set access_control/enabled: true"),
            ("{transport: {auth: {usrpwd: {dictionary_file: '/nowhere/users'}}}}", "cannot read /nowhere/users"),
            ("{transport: {auth: {usrpwd: {dictionary_file: '/dev/null'}}}}", "/dev/null names no user"),
        ] {
            let message = check(&config(text)).expect_err(text).to_string();
            assert!(message.contains(key), "{text}: {message}");
        }
    }

    #[test]
    fn what_is_built_in_is_taken() {
        for text in [
            "{}",
            "{transport: {shared_memory: {enabled: false}, unicast: {compression: {enabled: false}, max_links: 1}}}",
            "{transport: {link: {protocols: ['tcp', 'quic'], tls: {enable_mtls: true}}}}",
            "{transport: {auth: {usrpwd: {user: 'policy', password: 'x'}, pubkey: {}}}}",
            "{access_control: {enabled: true, default_permission: 'deny', rules: [], subjects: [], policies: []}}",
            "{connect: {endpoints: ['tcp/lab:7447', 'quic/lab:1', 'unixsock-stream//tmp/a.sock']}}",
        ] {
            check(&config(text)).unwrap();
        }
    }

    #[test]
    fn keys_that_zenoh_passes_over_are_refused() {
        let read = |text: &str| check_keys(text, &config(text));
        for (text, key) in [
            ("{connect: {retry: {period_init: 5}}}", "connect/retry/period_init:"),
            (
                "{qos: {publication: [{key_exprs: ['a'], config: {prioritty: 'data'}}]}}",
                "qos/publication/0/config/prioritty:",
            ),
            ("{routing: {peer: {mode: 'linkstate'}}}", "routing/peer:"),
        ] {
            let message = read(text).expect_err(text);
            assert!(message.starts_with(key), "{text}: {message}");
        }
        read(
            "{mode: 'router', metadata: {any: {key: 1}}, connect: {endpoints: {peer: ['tcp/a:1']}, timeout_ms: {router: -1}},
              scouting: {multicast: {enabled: false, autoconnect: ['peer', 'router']}}, id: 'a1',
              transport: {link: {tls: {root_ca_certificate_base64: 'QUJD', enable_mtls: true}, tx: {lease: 5000}}},
              access_control: {enabled: true, default_permission: 'deny', policies: [{rules: ['r'], subjects: ['s']}],
                rules: [{id: 'r', messages: ['put'], flows: ['egress'], permission: 'allow', key_exprs: ['a/**']}],
                subjects: [{id: 's', cert_common_names: ['policy'], usernames: null}]}}",
        )
        .unwrap();
    }
}
