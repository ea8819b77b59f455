//! Joins the recordings of one upgrade: a restarted engine continues in another file.

use std::path::PathBuf;

use crate::error::CliError;
use crate::scenes;
use holdpoint_recordings::recording::{Recording, Series};

/// Reads every file, in order, and joins them.
///
/// # Errors
/// If one cannot be read, or this program was built without scenes.
pub(super) fn read(files: &[PathBuf]) -> Result<Recording, CliError> {
    let mut parts = Vec::new();
    for path in files {
        parts.push(scenes::read(path)?);
    }
    join(parts).ok_or_else(|| CliError::internal("no file was named"))
}

/// Joins the parts of one recording. Static objects and the end come from the last part that has them: only the
/// last part is closed.
fn join(parts: Vec<Recording>) -> Option<Recording> {
    let mut parts = parts.into_iter();
    let mut whole = parts.next()?;
    for part in parts {
        whole.outcome = part.outcome;
        if part.scenery != holdpoint_protocol::video_frame::Scenery::default() {
            whole.scenery = part.scenery;
        }
        whole.pictures.extend(part.pictures);
        whole.events.extend(part.events);
        whole.films.extend(part.films);
        for series in part.series {
            add(&mut whole.series, series);
        }
        whole.dropped.0 += part.dropped.0;
        whole.dropped.1 += part.dropped.1;
    }
    // Stable: events of the same time keep their order.
    whole.pictures.sort_by_key(|frame| frame.at_ms);
    whole.events.sort_by_key(|event| event.at_ms);
    Some(whole)
}

fn add(all: &mut Vec<Series>, more: Series) {
    match all.iter_mut().find(|series| series.name == more.name) {
        Some(series) => {
            series.points.extend(more.points);
            series.points.sort_by_key(|(at_ms, _)| *at_ms);
        }
        None => all.push(more),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_governance::record::UpgradeEnd;
    use holdpoint_recordings::recording::RecordingSubject;

    fn part(outcome: Option<UpgradeEnd>, points: &[(u64, f64)], name: &str) -> Recording {
        Recording {
            about: RecordingSubject {
                version: "grasp@1.1.0".parse().unwrap(),
                digest: holdpoint_governance::ids::Digest::from_bytes([1; 32]),
                predecessor: None,
                profile: holdpoint_governance::profile::ProfileName::Sim.into(),
                robot: "arm7".to_owned(),
                seed: Some(1),
                engine_build: "test".to_owned(),
            },
            outcome: outcome.map(Into::into),
            scenery: holdpoint_protocol::video_frame::Scenery::default(),
            pictures: Vec::new(),
            events: Vec::new(),
            series: vec![Series { name: name.to_owned(), points: points.to_vec() }],
            films: Vec::new(),
            dropped: (1, 2),
        }
    }

    #[test]
    fn segments_are_joined_into_one_recording() {
        let parts = vec![
            part(None, &[(1, 1.0), (5, 2.0)], "a"),
            part(None, &[(7, 3.0)], "b"),
            part(Some(UpgradeEnd::Confirmed), &[(9, 4.0)], "a"),
        ];
        let whole = join(parts).unwrap();
        assert_eq!((whole.outcome, whole.dropped), (Some(UpgradeEnd::Confirmed.into()), (3, 6)));
        let points: Vec<(&str, usize)> =
            whole.series.iter().map(|series| (series.name.as_str(), series.points.len())).collect();
        assert_eq!(points, [("a", 3), ("b", 1)]);
        assert_eq!(join(Vec::new()), None);
    }
}
