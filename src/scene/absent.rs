//! The sink of a program that was built without it: says so, and does nothing.

use std::path::Path;
use std::time::Duration;

use super::recording::Recording;
use super::tap::Tap;
use super::{NOT_BUILT_IN, ReadError, Report, SceneConfig, SceneError};

/// A sink that never runs.
#[derive(Debug)]
pub struct Scenes {
    tap: Tap,
}

impl Scenes {
    /// Refuses.
    ///
    /// # Errors
    /// Always: scenes are not built in.
    pub fn start(_config: SceneConfig) -> Result<Self, SceneError> {
        Err(SceneError::NotBuiltIn(NOT_BUILT_IN))
    }

    /// The queue's open end.
    #[must_use]
    pub fn tap(&self) -> Tap {
        self.tap.clone()
    }

    /// Nothing.
    #[must_use]
    pub const fn reports(&mut self) -> Vec<Report> {
        Vec::new()
    }

    /// Nothing.
    #[must_use]
    pub fn finish(self, _patience: Duration) -> Vec<Report> {
        Vec::new()
    }
}

/// Refuses.
///
/// # Errors
/// Always: scenes are not built in.
pub const fn read(_path: &Path) -> Result<Recording, ReadError> {
    Err(ReadError::NotBuiltIn(NOT_BUILT_IN))
}

/// Refuses.
///
/// # Errors
/// Always: scenes are not built in.
pub const fn until(_path: &Path, _tick: u64, _out: &Path) -> Result<(), ReadError> {
    Err(ReadError::NotBuiltIn(NOT_BUILT_IN))
}
