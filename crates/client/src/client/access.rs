//! Keys of servers that a client trusts, and tokens that it shows them.

use std::path::PathBuf;

use clap::Args;
use fiatlux_access::{AccessError, KnownServers, PublicKey, Token};

use super::ClientError;

/// Keys of servers that a client trusts, and tokens that it shows them. By default it trusts whichever server answers.
#[derive(Debug, Clone, Default)]
pub struct Access {
    /// The key that the server must have; `None` to accept any.
    pub server_key: Option<PublicKey>,
    /// Keys of servers by name; servers that are not listed are refused.
    pub known: Option<KnownServers>,
    /// Proof that this client may open sessions, for servers that demand one.
    pub token: Option<Token>,
}

impl Access {
    /// The key that a server of this name must have; `None` to accept any.
    pub(crate) fn key_of(&self, server: &str) -> Result<Option<PublicKey>, ClientError> {
        match (self.server_key, &self.known) {
            (Some(key), _) => Ok(Some(key)),
            (None, None) => Ok(None),
            (None, Some(known)) => {
                let unknown = || ClientError::UnknownServer { server: server.into() };
                known.key_of(server).map(Some).ok_or_else(unknown)
            }
        }
    }
}

/// Command-line flags for keys and tokens.
#[derive(Debug, Clone, Default, Args)]
#[command(next_help_heading = "Access")]
pub struct AccessArgs {
    /// Key that the server must have, ed25519:BASE64 as it prints it
    #[arg(long, value_name = "KEY", conflicts_with = "known_servers")]
    pub server_key: Option<PublicKey>,
    /// File with the keys of known servers, one line NAME ed25519:BASE64 for each; other servers are refused
    #[arg(long, value_name = "FILE")]
    pub known_servers: Option<PathBuf>,
    /// File with the token by which a server lets this client open sessions
    #[arg(long, value_name = "FILE")]
    pub token: Option<PathBuf>,
}

impl AccessArgs {
    /// Reads the files that the flags name.
    ///
    /// # Errors
    /// [`AccessError`]: a file cannot be read, or other users can read the token.
    pub fn read(&self) -> Result<Access, AccessError> {
        Ok(Access {
            server_key: self.server_key,
            known: self.known_servers.as_deref().map(KnownServers::read).transpose()?,
            token: self.token.as_deref().map(Token::read).transpose()?,
        })
    }
}
