//! The list of servers whose keys a client knows, by name.

use std::collections::BTreeMap;
use std::path::Path;

use fiatlux_proto::keys::is_name;

use crate::file::{lines, read_public};
use crate::{AccessError, FormatError, PublicKey};

const REMEDY: &str = "each line is NAME ed25519:BASE64; # begins a comment";

/// Public keys of servers by name. A line of the file is `NAME ed25519:BASE64`. A name that ends in `-*` stands for all servers
/// of a group, whose names begin with what is before the `*`; a line with a server's own name counts before it.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct KnownServers(BTreeMap<String, PublicKey>);

impl KnownServers {
    /// Reads a file of lines `NAME ed25519:BASE64`; no two may name the same server.
    pub fn read(path: &Path) -> Result<Self, AccessError> {
        let mut known = BTreeMap::new();
        for (number, line) in lines(&read_public(path)?) {
            let (name, key) = server(line).map_err(|error| error.at(path, number))?;
            if known.insert(name.to_owned(), key).is_some() {
                let problem = format!("'{name}' is in an earlier line too");
                return Err(
                    FormatError::new("NAME", problem, "keep the line with the server's current key").at(path, number)
                );
            }
        }
        Ok(Self(known))
    }

    /// The key of the server of this name: from its own line, or from that of the group with the longest name.
    pub fn key_of(&self, name: &str) -> Option<PublicKey> {
        let ends = name.match_indices('-').rev().map(|(at, _)| format!("{}-*", &name[..at]));
        std::iter::once(name.to_owned()).chain(ends).find_map(|name| self.0.get(&name).copied())
    }

    /// The name of the server with this key, the first in the alphabet if there are several; `None` if it is not known.
    pub fn name_of(&self, key: &PublicKey) -> Option<&str> {
        self.0.iter().find(|(_, known)| *known == key).map(|(name, _)| name.as_str())
    }

    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.0.keys().map(String::as_str)
    }

    pub fn line(name: &str, key: &PublicKey) -> String {
        format!("{name} {key}\n")
    }
}

impl FromIterator<(String, PublicKey)> for KnownServers {
    fn from_iter<I: IntoIterator<Item = (String, PublicKey)>>(servers: I) -> Self {
        Self(servers.into_iter().collect())
    }
}

/// The remedy for a name that [`is_server_or_group`] refuses.
pub const SERVER_OR_GROUP: &str =
    "a name has 1 to 64 letters, digits, - or _; NAME-* stands for all whose names begin with NAME-";

/// True for a server's name, and for one of a group, `NAME-*`.
#[must_use]
pub fn is_server_or_group(name: &str) -> bool {
    is_name(name.strip_suffix('*').filter(|start| start.ends_with('-')).unwrap_or(name))
}

fn server(line: &str) -> Result<(&str, PublicKey), FormatError> {
    let mut words = line.split_whitespace();
    let name = words.next().unwrap_or_default();
    if !is_server_or_group(name) {
        let problem = format!("'{}' cannot be a server's name", name.escape_debug());
        return Err(FormatError::new("NAME", problem, SERVER_OR_GROUP));
    }
    let key = words.next().ok_or_else(|| FormatError::new("public key", "it is missing", REMEDY))?.parse()?;
    match words.next() {
        None => Ok((name, key)),
        Some(_) => Err(FormatError::new("line", "it has a third word", REMEDY)),
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;
    use crate::Identity;

    #[test]
    fn a_group_has_one_line() {
        let keys: Vec<PublicKey> = (0..3).map(|_| Identity::generate().unwrap().public()).collect();
        let lines =
            [("lab", 0), ("lab-*", 1), ("lab-west-*", 2)].map(|(name, key)| KnownServers::line(name, &keys[key]));
        let path = std::env::temp_dir().join(format!("fiatlux-known-{}", std::process::id()));
        std::fs::write(&path, lines.concat()).unwrap();
        let known = KnownServers::read(&path).unwrap();
        for (name, key) in [("lab", 0), ("lab-2", 1), ("lab-east-1", 1), ("lab-west-1", 2), ("lab-west-1-b", 2)] {
            assert_eq!(known.key_of(name), Some(keys[key]), "{name}");
        }
        for stranger in ["la", "laboratory", "labor-1", "my-lab", "lab_1"] {
            assert_eq!(known.key_of(stranger), None, "{stranger}");
        }
        for wrong in ["*", "lab*", "-**", "a-*-b", "l b-*"] {
            std::fs::write(&path, format!("{wrong} {}\n", keys[0])).unwrap();
            assert!(KnownServers::read(&path).is_err(), "{wrong}");
        }
        std::fs::remove_file(&path).unwrap();
    }
}
