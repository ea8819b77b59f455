//! The care of a store that exists.
//!
//! Owns rebuild, backup, the properties of a store, and the check of its key files. No other room names it.

pub(crate) mod backup;
pub(crate) mod info;
pub(crate) mod key_files;
pub(crate) mod rebuild;
