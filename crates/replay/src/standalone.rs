//! A replay as a single self-contained file.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

use crate::Replay;
use crate::packed::small;
use crate::page::file;

/// The page with all its data. It opens from a disk, without a server, and its policy forbids loading anything from any
/// host. Its data are compressed: an episode of 120 s without pictures makes a file of about 2 MB, and each picture adds 4/3 of its bytes.
pub fn standalone(replay: &Replay) -> String {
    let mut data = String::new();
    // First the first bytes of all numbers, then the second ones: gzip makes them smaller.
    let planes = (0..4).flat_map(|byte| replay.meshes().iter().skip(byte).step_by(4));
    let shapes: Vec<u8> = planes.copied().collect();
    for (name, bytes) in [
        ("document.json", replay.document_json().as_bytes()),
        ("meshes.bin", &shapes[..]),
        ("track.bin", replay.track()),
        ("joints.bin", replay.joints()),
        ("pictures.bin", replay.pictures()),
    ] {
        data.push_str(&format!("<script type=\"application/octet-stream\" id=\"block-{name}\">"));
        STANDARD.encode_string(small(bytes), &mut data);
        data.push_str("</script>\n");
    }
    file(&data)
}
