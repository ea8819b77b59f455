//! Benchmarks of the rules, of whole decisions and of other physics engines.
//!
//! Each module owns one report. [`mod@holdpoint::bench`] has the clocks, figures and errors, and times the engine.

pub mod decision;
pub mod peers;
pub mod stats;
