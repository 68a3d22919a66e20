use sha2::{Digest, Sha256};

/// SHA-256 of texts one after another, hexadecimal.
pub(crate) fn sha256_hex(texts: &[&str]) -> String {
    let mut sha = Sha256::new();
    texts.iter().for_each(|text| sha.update(text));
    sha.finalize().iter().map(|byte| format!("{byte:02x}")).collect()
}
