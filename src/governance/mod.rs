//! The rules: pure functions over plain data. No I/O, no clock, no randomness, no async.
pub mod ids;
