//! The list of servers whose keys a client knows, by name.

use std::collections::BTreeMap;
use std::path::Path;

use fiatlux_proto::keys::is_name;

use crate::file::{lines, read_public};
use crate::{AccessError, FormatError, PublicKey};

const REMEDY: &str = "each line is NAME ed25519:BASE64; # begins a comment";

/// Public keys of servers by name. A line of the file is `NAME ed25519:BASE64`.
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

    pub fn key_of(&self, name: &str) -> Option<PublicKey> {
        self.0.get(name).copied()
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

fn server(line: &str) -> Result<(&str, PublicKey), FormatError> {
    let mut words = line.split_whitespace();
    let name = words.next().unwrap_or_default();
    if !is_name(name) {
        let problem = format!("'{}' cannot be a server's name", name.escape_debug());
        return Err(FormatError::new("NAME", problem, "a name has 1 to 64 letters, digits, - or _"));
    }
    let key = words.next().ok_or_else(|| FormatError::new("public key", "it is missing", REMEDY))?.parse()?;
    match words.next() {
        None => Ok((name, key)),
        Some(_) => Err(FormatError::new("line", "it has a third word", REMEDY)),
    }
}
