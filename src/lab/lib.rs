//! The laboratory: what is measured about the engine and its rules, and what is made to be measured.
//!
//! [`mod@bench`] times the engine and counts how often its rules err; [`experiment`] runs whole upgrades that answer a
//! question; [`truth`] says what candidates really are, and how decisions stand to it; [`pool`] draws candidates for
//! them; [`paper`] works the paper's own evaluation anew; [`refine`] makes a candidate by optimising on nominal success alone.
//! Nothing that decides names anything of it.

pub mod approver;
pub mod bench;
pub mod experiment;
pub mod paper;
pub mod pool;
pub mod refine;
pub mod same_code;
pub mod truth;

#[cfg(test)]
mod harm_cases;

#[cfg(test)]
mod sequence_cases;
