//! A recording made ready to be looked up: its span, how the version stood after each event, what may be skipped,
//! and its charts.
//!
//! Owns the order: whatever order the file had, times never go back here. Must not make anything up between two
//! pictures or two values.

use super::charts::{self, Group};
use super::mark::{self, TimeMark};
use super::standing::{self, VersionStanding};
use holdpoint_protocol::event::{Event, EventKind};
use holdpoint_protocol::picture::Picture;
use holdpoint_recordings::recording::Recording;

/// A stretch of this length without anything to see is a gap, ms of virtual time.
pub const GAP_MS: u64 = 2_000;

/// A recording and what follows from it.
#[derive(Clone, Debug, PartialEq)]
pub struct Timeline {
    recording: Recording,
    span_ms: (u64, u64),
    standings: Vec<VersionStanding>,
    marks: Vec<Option<TimeMark>>,
    moments_ms: Vec<u64>,
    stretches_ms: Vec<(u64, u64)>,
    groups: Vec<Group>,
}

/// A moment of a recording. Several pictures and events may share one millisecond, so each has its own place.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Cursor {
    /// Virtual time of the moment, ms.
    pub at_ms: u64,
    /// The picture that was the last one then.
    pub picture: Option<usize>,
    /// The event that was the last one then.
    pub event: Option<usize>,
}

impl Timeline {
    /// Sorts a recording and looks it through once.
    #[must_use]
    pub fn new(mut recording: Recording) -> Self {
        recording.pictures.sort_by_key(|picture| picture.at_ms);
        recording.events.sort_by_key(|event| event.at_ms);
        for series in &mut recording.series {
            series.points.sort_by_key(|(at_ms, _)| *at_ms);
        }
        let telling = recording.events.iter().filter(|event| is_telling(&event.kind));
        let mut moments_ms: Vec<u64> = telling
            .map(|event| event.at_ms)
            .chain(recording.pictures.iter().map(|picture| picture.at_ms))
            .collect();
        moments_ms.sort_unstable();
        moments_ms.dedup();
        Self {
            span_ms: recording.span_ms().unwrap_or_default(),
            standings: standing::after_each(&recording.about.version, &recording.events),
            marks: recording.events.iter().map(|event| mark::of(&event.kind)).collect(),
            stretches_ms: stretches_ms(&recording.pictures),
            groups: charts::groups(&recording),
            moments_ms,
            recording,
        }
    }

    /// The recording, in order of time.
    #[must_use]
    pub const fn recording(&self) -> &Recording {
        &self.recording
    }

    /// Virtual time of its first and last moment, ms.
    #[must_use]
    pub const fn span_ms(&self) -> (u64, u64) {
        self.span_ms
    }

    /// Its charts in groups.
    #[must_use]
    pub fn groups(&self) -> &[Group] {
        &self.groups
    }

    /// Stretches in which pictures follow each other without a gap: first and last picture, ms.
    #[must_use]
    pub fn stretches_ms(&self) -> &[(u64, u64)] {
        &self.stretches_ms
    }

    /// How events are marked on the time bar: virtual time, ms, and mark, in order.
    pub fn marks(&self) -> impl Iterator<Item = (u64, TimeMark)> {
        let marked = self.recording.events.iter().zip(&self.marks);
        marked.filter_map(|(event, mark)| mark.map(|mark| (event.at_ms, mark)))
    }

    /// The mark of an event.
    #[must_use]
    pub fn mark(&self, event: usize) -> Option<TimeMark> {
        self.marks.get(event).copied().flatten()
    }

    #[must_use]
    pub fn event(&self, event: usize) -> Option<&Event> {
        self.recording.events.get(event)
    }

    #[must_use]
    pub fn picture(&self, picture: usize) -> Option<&Picture> {
        self.recording.pictures.get(picture)
    }

    /// The picture after a cursor.
    #[must_use]
    pub fn next_picture(&self, cursor: Cursor) -> Option<&Picture> {
        self.picture(cursor.picture.map_or(0, |picture| picture + 1))
    }

    /// How the version stood at a cursor.
    #[must_use]
    pub fn standing(&self, cursor: Cursor) -> VersionStanding {
        cursor.event.and_then(|event| self.standings.get(event)).copied().unwrap_or_default()
    }

    /// The cursor at a time; outside the span, at its nearer end.
    #[must_use]
    pub fn at(&self, at_ms: u64) -> Cursor {
        let at_ms = at_ms.clamp(self.span_ms.0, self.span_ms.1);
        let pictures = self.recording.pictures.partition_point(|picture| picture.at_ms <= at_ms);
        let events = self.recording.events.partition_point(|event| event.at_ms <= at_ms);
        Cursor { at_ms, picture: pictures.checked_sub(1), event: events.checked_sub(1) }
    }

    /// The cursor on a picture.
    #[must_use]
    pub fn on_picture(&self, picture: usize) -> Option<Cursor> {
        let at = self.at(self.picture(picture)?.at_ms);
        Some(Cursor { picture: Some(picture), ..at })
    }

    /// The cursor on an event.
    #[must_use]
    pub fn on_event(&self, event: usize) -> Option<Cursor> {
        let at = self.at(self.event(event)?.at_ms);
        Some(Cursor { event: Some(event), ..at })
    }

    /// The first time after `at_ms` at which there is something to see, ms.
    #[must_use]
    pub fn next_moment_ms(&self, at_ms: u64) -> Option<u64> {
        let next = self.moments_ms.partition_point(|moment_ms| *moment_ms <= at_ms);
        self.moments_ms.get(next).copied()
    }

    /// The last time up to `at_ms` at which there was something to see, ms.
    #[must_use]
    pub fn last_moment_ms(&self, at_ms: u64) -> Option<u64> {
        let next = self.moments_ms.partition_point(|moment_ms| *moment_ms <= at_ms);
        next.checked_sub(1).and_then(|last| self.moments_ms.get(last)).copied()
    }

    /// The stretch round a cursor in which no picture was kept, if it is a gap: its two ends, ms.
    #[must_use]
    pub fn gap_ms(&self, cursor: Cursor) -> Option<(u64, u64)> {
        let begins = cursor.picture.and_then(|picture| self.picture(picture));
        let begins_ms = begins.map_or(self.span_ms.0, |picture| picture.at_ms);
        let ends_ms = self.next_picture(cursor).map_or(self.span_ms.1, |picture| picture.at_ms);
        // A picture that is there to be seen is in no gap.
        let is_seen = begins.is_some() && cursor.at_ms.saturating_sub(begins_ms) <= super::FRESH_MS;
        (!is_seen && ends_ms.saturating_sub(begins_ms) > GAP_MS).then_some((begins_ms, ends_ms))
    }
}

fn stretches_ms(pictures: &[Picture]) -> Vec<(u64, u64)> {
    let joined = |a: &Picture, b: &Picture| b.at_ms.saturating_sub(a.at_ms) <= GAP_MS;
    let ends = |stretch: &[Picture]| Some((stretch.first()?.at_ms, stretch.last()?.at_ms));
    pictures.chunk_by(joined).filter_map(ends).collect()
}

/// Whether playing stops at an event on its way through a gap. Progress is told by its end.
const fn is_telling(kind: &EventKind) -> bool {
    !matches!(kind, EventKind::Progress { .. } | EventKind::Pace { .. })
}
