//! A recording as plain values: what a replay shows, and what a test compares.

use serde::{Deserialize, Serialize};

use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::record::UpgradeEnd;
use holdpoint_governance::words::Word;
use holdpoint_protocol::event::Event;
use holdpoint_protocol::picture::{Picture, Scenery};

/// Whose recording it is. Source: design 8, recording properties.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct About {
    pub version: CapabilityId,
    /// Digest of its manifest and bundle.
    pub digest: Digest,
    /// The version that was active when the recording began.
    pub predecessor: Option<CapabilityId>,
    pub profile: Word<ProfileName>,
    pub robot: String,
    pub seed: u64,
    /// The engine that wrote it.
    pub engine_build: String,
}

/// A value over time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Series {
    /// Which, as a path beneath `plots/`: `shadow/output`, `kappa/B`, `tool/speed`, `tool/speed/limit`.
    pub name: String,
    /// Virtual time, ms, and value, in order of time.
    pub points: Vec<(u64, f64)>,
}

/// A piece of an evaluation that was worked again, so that the recording shows it: in which part of it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FilmSpan {
    /// Virtual time of its first picture as it is laid in the recording, ms; it was not worked at that time.
    pub from_ms: u64,
    /// Of its last one, ms.
    pub until_ms: u64,
    /// Which piece: `episode 17 of 120, seed 10016`.
    pub title: String,
    /// Why this one; may be empty.
    pub why: String,
}

impl FilmSpan {
    /// What is seen, one sentence.
    #[must_use]
    pub fn sentence(&self) -> String {
        let why = if self.why.is_empty() { String::new() } else { format!(": {}", self.why) };
        format!("worked again, with the active version as its twin: {}{why}", self.title)
    }
}

/// Everything that was kept of one upgrade, in order of virtual time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Recording {
    pub about: About,
    /// How the upgrade ended; absent if the recording was not closed.
    pub outcome: Option<Word<UpgradeEnd>>,
    /// What does not move.
    pub scenery: Scenery,
    /// Moments of the live cell, and of what was worked again ([`Self::films`]). A decimated recording has fewer of them; nothing between two is made up.
    pub pictures: Vec<Picture>,
    pub events: Vec<Event>,
    /// What was charted, by name.
    pub series: Vec<Series>,
    /// Pieces of its evaluation that were worked again, in order.
    #[serde(default)]
    pub films: Vec<FilmSpan>,
    /// Pictures and events that were dropped on the way because the queue was full.
    pub dropped: (u64, u64),
}

impl Recording {
    /// Virtual time of its first and last moment, ms; `None` if it holds none.
    #[must_use]
    pub fn span_ms(&self) -> Option<(u64, u64)> {
        let pictures = self.pictures.iter().map(|picture| picture.at_ms);
        let events = self.events.iter().map(|event| event.at_ms);
        let times = pictures.chain(events);
        times.fold(None, |span, at| {
            Some(span.map_or((at, at), |(first, last): (u64, u64)| (first.min(at), last.max(at))))
        })
    }
}
