//! Records sessions into bags.
fn main() {}
