//! Key expressions. Everything of a server stands below `fiatlux/v3/<server>`.

/// Root of all servers.
pub const ROOT: &str = "fiatlux/v3";

/// Root of servers that speak protocol 2 or an older one. A server of today is seen there too, and refuses to open.
pub const LEGACY_ROOT: &str = "fiatlux/v1";

/// Longest name of a server, bytes.
pub const MAX_NAME: usize = 64;

/// True if a text can be a server's name: 1 to 64 letters, digits, `-` or `_`.
pub fn is_name(name: &str) -> bool {
    let fits = |byte: u8| byte.is_ascii_alphanumeric() || byte == b'-' || byte == b'_';
    (1..=MAX_NAME).contains(&name.len()) && name.bytes().all(fits)
}

/// Liveliness tokens of all servers.
pub fn any_alive() -> String {
    format!("{ROOT}/*/alive")
}

/// Liveliness tokens of all servers below [`LEGACY_ROOT`].
pub fn any_legacy_alive() -> String {
    format!("{LEGACY_ROOT}/*/alive")
}

/// Liveliness tokens for recorders, of all sessions of all servers, or of one.
pub fn any_truth_live(server: Option<&str>) -> String {
    ServerKeys::new(server.unwrap_or("*")).session("*").truth_live("*")
}

/// Liveliness tokens for clients, of all sessions of all servers, or of one.
pub fn any_live(server: Option<&str>) -> String {
    ServerKeys::new(server.unwrap_or("*")).session("*").live()
}

/// Records of all sessions of all servers, or of one.
pub fn any_truth_row(server: Option<&str>) -> String {
    ServerKeys::new(server.unwrap_or("*")).session("*").truth_row()
}

/// Server named by the key of a liveliness token, whichever root that has.
pub fn server_of(key: &str) -> Option<&str> {
    let below = key.strip_prefix(ROOT).or_else(|| key.strip_prefix(LEGACY_ROOT))?;
    below.strip_prefix('/')?.split('/').next().filter(|name| is_name(name))
}

/// Keys of a server.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ServerKeys {
    root: String,
}

impl ServerKeys {
    /// Of the server of that name.
    pub fn new(server: &str) -> Self {
        Self { root: format!("{ROOT}/{server}") }
    }

    /// Of the server of that name below [`LEGACY_ROOT`]: of these keys it has `alive`, `describe` and `open`.
    pub fn legacy(server: &str) -> Self {
        Self { root: format!("{LEGACY_ROOT}/{server}") }
    }

    /// Liveliness token: the server is there.
    pub fn alive(&self) -> String {
        format!("{}/alive", self.root)
    }

    /// Queryable that answers with a [`crate::v3::ServerInfo`].
    pub fn describe(&self) -> String {
        format!("{}/describe", self.root)
    }

    /// Queryable: [`crate::v3::OpenRequest`] to [`crate::v3::OpenReply`].
    pub fn open(&self) -> String {
        format!("{}/open", self.root)
    }

    /// Queryable: [`crate::v3::RunRequest`] to [`crate::v3::RunReply`].
    pub fn run(&self) -> String {
        format!("{}/run", self.root)
    }

    /// Keys of one of its sessions.
    pub fn session(&self, session: &str) -> SessionKeys {
        SessionKeys { root: format!("{}/s/{session}", self.root) }
    }
}

/// Keys of a session.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct SessionKeys {
    root: String,
}

impl SessionKeys {
    /// Keys of the session that a key belongs to, whichever of its keys that is; with the server's and the session's names.
    pub fn of(key: &str) -> Option<(Self, &str, &str)> {
        let mut parts = key.strip_prefix(ROOT)?.strip_prefix('/')?.split('/');
        let (server, s, session) = (parts.next()?, parts.next()?, parts.next()?);
        let fits = s == "s" && is_name(server) && is_name(session);
        fits.then(|| (ServerKeys::new(server).session(session), server, session))
    }

    /// Prefix of all its keys.
    pub fn root(&self) -> &str {
        &self.root
    }

    /// Liveliness token of the server: the session is open, or its truths are not all recorded yet.
    pub fn live(&self) -> String {
        format!("{}/live", self.root)
    }

    /// Liveliness token of the client.
    pub fn client(&self) -> String {
        format!("{}/client", self.root)
    }

    /// Publication [`crate::v3::Observation`]; and queryable, for the last one.
    pub fn observation(&self) -> String {
        format!("{}/observation", self.root)
    }

    /// Subscription of the server: [`crate::v3::Action`].
    pub fn action(&self) -> String {
        format!("{}/action", self.root)
    }

    /// Publication of the server: [`crate::v3::Notice`].
    pub fn notice(&self) -> String {
        format!("{}/notice", self.root)
    }

    /// Queryable: [`crate::v3::ResetRequest`] to [`crate::v3::ResetReply`].
    pub fn reset(&self) -> String {
        format!("{}/reset", self.root)
    }

    /// Queryable: [`crate::v3::CloseRequest`] to [`crate::v3::CloseReply`].
    pub fn close(&self) -> String {
        format!("{}/close", self.root)
    }

    /// Queryable: [`crate::v3::LookRequest`] to [`crate::v3::LookReply`].
    pub fn look(&self) -> String {
        format!("{}/look", self.root)
    }

    /// Publication [`crate::v3::StepRecord`], one for each row.
    pub fn truth_row(&self) -> String {
        format!("{}/truth/row", self.root)
    }

    /// Liveliness token of the server for its recorders, like [`Self::live`]. The proof shows that it comes from a server with
    /// the recorders' key.
    pub fn truth_live(&self, proof: &str) -> String {
        format!("{}/truth/live/{proof}", self.root)
    }

    /// Queryable: [`crate::v3::StepRecordRequest`] to one [`crate::v3::StepRecord`] a reply, as far as the server has them.
    pub fn truth_rows(&self) -> String {
        format!("{}/truth/rows", self.root)
    }

    /// Subscription of the server: [`crate::v3::StepRecordAck`].
    pub fn truth_ack(&self) -> String {
        format!("{}/truth/ack", self.root)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names() {
        for good in ["a", "lab-2", "S_1", &"x".repeat(64)] {
            assert!(is_name(good), "{good}");
        }
        for bad in ["", "a/b", "*", "a b", "ä", "$x", &"x".repeat(65)] {
            assert!(!is_name(bad), "{bad}");
        }
    }

    #[test]
    fn keys_read_back() {
        let keys = ServerKeys::new("lab").session("7");
        assert_eq!(SessionKeys::of(&keys.live()), Some((keys.clone(), "lab", "7")));
        assert_eq!(keys.truth_row(), "fiatlux/v3/lab/s/7/truth/row");
        for keys in [ServerKeys::new("lab"), ServerKeys::legacy("lab")] {
            assert_eq!(server_of(&keys.alive()), Some("lab"));
        }
        assert_eq!(server_of("fiatlux/v2/lab/alive"), None);
        for bad in ["fiatlux/v3/lab", "fiatlux/v2/lab/s/7/live", "fiatlux/v3/lab/s", "fiatlux/v3/l b/s/7", ""] {
            assert_eq!(SessionKeys::of(bad), None, "{bad}");
        }
    }
}
