//! A piece of an evaluation as a recording of its own: the candidate as the robot, the version it was compared with as
//! the twin, the joints and the tool of both as columns.
//!
//! Writes what it is given; it asks nobody and keeps nothing.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::drawing::RecordingHead;
use super::writer::{RecordingPlace, Writer};
use super::{ReadError, config};
use holdpoint_protocol::film::Film;
use holdpoint_recordings::recording::About;

/// Writes a film to a file, which is made anew.
///
/// # Errors
/// If it cannot be written.
pub fn write(path: &Path, about: About, film: &Film) -> Result<(), ReadError> {
    let failed = |source| ReadError::file(path, source);
    let stem = path.file_stem().map_or_else(|| "film".into(), |stem| stem.to_string_lossy().into_owned());
    let place = RecordingPlace {
        stem: config::shown(Path::new(&stem)),
        segments: vec![PathBuf::from(path)],
        segment: 1,
    };
    let head = RecordingHead { about, scenery: film.scenery.clone() };
    let open = |path: &Path| File::create(path);
    let mut writer = Writer::begin(head, place, false, 0, &open).map_err(failed)?;
    for picture in holdpoint_recordings::film::pictures(film) {
        writer.earlier(vec![Arc::new(picture)]).map_err(failed)?;
    }
    for (who, run) in [("candidate", &film.candidate), ("active", &film.active)] {
        for frame in &run.frames {
            writer.columns(who, frame, holdpoint_recordings::film::at_ms(frame.tick)).map_err(failed)?;
        }
    }
    writer.end(None, (0, 0)).map(drop)
}
