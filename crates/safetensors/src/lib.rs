//! The safetensors format, as far as our networks need it: 8 bytes of header length (little-endian), a JSON header that
//! gives each tensor's type, shape and place, then the data (huggingface.co/docs/safetensors). Numbers are f32, in files of others also f16.
//!
//! ```
//! use fiatlux_safetensors::{File, SafetensorsError, write};
//!
//! let bytes = write([("bias".to_owned(), vec![2], [0.5, -1.0].as_slice())].into_iter());
//! let file = File::parse(&bytes)?;
//! assert_eq!(file.tensor("bias", &[2])?, [0.5, -1.0]);
//! assert!(matches!(file.tensor("bias", &[3]), Err(SafetensorsError::Shape { .. })));
//! # Ok::<(), SafetensorsError>(())
//! ```
#![allow(missing_docs)] // Used in this repository alone.
mod error;
mod file;

pub use error::SafetensorsError;
pub use file::{File, write};
