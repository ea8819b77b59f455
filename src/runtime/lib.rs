//! The runtime: an agent whose every command passes the guard, watched, with recovery.
pub mod agent;
pub mod arm;
pub mod capability;
pub mod guard;
pub mod limits;
pub mod recovery;
pub mod skill;
pub mod task;
pub mod terms;
pub mod watcher;
