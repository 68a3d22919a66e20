//! The program `fiatlux`: the whole service on one machine.
//!
//! - [`render`]: recorded episodes as a video, a still or a folder of pictures.
//! - [`keys`]: keys, certificates and configs of an installation on several machines.

pub mod keys;
mod part;
pub mod render;

pub use part::part_of;
