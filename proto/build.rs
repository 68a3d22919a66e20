//! Compiles the messages, without protoc.

use std::path::PathBuf;

/// Messages that a bag's metadata has as JSON: header, result, and what is in them.
const IN_METADATA: [&str; 28] = [
    "EpisodeHeader",
    "Asset",
    "OpenRequest",
    "Hello",
    "RunSpec",
    "RunTicket",
    "EpisodeResult",
    "Signature",
    "EpisodeEnd",
    "Judgement",
    "Version",
    "Sensor",
    "Randomization",
    "PropScale",
    "Range",
    "DomainSample",
    "Layout",
    "Place",
    "Pose",
    "HandFriction",
    "Light",
    "StartNoise",
    "SceneGeometry",
    "BulbGeometry",
    "JointDrive",
    "JointGroups",
    "ContactMeasure",
    "SeedRange",
];

fn main() {
    println!("cargo::rerun-if-changed=proto");
    let files = [
        "fiatlux/v3/run.proto",
        "fiatlux/v3/session.proto",
        "fiatlux/v3/truth.proto",
        "foxglove/frames.proto",
        "foxglove/scene.proto",
        "foxglove/sensors.proto",
    ];
    let set = protox::compile(files, ["proto"]).expect("the message files compile");
    let out = PathBuf::from(std::env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    let bytes = protox::prost::Message::encode_to_vec(&set);
    std::fs::write(out.join("descriptors.bin"), bytes).expect("OUT_DIR can be written");
    let mut config = prost_build::Config::new();
    // Maps in order: the same message gives the same bytes.
    config.btree_map(["."]).enable_type_names();
    for message in IN_METADATA {
        let attribute = "#[derive(serde::Serialize, serde::Deserialize)]\n#[serde(default)]";
        config.type_attribute(format!(".fiatlux.v3.{message}"), attribute);
    }
    config.compile_fds(set).expect("the messages generate");
}
