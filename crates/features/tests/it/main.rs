//! The network against PyTorch and its own laws, and what it refuses.
#![allow(clippy::unwrap_used, missing_docs)]

mod network;
mod oracle;
mod refusals;
