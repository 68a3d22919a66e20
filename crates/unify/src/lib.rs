//! Nothing: this crate is its dependencies, see its `Cargo.toml`.
