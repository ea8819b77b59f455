//! The runtime: an agent whose every command passes the guard, watched, with recovery.
pub mod agent;
pub mod arm;
pub mod capability;
pub mod grant;
pub mod guard;
pub mod handover;
pub mod harm;
pub mod limits;
pub mod meter;
pub mod recovery;
pub mod seeds;
pub mod senses;
pub mod skill;
pub mod stress;
pub mod task;
pub mod terms;
pub mod watcher;
