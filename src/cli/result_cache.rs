//! The location of cached results: a folder, and the key file outside it.

use std::path::{Path, PathBuf};

use clap::Args;

use super::operator_folder::own_folder;
use crate::error::CliError;
use holdpoint_store::{CacheSecret, ResultCache};
use holdpoint_text::ErrorReason;

/// The key file's name in the operator's configuration folder.
const KEY_FILE: &str = "cells.key";

/// The key that authenticates cached results.
#[derive(Clone, Debug, Default, PartialEq, Eq, Args)]
pub struct CacheKeyArgs {
    /// The key file that authenticates cached results: outside their folder, readable only by its owner; created if
    /// missing [default: cells.key in the operator's configuration folder, ~/.config/holdpoint].
    #[arg(long, value_name = "FILE")]
    pub cache_key: Option<PathBuf>,
}

impl CacheKeyArgs {
    /// Opens the cache in a folder that `option` may name; `None` without a folder.
    ///
    /// # Errors
    /// As [`Self::open_cache`], or for a key without a folder.
    pub fn open_cache_if_named(
        &self,
        folder: Option<&Path>,
        option: &str,
    ) -> Result<Option<ResultCache>, CliError> {
        match (folder, &self.cache_key) {
            (Some(folder), _) => self.open_cache(folder).map(Some),
            (None, Some(_)) => Err(CliError::usage(format!("--cache-key applies only with {option}"))
                .with_hint(format!("name one with {option}"))),
            (None, None) => Ok(None),
        }
    }

    /// Opens the cache in a folder.
    ///
    /// # Errors
    /// If the folder cannot be created, or the key file is inside it, unusable, or readable by others.
    pub fn open_cache(&self, folder: &Path) -> Result<ResultCache, CliError> {
        let key = match &self.cache_key {
            Some(key) => key.clone(),
            None => own_folder()
                .ok_or_else(|| {
                    CliError::usage(
                        "neither XDG_CONFIG_HOME nor HOME names a folder for the key of cached results",
                    )
                    .with_hint("name a key file with --cache-key")
                    .with_details(ErrorReason::Environment)
                })?
                .join(KEY_FILE),
        };
        let secret = CacheSecret::of_file_outside(&key, folder).map_err(CliError::usage)?;
        Ok(ResultCache::in_folder(folder.to_owned(), secret))
    }
}
