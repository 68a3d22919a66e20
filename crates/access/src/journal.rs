//! The signature under the journal of a run, which shows which server wrote it.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;

use crate::{Identity, PublicKey, Signer, hash};

/// No other message that an identity signs begins with this.
const CONTEXT: &[u8] = b"fiatlux run journal\0";

/// Signs the link of a journal's last line, which stands for all of it. Base64.
pub fn sign_journal(identity: &Identity, link: &str) -> String {
    STANDARD.encode(identity.sign(&signed(link)))
}

/// The signer of the link of a journal's last line. The caller decides whether to trust that key.
pub fn journal_signer(link: &str, key: &str, signature: &str) -> Signer {
    let (Ok(key), Ok(signature)) = (key.parse::<PublicKey>(), STANDARD.decode(signature)) else {
        return Signer::Mismatch;
    };
    if key.verify(&signed(link), &signature) { Signer::Key(key) } else { Signer::Mismatch }
}

fn signed(link: &str) -> Vec<u8> {
    [CONTEXT, hash(&[link.as_bytes()]).as_ref()].concat()
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    #[test]
    fn a_signature_is_of_one_journal() {
        let [own, other] = [(); 2].map(|()| Identity::generate().unwrap());
        let key = own.public().to_string();
        let signature = sign_journal(&own, "ab");
        assert_eq!(journal_signer("ab", &key, &signature), Signer::Key(own.public()));
        let forged = sign_journal(&other, "ab");
        for (link, signature) in [("ac", &*signature), ("ab", &forged), ("ab", ""), ("ab", "?")] {
            assert_eq!(journal_signer(link, &key, signature), Signer::Mismatch, "{link} {signature}");
        }
        assert_eq!(journal_signer("ab", "ed25519:", &signature), Signer::Mismatch);
    }
}
