//! Reads the fields of an MCAP record from its bytes: each call takes one from the front, or none where it is cut.

use std::collections::BTreeMap;

pub(crate) fn take<const N: usize>(bytes: &mut &[u8]) -> Option<[u8; N]> {
    let (first, rest) = bytes.split_first_chunk::<N>()?;
    *bytes = rest;
    Some(*first)
}

pub(crate) fn take_u16(bytes: &mut &[u8]) -> Option<u16> {
    take(bytes).map(u16::from_le_bytes)
}

pub(crate) fn take_u64(bytes: &mut &[u8]) -> Option<u64> {
    take(bytes).map(u64::from_le_bytes)
}

/// Bytes with a length prefix.
pub(crate) fn take_bytes<'a>(bytes: &mut &'a [u8]) -> Option<&'a [u8]> {
    let length = u32::from_le_bytes(take(bytes)?);
    let (taken, rest) = bytes.split_at_checked(length as usize)?;
    *bytes = rest;
    Some(taken)
}

pub(crate) fn take_text(bytes: &mut &[u8]) -> Option<String> {
    String::from_utf8(take_bytes(bytes)?.to_vec()).ok()
}

pub(crate) fn take_map(bytes: &mut &[u8]) -> Option<BTreeMap<String, String>> {
    let mut entries = take_bytes(bytes)?;
    let mut map = BTreeMap::new();
    while !entries.is_empty() {
        let (name, value) = (take_text(&mut entries)?, take_text(&mut entries)?);
        map.insert(name, value);
    }
    Some(map)
}
