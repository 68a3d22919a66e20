//! The launcher as a user meets it, and runs on servers in this process.
#![allow(clippy::unwrap_used, missing_docs)]

mod common;
mod demonstrate;
mod external;
mod render;
mod runs;
mod teleop;
mod view;
