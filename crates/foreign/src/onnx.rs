//! The part of ONNX that whole-body controllers use: networks of dense layers, activation functions, and operators that
//! cut, join and scale their values.
//!
//! ```text
//! bytes -> Graph (file.rs) -> values and steps, with every shape known (load.rs, operators.rs) -> Network -> run
//! ```
//!
//! Everything that depends on the file alone is computed at load. The rest are steps over one block of numbers, the arena:
//! a step reads what earlier steps wrote before it. So a run allocates nothing.
mod arrange;
mod file;
mod load;
mod network;
mod operators;
mod refusal;
mod steps;
mod value;
mod wire;

#[cfg(test)]
mod tests;

pub(crate) use network::Network;
pub(crate) use refusal::Refusal;
