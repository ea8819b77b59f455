//! The terms that all rooms share.
//!
//! Owns the kinds of records that only the store writes, the limit of a row, and SQLite's errors as those of the store. Must
//! not read a file or a database. Changes, errors and entries are the crate `store`'s.

pub(crate) mod own_records;
pub(crate) mod row_limit;
pub(crate) mod sqlite_error;
