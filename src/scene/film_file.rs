//! A part of an evaluation as a recording: the candidate as the robot, the compared version as the twin, the joints and
//! the tool of both as columns.
//!
//! Writes the values it is given, and keeps no state.

use std::fs::File;
use std::path::{Path, PathBuf};

use super::drawing::RecordingHead;
use super::writer::{RecordingPlace, RecordingWriter};
use super::{ReadError, config};
use holdpoint_protocol::film::Film;
use holdpoint_recordings::recording::RecordingSubject;

/// Writes a film to a new file, replacing an old one.
///
/// # Errors
/// If it cannot be written.
pub fn write(path: &Path, about: RecordingSubject, film: &Film) -> Result<(), ReadError> {
    let failed = |source| ReadError::file(path, source);
    let stem = path.file_stem().map_or_else(|| "film".into(), |stem| stem.to_string_lossy().into_owned());
    let place = RecordingPlace {
        stem: config::display_path(Path::new(&stem)),
        segments: vec![PathBuf::from(path)],
        segment: 1,
    };
    let head = RecordingHead { about, scenery: film.scenery.clone() };
    let open = |path: &Path| File::create(path);
    let mut writer = RecordingWriter::begin(head, place, false, 0, &open).map_err(failed)?;
    writer.film(film).map_err(failed)?;
    writer.end(None, (0, 0)).map(drop)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reader::{contents, read};
    use serde_json::json;

    fn film() -> Film {
        let body = json!({ "links": [[0.0, 0.0, 0.0], [0.3, 0.0, 0.4]], "pads": [[0.3, 0.0, 0.4], [0.3, 0.0, 0.4]],
            "hand": [0.0, 0.0, 0.0, 1.0], "object": [0.4, 0.0, 0.02], "object_turn": [0.0, 0.0, 0.0, 1.0],
            "object_half_m": 0.02, "held": false });
        let frame = |tick: u64| {
            json!({ "tick": tick, "body": body, "q": [0.1, 0.2], "tau": [1.0, 2.0], "speed_m_s": 0.2,
                "grip_n": 1.0, "contact_n": 0.0, "touched": false, "stopped": false })
        };
        let run = |version: &str, frames: u64| {
            json!({ "version": version, "envelope": { "speed_m_s": 0.5, "force_n": 20.0, "contact_n": 10.0 },
                "ended": "", "as_recorded": true, "blocks": [],
                "marks": [{ "tick": 16, "text": "a force is larger than allowed", "bad": true }],
                "frames": (0..frames).map(|at| frame(8 * at)).collect::<Vec<_>>() })
        };
        serde_json::from_value(json!({
            "of": "episode", "number": 3, "count": 9, "task": "grasp", "seed": 7, "why": "", "doubts": [],
            "scenery": { "workspace": null, "keep_outs": [], "fixtures": [] },
            "candidate": run("grasp@1.1.0", 5), "active": run("grasp@1.0.0", 4),
        }))
        .unwrap()
    }

    /// The written file is read back: every frame, the twin in each, the events, and a column for each joint.
    #[test]
    fn film_is_written_and_read_as_a_recording() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("film.rrd");
        let about: RecordingSubject = serde_json::from_value(json!({ "version": "grasp@1.1.0", "digest": "a".repeat(64),
            "predecessor": "grasp@1.0.0", "profile": "sim", "robot": "arm7", "seed": 7, "engine_build": "x" }))
        .unwrap();
        write(&path, about.clone(), &film()).unwrap();
        let recording = read(&path).unwrap();
        assert_eq!(recording.about, about);
        let times: Vec<u64> = recording.pictures.iter().map(|frame| frame.at_ms).collect();
        assert_eq!(times, [0, 33, 66, 100, 133]);
        assert!(recording.pictures.iter().all(|frame| frame.twin.is_some()));
        // The moment at which it went wrong is read back.
        let rerun = recording.rerun().unwrap();
        assert_eq!((rerun.failures.len(), rerun.failures[0].at_ms), (1, 66));
        assert_eq!(rerun.failures[0].text, "a force is larger than allowed");
        let chunks = contents(&path).unwrap().chunks;
        let rows = |entity: &str| -> usize {
            let of = chunks.iter().filter(|chunk| chunk.entity_path().to_string() == entity);
            of.map(rerun::log::Chunk::num_rows).sum()
        };
        for (column, frames) in
            [("/joints/candidate/q2", 5), ("/joints/active/tau1", 4), ("/tool/active/grip", 4)]
        {
            assert_eq!(rows(column), frames, "{column}");
        }
        // The label, and the events of each.
        assert_eq!(rows("/log/film"), 3);
    }
}
