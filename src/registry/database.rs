//! The database files.
//!
//! Owns how they are opened, made and brought to the newest schema, the check of their shape, and the id of the store. Must
//! not know what a record says.

pub(crate) mod columns;
pub(crate) mod migrate;
pub(crate) mod open;
pub(crate) mod schema_shape;
pub(crate) mod store_id;
