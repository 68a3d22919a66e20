//! Topics of a bag and the schemas of their messages.

use std::sync::OnceLock;

use fiatlux_proto::{DESCRIPTORS, Message};
use prost_types::{FileDescriptorProto, FileDescriptorSet};

/// A `fiatlux.v3.State` for each row.
pub const STATE: &str = "/state";
/// A `fiatlux.v3.Event` for each thing that happened: a criterion, a bulb seated or released, a condition, the end.
pub const EVENT: &str = "/event";
/// `fiatlux.v3.EpisodeResult`, the last message.
pub const RESULT: &str = "/result";
/// `fiatlux.v3.ActionRecord`, from row 1 on; with the chunk that it comes from, where a model server made it.
pub const ACTION: &str = "/action";
/// A `fiatlux.v3.Observation` for each row.
pub const OBSERVATION: &str = "/observation";
/// `fiatlux.v3.Reward`, from row 1 on.
pub const REWARD: &str = "/reward";
/// A `foxglove.FrameTransforms`, which viewers pose the scene with.
pub const TF: &str = "/tf";
/// A `foxglove.SceneUpdate`, which viewers draw the scene from.
pub const SCENE: &str = "/scene";

/// `foxglove.CompressedImage` of the head camera, where the session asked for it.
pub const CAMERA: &str = "/camera";
/// `foxglove.PointCloud` of the LiDAR's hits, where the session asked for it.
pub const LIDAR: &str = "/lidar";

/// Topics and full names of their messages; a topic's channel is its position, from 1.
pub(crate) const TOPICS: [(&str, &str); 10] = [
    (STATE, "fiatlux.v3.State"),
    (EVENT, "fiatlux.v3.Event"),
    (RESULT, "fiatlux.v3.EpisodeResult"),
    (ACTION, "fiatlux.v3.ActionRecord"),
    (OBSERVATION, "fiatlux.v3.Observation"),
    (REWARD, "fiatlux.v3.Reward"),
    (TF, "foxglove.FrameTransforms"),
    (SCENE, "foxglove.SceneUpdate"),
    (CAMERA, "foxglove.CompressedImage"),
    (LIDAR, "foxglove.PointCloud"),
];

pub(crate) fn is_graded(topic: &str) -> bool {
    [STATE, EVENT, RESULT].contains(&topic)
}

pub(crate) fn channel(topic: &str) -> Option<u16> {
    TOPICS.iter().position(|(name, _)| *name == topic).map(|index| index as u16 + 1)
}

/// A `FileDescriptorSet` with the file of a message and all that it imports, imports first.
pub(crate) fn schema(message: &str) -> Vec<u8> {
    static FILES: OnceLock<Vec<FileDescriptorProto>> = OnceLock::new();
    // Our own constant: it decodes.
    let files = FILES.get_or_init(|| FileDescriptorSet::decode(DESCRIPTORS).unwrap_or_default().file);
    let mut set = FileDescriptorSet::default();
    let (package, name) = message.rsplit_once('.').unwrap_or_default();
    let has =
        |file: &&FileDescriptorProto| file.package() == package && file.message_type.iter().any(|m| m.name() == name);
    if let Some(file) = files.iter().find(has) {
        add(file, files, &mut set.file);
    }
    set.encode_to_vec()
}

fn add(file: &FileDescriptorProto, files: &[FileDescriptorProto], set: &mut Vec<FileDescriptorProto>) {
    if set.iter().any(|known| known.name == file.name) {
        return;
    }
    for import in &file.dependency {
        if let Some(imported) = files.iter().find(|other| other.name() == import) {
            add(imported, files, set);
        }
    }
    // Comments are not part of a schema.
    set.push(FileDescriptorProto { source_code_info: None, ..file.clone() });
}

#[cfg(test)]
mod tests {
    use super::*;

    fn files(message: &str) -> Vec<String> {
        let set = FileDescriptorSet::decode(schema(message).as_slice()).expect("a schema decodes");
        set.file.into_iter().map(|file| file.name.unwrap_or_default()).collect()
    }

    #[test]
    fn schemas_carry_their_imports_and_no_more() {
        let ours = ["observation", "room", "session", "truth"].map(|file| format!("fiatlux/v3/{file}.proto"));
        assert_eq!(files("fiatlux.v3.State"), ours);
        assert_eq!(files("fiatlux.v3.Observation"), ours[..1]);
        let frames = ["google/protobuf/timestamp.proto", "foxglove/geometry.proto", "foxglove/frames.proto"];
        assert_eq!(files("foxglove.FrameTransforms"), frames);
        for (topic, message) in TOPICS {
            assert!(!files(message).is_empty(), "{topic}");
        }
    }
}
