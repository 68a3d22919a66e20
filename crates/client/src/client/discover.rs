//! Finds servers.

use std::collections::{BTreeMap, BTreeSet};
use std::time::{Duration, Instant};

use fiatlux_carrier::{Carrier, Question};
use fiatlux_proto::keys::{ServerKeys, any_alive, any_legacy_alive, is_name, server_of};
use fiatlux_proto::limits::MAX_SERVER_MESSAGE;
use fiatlux_proto::v3::ServerInfo;
use fiatlux_proto::{PROTOCOL, decode, is_compatible};

use super::ClientError;

/// Time to look for a server, s. Tokens take a moment to arrive after connecting.
pub(crate) const DISCOVERY_S: f64 = 5.0;

/// Longest time for one look.
const LOOK: Duration = Duration::from_millis(500);

/// Name of the server to use: the requested one if it exists, or the only one.
///
/// # Errors
/// No server, several of them, another one, or one of an older version; the error lists them.
pub fn find_server(link: &Carrier, wanted: Option<&str>) -> Result<String, ClientError> {
    let start = Instant::now();
    loop {
        let found: Vec<String> = live_servers(link)?.into_iter().collect();
        match (wanted, found.as_slice()) {
            (Some(name), _) if found.iter().any(|other| other == name) => return Ok(name.into()),
            (None, [only]) => return Ok(only.clone()),
            (None, [_, _, ..]) => return Err(ClientError::SeveralServers { found }),
            _ => {}
        }
        if start.elapsed().as_secs_f64() >= DISCOVERY_S {
            let is_old = |name: &String| !found.contains(name) && wanted.is_none_or(|wanted| wanted == name);
            let old: Vec<String> = look(link, &any_legacy_alive())?.into_iter().filter(is_old).collect();
            if !old.is_empty() {
                return Err(ClientError::OldServer { found: old });
            }
            return Err(match wanted {
                Some(name) => ClientError::NotThere { name: name.into(), found, waited_s: DISCOVERY_S },
                None => ClientError::NoServer { waited_s: DISCOVERY_S },
            });
        }
        std::thread::sleep(Duration::from_millis(100));
    }
}

/// Descriptions of all servers that answer within about a second, sorted by name. One that cannot be decoded, or has
/// another major version, is skipped with a line in the log.
///
/// # Errors
/// The link fails.
pub fn describe_servers(link: &Carrier) -> Result<Vec<ServerInfo>, ClientError> {
    let mut servers = BTreeMap::new();
    for _ in 0..2 {
        let question = Question { key: ServerKeys::new("*").describe(), timeout: LOOK, ..Question::default() };
        for message in link.ask_all(question)?.flatten() {
            match decode::<ServerInfo>(&message.payload, MAX_SERVER_MESSAGE) {
                Ok(info) if !is_name(&info.server) => {
                    tracing::warn!("{}: skipping a server without a valid name", message.key);
                }
                Ok(info) if info.protocol.as_ref().is_some_and(is_compatible) => {
                    servers.insert(info.server.clone(), info);
                }
                Ok(info) => {
                    let version = info.protocol.map_or_else(|| "no version".into(), |version| version.to_string());
                    tracing::warn!("server {} speaks protocol {version}, this client {PROTOCOL}", info.server);
                }
                Err(error) => tracing::warn!("{}: {error}", message.key),
            }
        }
        if !servers.is_empty() {
            break;
        }
        std::thread::sleep(LOOK);
    }
    Ok(servers.into_values().collect())
}

/// Names of the servers whose liveliness tokens exist now.
///
/// # Errors
/// The link fails.
pub fn live_servers(link: &Carrier) -> Result<BTreeSet<String>, ClientError> {
    look(link, &any_alive())
}

fn look(link: &Carrier, tokens: &str) -> Result<BTreeSet<String>, ClientError> {
    Ok(link.tokens(tokens, LOOK)?.iter().filter_map(|key| server_of(key).map(str::to_owned)).collect())
}
