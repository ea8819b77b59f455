//! Holdpoint.
fn main() {}
