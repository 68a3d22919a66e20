//! An ONNX network with one input and one output, loaded and checked.

use std::path::Path;
use std::sync::Arc;

use data_encoding::HEXLOWER;
use sha2::{Digest, Sha256};

use crate::ForeignError;
use crate::onnx::{Network, Refusal};

/// Maximum size of a file: three times the size of GEAR-SONIC's decoder.
const FILE_LIMIT: u64 = 128 << 20;
/// First bytes of a file that Git LFS did not fetch.
const LFS_POINTER: &[u8] = b"version https://git-lfs";

/// A file of a controller and the network that it must hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ModelFile {
    /// Accepted file names; the first that exists is read.
    pub names: &'static [&'static str],
    pub inputs: usize,
    pub outputs: usize,
    /// The page where its makers publish the file.
    pub source: &'static str,
}

/// A network that was run once on zeros and gave finite numbers. Any number of runners can share it.
#[derive(Debug, Clone)]
pub struct Model {
    network: Arc<Network>,
    file: ModelFile,
    digest: String,
}

impl Model {
    /// Reads a network; if `digest` (64 lower-case hexadecimal digits) is given, the file's SHA-256 must equal it.
    ///
    /// # Errors
    /// [`ForeignError`], with the path: missing (the message names the source), too large, another digest, not ONNX,
    /// weights in another file, another shape, or numbers that are not finite.
    pub fn read(path: &Path, file: &ModelFile, digest: Option<&str>) -> Result<Self, ForeignError> {
        let unreadable = |source: std::io::Error| match source.kind() {
            std::io::ErrorKind::NotFound => ForeignError::Missing { path: path.into(), source_of: file.source },
            std::io::ErrorKind::FileTooLarge => ForeignError::FileSize { path: path.into(), most: FILE_LIMIT },
            _ => ForeignError::Read { path: path.into(), source },
        };
        let bytes = fiatlux_files::read(path, FILE_LIMIT).map_err(unreadable)?;
        if bytes.starts_with(LFS_POINTER) {
            return Err(ForeignError::Pointer { path: path.into() });
        }
        let model = Self::from_bytes(&bytes, path, file)?;
        match digest.filter(|expected| *expected != model.digest) {
            None => Ok(model),
            Some(expected) => {
                Err(ForeignError::Digest { path: path.into(), found: model.digest, expected: expected.into() })
            }
        }
    }

    /// Loads a network from memory; errors call it `path`.
    pub fn from_bytes(bytes: &[u8], path: &Path, file: &ModelFile) -> Result<Self, ForeignError> {
        let network = Network::load(bytes, file.inputs, file.outputs).map_err(|refusal| match refusal {
            Refusal::Problem(problem) => ForeignError::Onnx { path: path.into(), problem },
            Refusal::NotFinite { tensor, index } => ForeignError::Weights { path: path.into(), tensor, index },
            Refusal::Shape { side, found } => {
                let width = if side == "input" { file.inputs } else { file.outputs };
                ForeignError::Shape { path: path.into(), side, expected: format!("f32 [1, {width}]"), found }
            }
        })?;
        let digest = HEXLOWER.encode(&Sha256::digest(bytes));
        let model = Self { network: Arc::new(network), file: *file, digest };
        let ran = model.runner().run(&vec![0.0; file.inputs], &mut vec![0.0; file.outputs]);
        ran.map_err(|problem| ForeignError::Onnx { path: path.into(), problem })?;
        Ok(model)
    }

    /// SHA-256 of the file, hexadecimal.
    pub fn digest(&self) -> &str {
        &self.digest
    }

    pub fn inputs(&self) -> usize {
        self.file.inputs
    }

    pub fn outputs(&self) -> usize {
        self.file.outputs
    }

    pub(crate) fn runner(&self) -> Runner {
        Runner { arena: self.network.arena(), network: self.network.clone() }
    }
}

/// Runs a network, with the memory for it.
#[derive(Debug)]
pub(crate) struct Runner {
    network: Arc<Network>,
    arena: Vec<f32>,
}

impl Runner {
    /// Runs the network once, without allocation.
    ///
    /// # Errors
    /// A number of the output is not finite; `output` is unchanged then.
    pub fn run(&mut self, input: &[f32], output: &mut [f32]) -> Result<(), String> {
        let numbers = self.network.run(input, &mut self.arena);
        if let Some(index) = numbers.iter().position(|number| !number.is_finite()) {
            return Err(format!("number {index} of its output is {}", numbers[index]));
        }
        output.copy_from_slice(numbers);
        Ok(())
    }
}
