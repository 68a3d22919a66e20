//! The policy client.
fn main() {}
