//! Compiles the messages, without protoc.

use std::path::PathBuf;

fn main() {
    println!("cargo::rerun-if-changed=proto");
    let files = ["fiatlux/v1/session.proto", "fiatlux/v1/truth.proto", "foxglove/frames.proto", "foxglove/scene.proto"];
    let set = protox::compile(files, ["proto"]).expect("the message files compile");
    let out = PathBuf::from(std::env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    let bytes = protox::prost::Message::encode_to_vec(&set);
    std::fs::write(out.join("descriptors.bin"), bytes).expect("OUT_DIR can be written");
    prost_build::Config::new()
        .btree_map(["."])
        .enable_type_names()
        .type_attribute(
            ".fiatlux.v1.EpisodeHeader",
            "#[derive(serde::Serialize, serde::Deserialize)]\n#[serde(default)]",
        )
        .type_attribute(
            ".fiatlux.v1.EpisodeResult",
            "#[derive(serde::Serialize, serde::Deserialize)]\n#[serde(default)]",
        )
        .type_attribute(".fiatlux.v1.EpisodeEnd", "#[derive(serde::Serialize, serde::Deserialize)]\n#[serde(default)]")
        .type_attribute(".fiatlux.v1.Version", "#[derive(serde::Serialize, serde::Deserialize)]\n#[serde(default)]")
        .compile_fds(set)
        .expect("the messages generate");
}
