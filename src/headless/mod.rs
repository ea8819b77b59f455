//! Scripted operation: scenario files, JSON lines and the plain stream.
pub mod script;
