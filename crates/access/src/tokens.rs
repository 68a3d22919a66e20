//! Permission to open sessions: a client's token, and the server's list of tokens that it accepts.

use std::collections::BTreeMap;
use std::fmt;
use std::path::Path;
use std::str::FromStr;

use data_encoding::{HEXLOWER, HEXLOWER_PERMISSIVE};
use fiatlux_proto::keys::is_name;
use subtle::ConstantTimeEq as _;

use crate::file::{lines, only_line, read_secret, write_new};
use crate::{AccessError, FormatError, random};

pub const SECRET_BYTES: usize = 32;

pub const MAX_LIMIT: u32 = 65_536;

const TOKEN_REMEDY: &str =
    "a token is one line, ID:SECRET, an ID of letters, digits, - or _ and a secret of 64 hexadecimal digits";
const GRANT_REMEDY: &str = "each line is ID SECRET LIMIT, the secret of 64 hexadecimal digits; # begins a comment";
const LIMIT_REMEDY: &str = "LIMIT is how many sessions it may have open at once, 1 to 65536";
const ID_REMEDY: &str = "an ID has 1 to 64 letters, digits, - or _";

/// A client's right to open sessions. As text it is `ID:SECRET`.
#[derive(Clone)]
pub struct Token {
    id: String,
    secret: [u8; SECRET_BYTES],
}

impl Token {
    /// A new token with this id and a secret from the system's random source. In files, an id must have 1 to 64 letters, digits,
    /// `-` or `_`.
    pub fn generate(id: &str) -> Result<Self, AccessError> {
        Ok(Self { id: id.into(), secret: random()? })
    }

    /// Reads the file that [`Token::write`] made; refuses it if others can read it too.
    pub fn read(path: &Path) -> Result<Self, AccessError> {
        read_secret(path, |text| {
            let (line, text) = only_line(path, text, "token", TOKEN_REMEDY)?;
            text.parse().map_err(|error: FormatError| error.at(path, line))
        })
    }

    /// Writes the token into a new file with mode 0600.
    pub fn write(&self, path: &Path) -> Result<(), AccessError> {
        write_new(path, &format!("{}:{}\n", self.id, HEXLOWER.encode(&self.secret)), 0o600)
    }

    pub fn id(&self) -> &str {
        &self.id
    }

    /// The secret, used as the key of a MAC and never sent.
    pub fn secret(&self) -> &[u8; SECRET_BYTES] {
        &self.secret
    }
}

impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Token").field("id", &self.id).finish_non_exhaustive()
    }
}

impl FromStr for Token {
    type Err = FormatError;

    fn from_str(text: &str) -> Result<Self, FormatError> {
        let parts = text.trim().split_once(':');
        let (id, secret) = parts.ok_or_else(|| FormatError::new("token", "it has no colon", TOKEN_REMEDY))?;
        // A file of another kind has something else there: say what a token is, not only what an id is.
        let id = id_of(id).map_err(|_| FormatError::new("token", "it does not begin with an ID", TOKEN_REMEDY))?;
        Ok(Self { id, secret: secret_of(secret)? })
    }
}

/// The permissions of a token's owner on a server.
#[derive(Clone)]
pub struct Grant {
    token: Token,
    limit: u32,
}

impl Grant {
    /// Allows the owner of the token to have `limit` sessions open at once, at most [`MAX_LIMIT`].
    pub fn new(token: Token, limit: u32) -> Self {
        Self { token, limit }
    }

    pub fn id(&self) -> &str {
        &self.token.id
    }

    pub fn limit(&self) -> u32 {
        self.limit
    }

    pub fn secret(&self) -> &[u8; SECRET_BYTES] {
        &self.token.secret
    }
}

impl fmt::Debug for Grant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Grant").field("id", &self.token.id).field("limit", &self.limit).finish_non_exhaustive()
    }
}

/// The tokens that a server accepts. A line of the file is `ID SECRET LIMIT`.
#[derive(Debug, Clone, Default)]
pub struct Tokens(BTreeMap<String, Grant>);

impl Tokens {
    /// Reads a file of lines `ID SECRET LIMIT`.
    pub fn read(path: &Path) -> Result<Self, AccessError> {
        read_secret(path, |text| {
            let mut grants = BTreeMap::new();
            for (number, line) in lines(text) {
                let grant = grant(line).map_err(|error| error.at(path, number))?;
                let id = grant.id().to_owned();
                if grants.insert(id.clone(), grant).is_some() {
                    let problem = format!("'{id}' is in an earlier line too");
                    return Err(FormatError::new("ID", problem, "give each client an id of its own").at(path, number));
                }
            }
            Ok(Self(grants))
        })
    }

    /// Writes the list into a new file with mode 0600.
    pub fn write(&self, path: &Path) -> Result<(), AccessError> {
        let line = |grant: &Grant| format!("{} {} {}\n", grant.id(), HEXLOWER.encode(grant.secret()), grant.limit);
        let lines: String = self.0.values().map(line).collect();
        write_new(path, &format!("# ID SECRET LIMIT: who may open sessions, and how many at once\n{lines}"), 0o600)
    }

    /// The grant of the token with this id. The caller must check that its owner is asking.
    pub fn of(&self, id: &str) -> Option<&Grant> {
        self.0.get(id)
    }

    /// The grant of this token; `None` if the secret differs. Takes as long for a wrong secret as for the right one.
    pub fn check(&self, token: &Token) -> Option<&Grant> {
        let grant = self.0.get(&token.id)?;
        bool::from(grant.token.secret.ct_eq(&token.secret)).then_some(grant)
    }

    /// All accepted tokens, sorted by id.
    pub fn iter(&self) -> impl Iterator<Item = &Grant> {
        self.0.values()
    }
}

impl FromIterator<Grant> for Tokens {
    fn from_iter<I: IntoIterator<Item = Grant>>(grants: I) -> Self {
        Self(grants.into_iter().map(|grant| (grant.id().to_owned(), grant)).collect())
    }
}

fn grant(line: &str) -> Result<Grant, FormatError> {
    let words: Vec<_> = line.split_whitespace().collect();
    let [id, secret, limit] = words[..] else {
        return Err(FormatError::new("line", format!("it has {} words, not 3", words.len()), GRANT_REMEDY));
    };
    let (id, secret) = (id_of(id)?, secret_of(secret)?);
    let limit = limit.parse().ok().filter(|limit| (1..=MAX_LIMIT).contains(limit));
    let limit = limit.ok_or_else(|| FormatError::new("LIMIT", "it is not a number in its range", LIMIT_REMEDY))?;
    Ok(Grant { token: Token { id, secret }, limit })
}

fn id_of(id: &str) -> Result<String, FormatError> {
    if is_name(id) {
        Ok(id.into())
    } else {
        Err(FormatError::new("ID", "it has the wrong length or characters", ID_REMEDY))
    }
}

fn secret_of(text: &str) -> Result<[u8; SECRET_BYTES], FormatError> {
    let secret = HEXLOWER_PERMISSIVE.decode(text.as_bytes()).ok().and_then(|bytes| bytes.try_into().ok());
    secret.ok_or_else(|| FormatError::new("SECRET", "it is not 64 hexadecimal digits", TOKEN_REMEDY))
}
