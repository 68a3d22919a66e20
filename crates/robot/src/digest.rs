use data_encoding::HEXLOWER;
use sha2::{Digest, Sha256};

/// The part of a robot file that its digest covers: all but the table of joint groups, which must be the last one.
pub(crate) fn digested(text: &str) -> &str {
    text.find(JOINT_GROUPS).map_or(text, |end| &text[..end])
}

/// The line where that table begins, after an empty one.
const JOINT_GROUPS: &str = "\n[joint_groups]\n";

/// SHA-256 of texts one after another, hexadecimal.
pub(crate) fn sha256_hex(texts: &[&str]) -> String {
    let mut sha = Sha256::new();
    texts.iter().for_each(|text| sha.update(text));
    HEXLOWER.encode(&sha.finalize())
}
