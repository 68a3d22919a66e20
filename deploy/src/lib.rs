//! The program `fiatlux`: the whole service on one machine.
//!
//! - [`evaluate`]: server, recorder, policy and scorer in one process, or a run that a client plays from elsewhere.
//! - [`render`]: recorded episodes as a video, a still or a folder of pictures.
//! - [`mod@bench`]: speeds of physics, sensors, batches and sessions, and what the engine does under violent targets.
//! - [`keys`]: keys, certificates and configs of an installation on several machines.

pub mod bench;
pub mod evaluate;
pub mod keys;
mod part;
pub mod render;

pub use part::part_of;
