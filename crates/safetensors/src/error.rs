use thiserror::Error;

/// Why a file's tensors cannot be read. The messages say what a writer in Python has to do.
#[derive(Debug, Error)]
pub enum SafetensorsError {
    /// The bytes are another format's, or are cut within their header.
    #[error("not a safetensors file: {problem}; write it with safetensors.torch.save_file")]
    Format {
        /// What is wrong, with what was expected and found.
        problem: String,
    },
    /// A tensor that is asked for is not there.
    #[error(
        "the file lacks the tensor '{tensor}', expected with shape {shape:?}; save the network's whole state_dict()"
    )]
    Missing {
        /// Name of the tensor that is missing.
        tensor: String,
        shape: Vec<usize>,
    },
    /// A tensor has another shape.
    #[error(
        "tensor '{tensor}': expected shape {expected:?}, found {found:?}; save the state_dict() of a network of this shape"
    )]
    Shape {
        /// Name of the tensor in the file.
        tensor: String,
        expected: Vec<usize>,
        found: Vec<u64>,
    },
    /// A tensor has another type of number.
    #[error(
        "tensor '{tensor}': expected dtype F32, found {found}; convert the state_dict() with .float() before saving"
    )]
    Type {
        /// Name of the tensor in the file.
        tensor: String,
        /// The dtype in the file, such as `F16`.
        found: String,
    },
    /// A tensor's place in the file is not of its size, or not in the file.
    #[error(
        "tensor '{tensor}': expected {expected} bytes within the {data} bytes of data, found bytes {begin} to {end}; \
         the file is cut or damaged: copy it again"
    )]
    Extent {
        /// Name of the tensor in the file.
        tensor: String,
        /// Bytes of its shape.
        expected: u64,
        /// Bytes behind the header.
        data: u64,
        begin: u64,
        end: u64,
    },
}
