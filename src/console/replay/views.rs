//! The parts of a replay's screen. Each reads the model and draws; none changes anything.

pub mod bar;
pub mod charts;
pub mod events;
pub mod header;
pub mod help;
pub mod hints;
pub mod plot;
pub mod robot;
pub mod small_window;

/// Virtual time in seconds, as events and jumps have it: `761.0 s`.
#[must_use]
pub fn secs(at_ms: u64) -> String {
    format!("{}.{} s", at_ms / 1000, at_ms / 100 % 10)
}
