//! The files of the controllers: names, sources, and the digests that a user can demand.

use std::path::{Path, PathBuf};

use crate::{ForeignError, Model, ModelFile};

/// Networks of GEAR's decoupled controller: one for standing, one for walking.
pub const GEAR_FILES: [ModelFile; 2] = [
    ModelFile {
        names: &["Balance.onnx", "GR00T-WholeBodyControl-Balance.onnx"],
        inputs: 516,
        outputs: 15,
        source: GEAR_SOURCE,
    },
    ModelFile {
        names: &["Walk.onnx", "GR00T-WholeBodyControl-Walk.onnx"],
        inputs: 516,
        outputs: 15,
        source: GEAR_SOURCE,
    },
];

pub const DECODER: ModelFile = ModelFile {
    names: &["model_decoder.onnx", "decoder.onnx"],
    inputs: 994,
    outputs: 29,
    source: "huggingface.co/nvidia/GEAR-SONIC (model_decoder.onnx)",
};

/// Largest list of digests, bytes.
const MAX_LIST_BYTES: u64 = 1 << 20;
/// Optional list of digests in a folder, in the form of `sha256sum`. A file in the list must have the digest given
/// there.
pub const SHA256_LIST: &str = "SHA256SUMS";

const GEAR_SOURCE: &str = "github.com/NVlabs/GR00T-WholeBodyControl (folder decoupled_wbc, Git LFS) or \
                           huggingface.co/nepyope/GR00T-WholeBodyControl_g1";

impl ModelFile {
    /// Reads and checks the network in a folder.
    pub fn read(&self, folder: &Path) -> Result<Model, ForeignError> {
        let candidates: Vec<PathBuf> = self.names.iter().map(|name| folder.join(name)).collect();
        let path = candidates.iter().find(|path| path.exists()).unwrap_or(&candidates[0]);
        let digest = digest_of(folder, path)?;
        Model::read(path, self, digest.as_deref())
    }
}

/// The digest that the folder's list gives for a file; `None` if there is no list or no such line.
fn digest_of(folder: &Path, file: &Path) -> Result<Option<String>, ForeignError> {
    let path = folder.join(SHA256_LIST);
    let text = match fiatlux_files::read_text(&path, MAX_LIST_BYTES) {
        Ok(text) => text,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(source) => return Err(ForeignError::Read { path, source }),
    };
    for (index, line) in text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty()) {
        let wrong = || ForeignError::DigestList { path: path.clone(), line: index + 1 };
        let (digest, name) = line.trim().split_once(char::is_whitespace).ok_or_else(wrong)?;
        if digest.len() != 64 || !digest.chars().all(|digit| digit.is_ascii_hexdigit()) {
            return Err(wrong());
        }
        let name = name.trim_start().trim_start_matches('*').trim_start_matches("./");
        if file.file_name().is_some_and(|own| own == name) {
            return Ok(Some(digest.to_ascii_lowercase()));
        }
    }
    Ok(None)
}
