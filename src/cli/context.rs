//! What the command line as a whole tells every verb.

use std::path::PathBuf;

/// What every verb is given beside its own arguments.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct CliContext {
    /// The store's folder; it may not exist yet.
    pub data: PathBuf,
    /// Whether that folder was asked for; a scenario keeps away from the default one.
    pub data_given: bool,
    /// Whether answers are JSON.
    pub json: bool,
}
