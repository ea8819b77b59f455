//! The seven stages: from registration to audit closure.
//!
//! Owns the Upgrade Manager and what it measures with: cell, episodes, drills, live world, shadow.
//! Decides nothing by itself; the rules are in `governance`.

mod alarming;
mod binding;
pub mod cache;
pub mod cell;
mod descent;
pub mod dossier;
pub mod drills;
pub mod evaluate;
pub mod evaluation;
pub mod lab;
pub mod ledger;
pub mod live;
pub mod manager;
pub mod measures;
pub mod paced;
pub mod pacer;
pub mod painter;
pub mod portrait;
pub mod recordings;
pub mod rehearsal;
pub mod seeds;
pub mod sentry;
mod sequence;
pub mod shadow;
pub mod stages;
mod standing;
pub mod trace;
pub mod witness;
