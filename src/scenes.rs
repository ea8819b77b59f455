//! Recordings and live scenes, or an error if the program was built without them.

use std::net::SocketAddr;
use std::path::Path;

use holdpoint_protocol::film::Film;
use holdpoint_protocol::sink::MakeSink;
use holdpoint_recordings::recording::{Recording, RecordingSubject};

use crate::error::CliError;

/// Whether this program can record and show scenes.
pub const BUILT_IN: bool = cfg!(feature = "rerun");

/// The scenes to produce.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SceneOptions {
    /// Record each upgrade into the store's folder.
    pub record: bool,
    /// Serve a live viewer at this address.
    pub view: Option<SocketAddr>,
}

impl SceneOptions {
    /// The listeners that produce the scenes.
    ///
    /// # Errors
    /// If a viewer is requested and the program was built without one.
    pub fn sinks(self) -> Result<Vec<MakeSink>, CliError> {
        if self.view.is_some() && !BUILT_IN {
            return Err(not_built_in());
        }
        if !self.record && self.view.is_none() {
            return Ok(Vec::new());
        }
        Ok(Self::makers(self))
    }

    #[cfg(feature = "rerun")]
    fn makers(self) -> Vec<MakeSink> {
        use holdpoint_protocol::sink::Sink;
        use holdpoint_text::Hint as _;
        vec![Box::new(move |setup| {
            let config = holdpoint_scene::SceneConfig {
                recordings: self.record.then_some(setup.recordings),
                closed: setup.closed,
                view: self.view,
                wall_clock: !setup.scripted,
            };
            let scenes = holdpoint_scene::SceneSink::start(config).map_err(|error| error.sentence())?;
            Ok(Box::new(scenes) as Box<dyn Sink>)
        })]
    }

    #[cfg(not(feature = "rerun"))]
    const fn makers(_: Self) -> Vec<MakeSink> {
        Vec::new()
    }
}

/// Reads a recording.
///
/// # Errors
/// If it cannot be read, or this program was built without scenes.
#[cfg(feature = "rerun")]
pub fn read(path: &Path) -> Result<Recording, CliError> {
    holdpoint_scene::read(path).map_err(CliError::usage)
}

/// Copies a recording up to a tick.
///
/// # Errors
/// If it cannot be read or written, or this program was built without scenes.
#[cfg(feature = "rerun")]
pub fn until(path: &Path, tick: u64, out: &Path) -> Result<(), CliError> {
    holdpoint_scene::until(path, tick, out).map_err(CliError::usage)
}

/// Writes a segment of an evaluation as a separate recording.
///
/// # Errors
/// If it cannot be written, or this program was built without scenes.
#[cfg(feature = "rerun")]
pub fn write_film(path: &Path, about: RecordingSubject, film: &Film) -> Result<(), CliError> {
    holdpoint_scene::film_file::write(path, about, film).map_err(CliError::usage)
}

/// Fails.
///
/// # Errors
/// Always: scenes are not built in.
#[cfg(not(feature = "rerun"))]
pub fn write_film(_path: &Path, _about: RecordingSubject, _film: &Film) -> Result<(), CliError> {
    Err(not_built_in())
}

/// Fails.
///
/// # Errors
/// Always: scenes are not built in.
#[cfg(not(feature = "rerun"))]
pub fn read(_path: &Path) -> Result<Recording, CliError> {
    Err(not_built_in())
}

/// Fails.
///
/// # Errors
/// Always: scenes are not built in.
#[cfg(not(feature = "rerun"))]
pub fn until(_path: &Path, _tick: u64, _out: &Path) -> Result<(), CliError> {
    Err(not_built_in())
}

fn not_built_in() -> CliError {
    CliError::usage("this program was built without scenes")
        .with_hint("build it with the feature `rerun`")
        .with_details(holdpoint_text::ErrorReason::Environment)
}
