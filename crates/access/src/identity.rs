//! The identity of a server: an Ed25519 key pair that stays the same when its process, port or machine changes.

use std::fmt;
use std::path::Path;
use std::str::FromStr;

use ring::signature::{ED25519, Ed25519KeyPair, KeyPair as _, UnparsedPublicKey};

use crate::file::{self, read_secret, write_new};
use crate::{AccessError, FormatError, random};

pub const SIGNATURE_BYTES: usize = 64;

const SECRET_PREFIX: &str = "fiatlux-identity";
const SECRET_REMEDY: &str = "an identity is one line, fiatlux-identity:BASE64 of 32 bytes, as `fiatlux keys` writes it";
const PUBLIC_PREFIX: &str = "ed25519";
const PUBLIC_REMEDY: &str = "a public key is ed25519:BASE64 of 32 bytes, as the server prints it";

/// A server's key pair. Whoever has it can impersonate the server.
pub struct Identity {
    seed: [u8; 32],
    pair: Ed25519KeyPair,
}

impl Identity {
    /// A new key pair from the system's random source.
    pub fn generate() -> Result<Self, AccessError> {
        // Every seed of the right length gives a key pair, so this loops once.
        loop {
            if let Some(identity) = Self::from_seed(random()?) {
                return Ok(identity);
            }
        }
    }

    /// Reads the file that [`Identity::write`] made; refuses it if others can read it too.
    pub fn read(path: &Path) -> Result<Self, AccessError> {
        read_secret(path, |text| {
            let (line, text) = file::only_line(path, text, "identity", SECRET_REMEDY)?;
            let seed =
                file::decode(text, SECRET_PREFIX, "identity", SECRET_REMEDY).map_err(|error| error.at(path, line))?;
            let refused = || FormatError::new("identity", "it gives no key pair", SECRET_REMEDY).at(path, line);
            Self::from_seed(seed).ok_or_else(refused)
        })
    }

    /// Writes the key pair into a new file with mode 0600.
    pub fn write(&self, path: &Path) -> Result<(), AccessError> {
        write_new(path, &(file::encode(SECRET_PREFIX, &self.seed) + "\n"), 0o600)
    }

    /// The public half, which everybody may know.
    pub fn public(&self) -> PublicKey {
        let mut key = [0; 32];
        key.copy_from_slice(self.pair.public_key().as_ref());
        PublicKey(key)
    }

    /// Signs a message. The caller must make sure that no two kinds of messages can have the same bytes.
    pub fn sign(&self, message: &[u8]) -> [u8; SIGNATURE_BYTES] {
        let mut signature = [0; SIGNATURE_BYTES];
        signature.copy_from_slice(self.pair.sign(message).as_ref());
        signature
    }

    pub(crate) fn from_seed(seed: [u8; 32]) -> Option<Self> {
        Ed25519KeyPair::from_seed_unchecked(&seed).ok().map(|pair| Self { seed, pair })
    }
}

impl fmt::Debug for Identity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Identity").field(&self.public()).finish()
    }
}

/// The key that checks a server's signatures. As text it is one line, `ed25519:BASE64`, that can be pasted.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct PublicKey([u8; 32]);

impl PublicKey {
    pub fn from_bytes(bytes: [u8; 32]) -> Self {
        Self(bytes)
    }

    /// The 32 bytes of the key, as in a message.
    pub fn as_bytes(&self) -> &[u8; 32] {
        &self.0
    }

    /// True if the owner of this key signed the message; false also if the bytes are not a valid key.
    #[must_use]
    pub fn verify(&self, message: &[u8], signature: &[u8]) -> bool {
        UnparsedPublicKey::new(&ED25519, self.0).verify(message, signature).is_ok()
    }
}

impl fmt::Display for PublicKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&file::encode(PUBLIC_PREFIX, &self.0))
    }
}

impl fmt::Debug for PublicKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Display::fmt(self, f)
    }
}

impl FromStr for PublicKey {
    type Err = FormatError;

    fn from_str(text: &str) -> Result<Self, FormatError> {
        file::decode(text.trim(), PUBLIC_PREFIX, "public key", PUBLIC_REMEDY).map(Self)
    }
}
