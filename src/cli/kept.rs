//! Where results are kept that need not be worked again: a folder, and the key file outside it.

use std::path::{Path, PathBuf};

use clap::Args;

use super::own_folder::own_folder;
use crate::error::CliError;
use holdpoint_registry::{KeptCells, KeptSecret};

/// The key file's name in the operator's own folder.
const KEY_FILE: &str = "cells.key";

/// The key that kept results are authenticated with.
#[derive(Clone, Debug, Default, PartialEq, Eq, Args)]
pub struct CacheKeyArgs {
    /// The key file that kept results are authenticated with: outside their folder, for its owner alone; made if it is
    /// missing [default: cells.key in the operator's own folder, ~/.config/holdpoint].
    #[arg(long, value_name = "FILE")]
    pub cache_key: Option<PathBuf>,
}

impl CacheKeyArgs {
    /// The cells in a folder that may be named, by this option.
    ///
    /// # Errors
    /// As [`Self::cells`], or for a key without a folder.
    pub fn cells_in(&self, folder: Option<&Path>, option: &str) -> Result<Option<KeptCells>, CliError> {
        match (folder, &self.cache_key) {
            (Some(folder), _) => self.cells(folder).map(Some),
            (None, Some(_)) => Err(CliError::usage(format!("--cache-key is for the folder of {option}"))
                .with_hint(format!("name one with {option}"))),
            (None, None) => Ok(None),
        }
    }

    /// The cells in a folder.
    ///
    /// # Errors
    /// If the folder cannot be made, or the key file lies in it, cannot be used, or can be read by others.
    pub fn cells(&self, folder: &Path) -> Result<KeptCells, CliError> {
        let key = match &self.cache_key {
            Some(key) => key.clone(),
            None => own_folder()
                .ok_or_else(|| {
                    CliError::usage(
                        "neither XDG_CONFIG_HOME nor HOME names a folder for the key of kept results",
                    )
                    .with_hint("name a key file with --cache-key")
                })?
                .join(KEY_FILE),
        };
        let secret = KeptSecret::beside(&key, folder).map_err(CliError::usage)?;
        Ok(KeptCells::in_folder(folder.to_owned(), secret))
    }
}
