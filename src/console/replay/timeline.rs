//! A recording prepared for lookup: its span, the version's state after each event, its gaps and its charts.
//!
//! Owns the order: times never go back here, whatever order the file had. Must not interpolate between frames or
//! values.

use super::charts::{self, ChartSection};
use super::time_mark::{self, TimeMark};
use super::version_status::{self, VersionStatus};
use holdpoint_protocol::event::{Event, EventKind};
use holdpoint_protocol::video_frame::VideoFrame;
use holdpoint_recordings::recording::Recording;

/// The shortest gap, ms of virtual time without a frame or event.
pub const GAP_MS: u64 = 2_000;

/// A recording and the data derived from it.
#[derive(Clone, Debug, PartialEq)]
pub struct Timeline {
    recording: Recording,
    span_ms: (u64, u64),
    standings: Vec<VersionStatus>,
    marks: Vec<Option<TimeMark>>,
    moments_ms: Vec<u64>,
    stretches_ms: Vec<(u64, u64)>,
    groups: Vec<ChartSection>,
}

/// A moment of a recording. Several frames and events may share one millisecond, so each has its own place.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TimelineCursor {
    /// Virtual time of the moment, ms.
    pub at_ms: u64,
    /// The last frame at that moment.
    pub picture: Option<usize>,
    /// The last event at that moment.
    pub event: Option<usize>,
}

impl Timeline {
    /// Sorts a recording and derives its data.
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
            standings: version_status::after_each(&recording.about.version, &recording.events),
            marks: recording.events.iter().map(|event| time_mark::of(&event.kind)).collect(),
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
    pub fn groups(&self) -> &[ChartSection] {
        &self.groups
    }

    /// Stretches of frames without a gap: first and last frame, ms.
    #[must_use]
    pub fn stretches_ms(&self) -> &[(u64, u64)] {
        &self.stretches_ms
    }

    /// The marks of events on the time bar: virtual time, ms, and mark, in order.
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
    pub fn picture(&self, picture: usize) -> Option<&VideoFrame> {
        self.recording.pictures.get(picture)
    }

    /// The frame after a cursor.
    #[must_use]
    pub fn next_picture(&self, cursor: TimelineCursor) -> Option<&VideoFrame> {
        self.picture(cursor.picture.map_or(0, |picture| picture + 1))
    }

    /// The state of the version at a cursor.
    #[must_use]
    pub fn version_status(&self, cursor: TimelineCursor) -> VersionStatus {
        cursor.event.and_then(|event| self.standings.get(event)).copied().unwrap_or_default()
    }

    /// The cursor at a time; outside the span, at its nearer end.
    #[must_use]
    pub fn at(&self, at_ms: u64) -> TimelineCursor {
        let at_ms = at_ms.clamp(self.span_ms.0, self.span_ms.1);
        let pictures = self.recording.pictures.partition_point(|picture| picture.at_ms <= at_ms);
        let events = self.recording.events.partition_point(|event| event.at_ms <= at_ms);
        TimelineCursor { at_ms, picture: pictures.checked_sub(1), event: events.checked_sub(1) }
    }

    /// The cursor on a frame.
    #[must_use]
    pub fn on_picture(&self, picture: usize) -> Option<TimelineCursor> {
        let at = self.at(self.picture(picture)?.at_ms);
        Some(TimelineCursor { picture: Some(picture), ..at })
    }

    /// The cursor on an event.
    #[must_use]
    pub fn on_event(&self, event: usize) -> Option<TimelineCursor> {
        let at = self.at(self.event(event)?.at_ms);
        Some(TimelineCursor { event: Some(event), ..at })
    }

    /// The first time after `at_ms` with a frame or event, ms.
    #[must_use]
    pub fn next_moment_ms(&self, at_ms: u64) -> Option<u64> {
        let next = self.moments_ms.partition_point(|moment_ms| *moment_ms <= at_ms);
        self.moments_ms.get(next).copied()
    }

    /// The last time up to `at_ms` with a frame or event, ms.
    #[must_use]
    pub fn last_moment_ms(&self, at_ms: u64) -> Option<u64> {
        let next = self.moments_ms.partition_point(|moment_ms| *moment_ms <= at_ms);
        next.checked_sub(1).and_then(|last| self.moments_ms.get(last)).copied()
    }

    /// The gap round a cursor, if it is in one: both ends, ms.
    #[must_use]
    pub fn gap_ms(&self, cursor: TimelineCursor) -> Option<(u64, u64)> {
        let begins = cursor.picture.and_then(|picture| self.picture(picture));
        let begins_ms = begins.map_or(self.span_ms.0, |picture| picture.at_ms);
        let ends_ms = self.next_picture(cursor).map_or(self.span_ms.1, |picture| picture.at_ms);
        // A fresh frame is in no gap.
        let is_seen = begins.is_some() && cursor.at_ms.saturating_sub(begins_ms) <= super::FRESH_MS;
        (!is_seen && ends_ms.saturating_sub(begins_ms) > GAP_MS).then_some((begins_ms, ends_ms))
    }
}

fn stretches_ms(pictures: &[VideoFrame]) -> Vec<(u64, u64)> {
    let joined = |a: &VideoFrame, b: &VideoFrame| b.at_ms.saturating_sub(a.at_ms) <= GAP_MS;
    let ends = |stretch: &[VideoFrame]| Some((stretch.first()?.at_ms, stretch.last()?.at_ms));
    pictures.chunk_by(joined).filter_map(ends).collect()
}

/// Whether playing stops at an event on its way through a gap. Progress counts by its end.
const fn is_telling(kind: &EventKind) -> bool {
    !matches!(kind, EventKind::Progress { .. } | EventKind::Pace { .. })
}
