//! Networks for the features of the camera's image, built once and shared by the sessions that use them.

use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use fiatlux_cli::in_full;
use fiatlux_features::{Arithmetic, ResNet18, Weights};
use fiatlux_proto::v3::Refusal;
use fiatlux_proto::v3::refusal::Code;

use super::lock;

/// Number of networks to keep; each takes 95 MB.
const KEPT: usize = 3;
/// Seed of the weights for sessions that name no file.
const SEED: u64 = 0;

/// Builds networks from the files of one folder, or from the seed.
pub(super) struct Networks {
    folder: Option<PathBuf>,
    /// Networks by the name of the file (empty for the seed), last used at the end.
    kept: Mutex<VecDeque<(String, ResNet18)>>,
}

impl Networks {
    pub fn new(folder: Option<PathBuf>) -> Self {
        Self { folder, kept: Mutex::default() }
    }

    /// A network with the weights of a file, or with seeded weights if the name is empty; in whole numbers where the name ends with
    /// `+int8`, or is `int8`.
    pub fn get(&self, file: &str) -> Result<ResNet18, Refusal> {
        if let Some(twin) = self.find(file) {
            return Ok(twin);
        }
        // Two sessions may build the same one at once; that only costs time.
        let (own, arithmetic) = Arithmetic::of_name(file);
        let network = ResNet18::with(&self.weights(own)?, arithmetic);
        let twin = network.twin();
        let mut kept = lock(&self.kept);
        if kept.len() >= KEPT {
            kept.pop_front();
        }
        kept.push_back((file.to_owned(), network));
        Ok(twin)
    }

    fn find(&self, file: &str) -> Option<ResNet18> {
        let mut kept = lock(&self.kept);
        let found = kept.iter().position(|(name, _)| name == file)?;
        let entry = kept.remove(found)?;
        let twin = entry.1.twin();
        kept.push_back(entry);
        Some(twin)
    }

    fn weights(&self, file: &str) -> Result<Weights, Refusal> {
        if file.is_empty() {
            return Ok(Weights::seeded(SEED));
        }
        let wrong = |message: String| Refusal::new(Code::Value, "weights", message);
        let Some(folder) = &self.folder else {
            return Err(wrong(format!(
                "'{file}' cannot be read: this server has no folder of weights; start it with --weights DIR, or leave \
                 weights empty"
            )));
        };
        // A client can only name a file of that folder.
        if Path::new(file).file_name().is_none_or(|name| name != file) {
            return Err(wrong(format!("'{file}' is not the name of a file; give one without a folder")));
        }
        Weights::from_safetensors(folder.join(file)).map_err(|error| wrong(in_full(&error)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn networks_are_made_once_and_say_what_they_are() {
        let networks = Networks::new(None);
        let label = networks.get("").expect("seeded").label().to_owned();
        assert!(label.ends_with(":0"), "{label}");
        assert_eq!(networks.get("").expect("seeded").label(), label);
        assert_eq!(lock(&networks.kept).len(), 1);
    }

    /// A client reaches no file outside the folder, and learns what is wrong with one inside.
    #[test]
    fn refusals_name_the_file() {
        let folder = std::env::temp_dir().join(format!("fiatlux-weights-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("a folder");
        std::fs::write(folder.join("wrong"), b"no weights").expect("a file");
        let networks = Networks::new(Some(folder.clone()));
        let refused = |networks: &Networks, file| {
            let refusal = networks.get(file).expect_err(file);
            assert_eq!((refusal.code(), refusal.field.as_str()), (Code::Value, "weights"));
            refusal.message
        };
        for outside in ["../wrong", "/etc/passwd", "a/b", "..", "wrong/"] {
            assert!(refused(&networks, outside).contains("is not the name of a file"), "{outside}");
        }
        assert!(refused(&networks, "missing").contains("missing"));
        assert!(refused(&networks, "wrong").contains("not a safetensors file"));
        assert!(refused(&Networks::new(None), "wrong").contains("--weights DIR"));
        std::fs::remove_dir_all(folder).expect("removed");
    }
}
