//! The global options, for every verb.

use std::path::PathBuf;

/// The global options, which every verb gets beside its own arguments.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CliContext {
    /// The store's folder; it may not exist yet.
    pub data: PathBuf,
    /// Whether `--data` named the folder; a scenario never uses the default one.
    pub data_given: bool,
    /// Whether answers are JSON.
    pub json: bool,
}
