//! A recording as plain values: the data that a replay shows and a test compares.

use serde::{Deserialize, Serialize};

use holdpoint_governance::closed_set::Lenient;
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::record::UpgradeEnd;
use holdpoint_protocol::event::Event;
use holdpoint_protocol::video_frame::{Scenery, VideoFrame};

/// The version that the recording belongs to. Source: design 8, recording properties.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RecordingSubject {
    pub version: CapabilityId,
    /// Digest of its manifest and bundle.
    pub digest: Digest,
    /// The version that was active when the recording began.
    pub predecessor: Option<CapabilityId>,
    pub profile: Lenient<ProfileName>,
    pub robot: String,
    /// Seed of the run; absent where the seeds are secret.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub seed: Option<u64>,
    /// The engine that wrote it.
    pub engine_build: String,
}

/// A value over time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Series {
    /// Name as a path beneath `plots/`: `shadow/output`, `kappa/B`, `tool/speed`, `tool/speed/limit`.
    pub name: String,
    /// Virtual time in ms, and value, in order of time.
    pub points: Vec<(u64, f64)>,
}

/// A re-run part of an evaluation: its place in the recording.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FilmSpan {
    /// Virtual time of its first frame in the recording, ms; the episode ran at another time.
    pub from_ms: u64,
    /// Virtual time of its last frame, ms.
    pub until_ms: u64,
    /// Name of the part: `episode 17 of 120, seed 10016`.
    pub title: String,
    /// Why this part was chosen; may be empty.
    pub why: String,
    /// The candidate's result, in words; empty in recordings of older builds.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub ended: String,
    /// The candidate's failures, in order: it went wrong at the first.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub failures: Vec<FailureMoment>,
}

/// A moment that speaks against the candidate in a re-run part of an evaluation.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FailureMoment {
    /// Virtual time in the recording, ms.
    pub at_ms: u64,
    /// What happened, a few words.
    pub text: String,
}

/// All recorded data of one upgrade, in order of virtual time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Recording {
    pub about: RecordingSubject,
    /// How the upgrade ended; absent if the recording was not closed.
    pub outcome: Option<Lenient<UpgradeEnd>>,
    /// The scenery, which does not move.
    pub scenery: Scenery,
    /// Frames of the live cell and of re-run parts ([`Self::films`]). A decimated recording has fewer; nothing is
    /// interpolated.
    pub pictures: Vec<VideoFrame>,
    pub events: Vec<Event>,
    /// Charts, by name.
    pub series: Vec<Series>,
    /// Re-run parts of its evaluation, in order.
    #[serde(default)]
    pub films: Vec<FilmSpan>,
    /// Frames and events dropped because the queue was full.
    pub dropped: (u64, u64),
}

impl Recording {
    /// The re-run part, if the recording is of that part alone and not of an upgrade.
    #[must_use]
    pub fn rerun(&self) -> Option<&FilmSpan> {
        match self.films.as_slice() {
            [film] if self.events.is_empty() => Some(film),
            _ => None,
        }
    }

    /// Virtual time of its first and last moment, ms; `None` if it holds none.
    #[must_use]
    pub fn span_ms(&self) -> Option<(u64, u64)> {
        let frames = self.pictures.iter().map(|frame| frame.at_ms);
        let events = self.events.iter().map(|event| event.at_ms);
        let times = frames.chain(events);
        times.fold(None, |span, at| {
            Some(span.map_or((at, at), |(first, last): (u64, u64)| (first.min(at), last.max(at))))
        })
    }
}
