//! The signature of an episode's result, which shows which server vouches for it.

use fiatlux_proto::Message;
use fiatlux_proto::v3::{EpisodeResult, Signature};

use crate::{Identity, PublicKey, hash};

/// Prefix of the signed bytes; no other message that an identity signs begins with it.
const CONTEXT: &[u8] = b"fiatlux episode result\0";

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Signer {
    Nobody,
    /// The owner of this key signed exactly this result.
    Key(PublicKey),
    /// The signature does not fit the result: one of the two was changed, or copied from another bag.
    Mismatch,
}

impl Signer {
    /// The key of a valid signature; `None` otherwise.
    pub fn key(self) -> Option<PublicKey> {
        match self {
            Self::Key(key) => Some(key),
            Self::Nobody | Self::Mismatch => None,
        }
    }
}

/// Signs the result in its present form, and replaces an earlier signature.
pub fn sign_result(identity: &Identity, result: &mut EpisodeResult) {
    let signature = identity.sign(&signed(result)).to_vec();
    result.signature = Some(Signature { key: identity.public().as_bytes().to_vec(), signature });
}

/// The signer of a result. The caller decides whether to trust that key.
pub fn signer_of(result: &EpisodeResult) -> Signer {
    let Some(Signature { key, signature }) = &result.signature else { return Signer::Nobody };
    let Ok(key) = <[u8; 32]>::try_from(key.as_slice()).map(PublicKey::from_bytes) else { return Signer::Mismatch };
    if key.verify(&signed(result), signature) { Signer::Key(key) } else { Signer::Mismatch }
}

fn signed(result: &EpisodeResult) -> Vec<u8> {
    let bare = EpisodeResult { signature: None, ..result.clone() };
    [CONTEXT, hash(&[&bare.encode_to_vec()]).as_ref()].concat()
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use fiatlux_proto::v3::EpisodeEnd;

    use super::*;

    /// Guards that a signature is valid only for one result, to the last bit of either.
    #[test]
    fn a_signature_fits_what_was_signed_and_nothing_else() {
        let identity = Identity::generate().unwrap();
        let end = EpisodeEnd { steps: 6000, digest: "ab".into(), ..EpisodeEnd::default() };
        let mut result = EpisodeResult { end: Some(end), header_digest: "cd".into(), ..EpisodeResult::default() };
        assert_eq!(signer_of(&result), Signer::Nobody);
        sign_result(&identity, &mut result);
        assert_eq!(signer_of(&result), Signer::Key(identity.public()));
        let copied = EpisodeResult { header_digest: "ce".into(), ..result.clone() };
        assert_eq!(signer_of(&copied), Signer::Mismatch);
        let least = EpisodeResult { total_reward: f64::from_bits(1), ..result.clone() };
        assert_eq!(signer_of(&least), Signer::Mismatch, "the last bit of a number counts");
        for bit in 0..96 * 8 {
            let mut changed = result.clone();
            let Some(signature) = &mut changed.signature else { panic!("it is signed") };
            let bytes = if bit < 256 { &mut signature.key } else { &mut signature.signature };
            bytes[bit % 256 / 8] ^= 1 << (bit % 8);
            assert_eq!(signer_of(&changed), Signer::Mismatch, "bit {bit}");
        }
        for (key, signature) in [(0, 64), (31, 64), (33, 64), (32, 0), (32, 63), (32, 65)] {
            let signature = Some(Signature { key: vec![7; key], signature: vec![7; signature] });
            assert_eq!(signer_of(&EpisodeResult { signature, ..result.clone() }), Signer::Mismatch);
        }
        sign_result(&Identity::generate().unwrap(), &mut result);
        assert_ne!(signer_of(&result), Signer::Key(identity.public()));
    }
}
