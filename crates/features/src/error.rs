use std::path::PathBuf;

use thiserror::Error;

#[derive(Debug, Error)]
pub enum FeatureError {
    #[error("cannot read the weights '{path}'; check that the file exists and may be read")]
    Read { path: PathBuf, source: std::io::Error },
    #[error(
        "the weights '{path}' have more than {limit} bytes; a ResNet-18 in f32 has about 47,000,000: save the \
         state dict alone, without the optimiser's state"
    )]
    FileSize { path: PathBuf, limit: u64 },
    #[error(transparent)]
    File(#[from] fiatlux_safetensors::SafetensorsError),
    #[error(
        "the weights have a tensor '{tensor}' that ResNet-18 does not have; save torchvision's resnet18().state_dict()"
    )]
    Unexpected { tensor: String },
    #[error(
        "tensor '{tensor}': expected {expected}, found {found} at index {index}; use a checkpoint from before \
         it diverged"
    )]
    Number {
        /// Name of the tensor in the file.
        tensor: String,
        expected: &'static str,
        found: f32,
        index: usize,
    },
    #[error(
        "an image of {width} x {height} pixels: expected sides that are multiples of 32, from 32 to {limit}; \
         render it so"
    )]
    ImageSize { width: usize, height: usize, limit: usize },
    #[error(
        "an image of {width} x {height} pixels: expected {expected} bytes of RGB, found {found}; pass 3 bytes a pixel"
    )]
    ImageBytes { width: usize, height: usize, expected: usize, found: usize },
    #[error("feature {index}: expected a finite number, found {found}; the weights '{label}' overflow f32: use others")]
    Overflow { label: String, index: usize, found: f32 },
}
