//! The network against PyTorch, its properties, and the files that it refuses.
#![allow(clippy::unwrap_used, missing_docs)]

mod network;
mod oracle;
mod refusals;
