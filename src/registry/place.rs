//! The store's folder.
//!
//! Owns the names of its files, the lock that gives it to one engine, and the marks of stops that could not be recorded.
//! Must not open a database.

pub(crate) mod layout;
pub(crate) mod lock_holder;
pub(crate) mod stop_mark;
