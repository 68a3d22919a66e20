use data_encoding::HEXLOWER;
use sha2::{Digest, Sha256};

/// SHA-256 of texts one after another, hexadecimal.
pub(crate) fn sha256_hex(texts: &[&str]) -> String {
    let mut sha = Sha256::new();
    texts.iter().for_each(|text| sha.update(text));
    HEXLOWER.encode(&sha.finalize())
}
