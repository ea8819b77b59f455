//! The terms that all rooms share.
//!
//! Owns the errors of the store, the changes of a transaction as plain data, the closed sets, and the limit of a row. Must not
//! read a file or a database.

pub(crate) mod change;
pub(crate) mod error;
pub(crate) mod row_limit;
pub mod store_terms;
