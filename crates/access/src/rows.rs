//! Encrypts records on their way to a recorder: policies share the network, and must not see them.

use data_encoding::HEXLOWER;
use ring::aead::{Aad, LessSafeKey, NONCE_LEN, Nonce};
use ring::hkdf::{HKDF_SHA256, Prk, Salt};
use ring::hmac;
use subtle::ConstantTimeEq as _;

use crate::channel::shortened;
use crate::handshake::{expand_aead, expand_mac};
use crate::{HandshakeError, MAC_BYTES, RecorderKey, Secrets};

/// First bytes of a nonce, which no other use of the key has.
const RECORD: u32 = 1;

const SEQ_BYTES: usize = 8;

/// The number under which a record was sealed, as it says itself; `None` if it is too short for a sealed record.
#[must_use]
pub fn sealed_seq(sealed: &[u8]) -> Option<u64> {
    let (seq, _) = sealed.split_first_chunk::<SEQ_BYTES>()?;
    (sealed.len() >= SEQ_BYTES + MAC_BYTES).then(|| u64::from_le_bytes(*seq))
}

/// Encrypts the records of one session, and proves who asks for them.
pub struct RowsKey {
    seals: LessSafeKey,
    proves: hmac::Key,
}

impl RowsKey {
    /// The key of a session that a recorder with this key records.
    pub fn of_recorder(key: &RecorderKey, server: &str, session: &str) -> Result<Self, HandshakeError> {
        let salt = Salt::new(HKDF_SHA256, format!("fiatlux records 3.4\0{server}\0{session}").as_bytes());
        Self::of(&salt.extract(key.as_bytes()))
    }

    /// The key of a session whose records its opener reads.
    pub fn of_opener(secrets: &Secrets) -> Result<Self, HandshakeError> {
        Self::of(secrets.prk())
    }

    fn of(secret: &Prk) -> Result<Self, HandshakeError> {
        Ok(Self { seals: expand_aead(secret, b"records")?, proves: expand_mac(secret, b"recorder to server")? })
    }

    /// Encrypts a record; no other record of the session may have the same number. Returns the number, the ciphertext and a
    /// tag of 16 bytes.
    pub fn seal(&self, seq: u64, record: &[u8]) -> Vec<u8> {
        let mut sealed = Vec::with_capacity(SEQ_BYTES + record.len() + MAC_BYTES);
        sealed.extend(seq.to_le_bytes());
        sealed.extend(record);
        let tag = self.seals.seal_in_place_separate_tag(nonce(seq), Aad::empty(), &mut sealed[SEQ_BYTES..]);
        // This fails only for a record of 256 GiB; the receiver refuses what is sent then.
        sealed.extend(tag.iter().flat_map(|tag| tag.as_ref()));
        sealed
    }

    /// Decrypts a record; `None` if it was not sealed with this key.
    pub fn open(&self, sealed: &[u8]) -> Option<Vec<u8>> {
        let (seq, sealed) = sealed.split_first_chunk::<SEQ_BYTES>()?;
        let mut record = sealed.to_vec();
        let length = self.seals.open_in_place(nonce(u64::from_le_bytes(*seq)), Aad::empty(), &mut record).ok()?.len();
        record.truncate(length);
        Some(record)
    }

    /// Proves to a recorder that a session is one of a server with its key: the end of the session's token.
    pub fn token(&self) -> String {
        HEXLOWER.encode(&self.prove("live", b""))
    }

    /// True if a token is from a server with this key.
    #[must_use]
    pub fn is_token(&self, proof: &str) -> bool {
        bool::from(self.token().as_bytes().ct_eq(proof.as_bytes()))
    }

    /// The attachment of a recorder's message; `label` is the end of the Zenoh key it is sent on.
    pub fn prove(&self, label: &str, payload: &[u8]) -> [u8; MAC_BYTES] {
        let mut context = hmac::Context::with_key(&self.proves);
        context.update(label.as_bytes());
        context.update(&[0]);
        context.update(payload);
        shortened(&context.sign())
    }

    /// True if a recorder with this key sent the message.
    #[must_use]
    pub fn is_proved(&self, label: &str, payload: &[u8], attachment: &[u8]) -> bool {
        bool::from(self.prove(label, payload)[..].ct_eq(attachment))
    }
}

impl std::fmt::Debug for RowsKey {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("RowsKey(..)")
    }
}

fn nonce(seq: u64) -> Nonce {
    let mut nonce = [0; NONCE_LEN];
    nonce[..4].copy_from_slice(&RECORD.to_le_bytes());
    nonce[4..].copy_from_slice(&seq.to_le_bytes());
    Nonce::assume_unique_for_key(nonce)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn a_record_is_read_with_its_sessions_key_alone() {
        let recorder = RecorderKey::generate().unwrap();
        let key = |server, session| RowsKey::of_recorder(&recorder, server, session).unwrap();
        let sealed = key("lab", "7").seal(3, b"a record");
        assert!(!sealed.windows(8).any(|part| part == b"a record"));
        assert_eq!(key("lab", "7").open(&sealed).as_deref(), Some(&b"a record"[..]));
        assert_eq!(key("lab", "8").open(&sealed), None);
        assert_eq!(key("la", "b7").open(&sealed), None);
        let other = RowsKey::of_recorder(&RecorderKey::generate().unwrap(), "lab", "7").unwrap();
        assert_eq!(other.open(&sealed), None);
        for bit in 0..8 * sealed.len() {
            let mut changed = sealed.clone();
            changed[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(key("lab", "7").open(&changed), None, "bit {bit}");
        }
        for length in 0..sealed.len() {
            assert_eq!(key("lab", "7").open(&sealed[..length]), None);
        }
        assert_eq!(key("lab", "7").open(&key("lab", "7").seal(0, b"")), Some(Vec::new()));
    }

    #[test]
    fn what_a_recorder_says_is_proved() {
        let key = RowsKey::of_opener(&Secrets::of_test(1)).unwrap();
        let proof = key.prove("ack", b"9");
        assert!(key.is_proved("ack", b"9", &proof));
        assert!(!key.is_proved("rows", b"9", &proof) && !key.is_proved("ack", b"8", &proof));
        assert!(key.is_token(&key.token()) && !key.is_token("") && !key.is_token(&key.token()[1..]));
        assert!(!key.is_proved("ack", b"9", &[]) && !key.is_proved("ack", b"9", &proof[..15]));
    }
}
