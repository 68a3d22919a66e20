use std::path::PathBuf;

use thiserror::Error;

/// Why weights cannot be used, or features not be computed.
#[derive(Debug, Error)]
pub enum FeatureError {
    /// The file cannot be read.
    #[error("cannot read the weights '{path}'; check that the file exists and may be read")]
    Read {
        /// Path of the weights that cannot be read.
        path: PathBuf,
        /// What the system says.
        #[source]
        source: std::io::Error,
    },
    /// The file is larger than any file of this network.
    #[error(
        "the weights '{path}' have more than {limit} bytes; a ResNet-18 in f32 has about 47,000,000: save the \
         state dict alone, without the optimiser's state"
    )]
    FileSize {
        /// Path of the weights, for the message.
        path: PathBuf,
        /// The largest size that is read.
        limit: u64,
    },
    /// The file is not a safetensors file, or does not hold this network's tensors.
    #[error(transparent)]
    File(#[from] fiatlux_safetensors::SafetensorsError),
    /// A tensor that this network does not have: the file is of another network.
    #[error("the weights have a tensor '{tensor}' that ResNet-18 has not; save torchvision's resnet18().state_dict()")]
    Unexpected {
        /// Name of the tensor in the file.
        tensor: String,
    },
    /// A tensor holds a number that no network can use.
    #[error(
        "tensor '{tensor}': expected {expected}, found {found} at index {index}; use a checkpoint from before \
         it diverged"
    )]
    Number {
        /// Name of the tensor in the file.
        tensor: String,
        expected: &'static str,
        found: f32,
        /// Where, counted through the tensor.
        index: usize,
    },
    /// The image's sides do not fit the network.
    #[error(
        "an image of {width} x {height} pixels: expected sides that are multiples of 32, from 32 to {limit}; \
         render it so"
    )]
    ImageSize {
        /// Pixels in a row.
        width: usize,
        /// Rows of pixels in the image.
        height: usize,
        /// The largest side that the network takes, pixels.
        limit: usize,
    },
    /// The image has not the bytes of its size.
    #[error(
        "an image of {width} x {height} pixels: expected {expected} bytes of RGB, found {found}; pass 3 bytes a pixel"
    )]
    ImageBytes {
        /// Pixels in a row.
        width: usize,
        /// Rows of pixels in the image.
        height: usize,
        expected: usize,
        /// Number of bytes that were given.
        found: usize,
    },
    /// The weights are so large that the sums overflow.
    #[error("feature {index}: expected a finite number, found {found}; the weights '{label}' overflow f32: use others")]
    Overflow {
        /// Label of the weights, as records have it.
        label: String,
        /// Index of the first feature that overflows.
        index: usize,
        found: f32,
    },
}
