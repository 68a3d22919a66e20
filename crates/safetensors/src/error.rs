use thiserror::Error;

/// The tensors of a file cannot be read. The messages tell a writer in Python what to do.
#[derive(Debug, Error)]
pub enum SafetensorsError {
    #[error("not a safetensors file: {problem}; write it with safetensors.torch.save_file")]
    Format { problem: String },
    #[error(
        "the file lacks the tensor '{tensor}', expected with shape {shape:?}; save the network's whole state_dict()"
    )]
    Missing { tensor: String, shape: Vec<usize> },
    #[error(
        "tensor '{tensor}': expected shape {expected:?}, found {found:?}; save the state_dict() of a network of this shape"
    )]
    Shape { tensor: String, expected: Vec<usize>, found: Vec<u64> },
    #[error(
        "tensor '{tensor}': expected dtype F32 or F16, found {found}; convert the state_dict() with .float() before saving"
    )]
    Type { tensor: String, found: String },
    #[error(
        "tensor '{tensor}': expected {expected} bytes within the {data} bytes of data, found bytes {begin} to {end}; \
         the file is cut or damaged: copy it again"
    )]
    Extent { tensor: String, expected: u64, data: u64, begin: u64, end: u64 },
}
