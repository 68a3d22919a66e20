//! The secret that a server and its recorders share.

use std::fmt;
use std::path::Path;

use ring::hmac;

use crate::file::{self, read_secret, write_new};
use crate::{AccessError, random};

const PREFIX: &str = "fiatlux-recorder";
const REMEDY: &str = "a recorder key is one line, fiatlux-recorder:BASE64 of 32 bytes, as `fiatlux keys` writes it";

/// The key that allows a recorder to read rows and acknowledge them.
#[derive(Clone)]
pub struct RecorderKey([u8; 32]);

impl RecorderKey {
    /// A new key from the system's random source.
    pub fn generate() -> Result<Self, AccessError> {
        random().map(Self)
    }

    /// Reads the file that [`RecorderKey::write`] made; refuses it if others can read it too.
    pub fn read(path: &Path) -> Result<Self, AccessError> {
        read_secret(path, |text| {
            let (line, text) = file::only_line(path, text, "recorder key", REMEDY)?;
            file::decode(text, PREFIX, "recorder key", REMEDY).map(Self).map_err(|error| error.at(path, line))
        })
    }

    /// Writes the key into a new file with mode 0600.
    pub fn write(&self, path: &Path) -> Result<(), AccessError> {
        write_new(path, &(file::encode(PREFIX, &self.0) + "\n"), 0o600)
    }

    /// Number `count` that follows from the key and a text, uniform in 64 bits: the same for everybody who has the key, and unknown to
    /// all others.
    pub fn number(&self, of: &[u8], count: u64) -> u64 {
        let mut context = hmac::Context::with_key(&hmac::Key::new(hmac::HMAC_SHA256, &self.0));
        context.update(b"fiatlux number\0");
        context.update(&count.to_be_bytes());
        context.update(of);
        let tag = context.sign();
        tag.as_ref().iter().take(8).fold(0, |number, byte| number << 8 | u64::from(*byte))
    }

    /// The secret itself, as the key of a MAC. It is never sent.
    pub fn as_bytes(&self) -> &[u8; 32] {
        &self.0
    }
}

impl fmt::Debug for RecorderKey {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("RecorderKey(..)")
    }
}
