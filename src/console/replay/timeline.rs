//! A recording prepared for lookup: its span, the version's state after each event, its gaps, charts and failures.
//!
//! Owns the order: times never go back here, whatever order the file had. Must not interpolate between frames or
//! values.

use super::charts::{self, ChartSection};
use super::failures::Failures;
use super::time_mark::{self, TimeMark};
use super::version_status::{self, VersionStatus};
use holdpoint_protocol::event::{Event, EventKind};
use holdpoint_protocol::video_frame::VideoFrame;
use holdpoint_recordings::recording::{FilmSpan, Recording};

/// The shortest gap, ms of virtual time without a frame or event.
pub const GAP_MS: u64 = 2_000;

/// A recording and the data derived from it.
#[derive(Clone, Debug, PartialEq)]
pub struct Timeline {
    recording: Recording,
    span_ms: (u64, u64),
    statuses: Vec<VersionStatus>,
    marks: Vec<Option<TimeMark>>,
    times_ms: Vec<u64>,
    stretches_ms: Vec<(u64, u64)>,
    groups: Vec<ChartSection>,
    failures: Failures,
}

/// A moment of a recording. Several frames and events may share one millisecond, so each has its own place.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TimelineCursor {
    /// Virtual time of the moment, ms.
    pub at_ms: u64,
    /// The last frame at that moment.
    pub frame: Option<usize>,
    /// The last event at that moment.
    pub event: Option<usize>,
}

impl Timeline {
    /// Sorts a recording and derives its data.
    #[must_use]
    pub fn new(mut recording: Recording) -> Self {
        recording.pictures.sort_by_key(|frame| frame.at_ms);
        recording.events.sort_by_key(|event| event.at_ms);
        for series in &mut recording.series {
            series.points.sort_by_key(|(at_ms, _)| *at_ms);
        }
        let stops = recording.events.iter().filter(|event| stops_playback(&event.kind));
        let mut times_ms: Vec<u64> = stops
            .map(|event| event.at_ms)
            .chain(recording.pictures.iter().map(|frame| frame.at_ms))
            .collect();
        times_ms.sort_unstable();
        times_ms.dedup();
        let marks: Vec<Option<TimeMark>> =
            recording.events.iter().map(|event| time_mark::of(&event.kind)).collect();
        Self {
            span_ms: recording.span_ms().unwrap_or_default(),
            statuses: version_status::after_each(&recording.about.version, &recording.events),
            failures: Failures::of(&recording, &marks),
            marks,
            stretches_ms: stretches_ms(&recording.pictures),
            groups: charts::groups(&recording),
            times_ms,
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

    /// The moments at which the version went wrong.
    #[must_use]
    pub const fn failures(&self) -> &Failures {
        &self.failures
    }

    /// The re-run part at a time; absent in the live cell's time.
    #[must_use]
    pub fn film_at(&self, at_ms: u64) -> Option<&FilmSpan> {
        let films = &self.recording.films;
        films.iter().find(|film| (film.from_ms..=film.until_ms).contains(&at_ms))
    }

    /// Where it went wrong, as far as that concerns a time: the first failure of the re-run there with its text, else
    /// the decision against the version. Virtual ms.
    #[must_use]
    pub fn went_wrong(&self, at_ms: u64) -> Option<(u64, &str)> {
        match self.film_at(at_ms) {
            Some(film) => film.failures.first().map(|failure| (failure.at_ms, failure.text.as_str())),
            None => self.failures.decided_ms().map(|at_ms| (at_ms, "")),
        }
    }

    /// Whether a value past its limit at a time counts against the version: its re-run fails there, or the decision
    /// that follows is against it.
    #[must_use]
    pub fn ends_badly(&self, at_ms: u64) -> bool {
        match self.film_at(at_ms) {
            // A recording of an older build does not tell.
            Some(film) => film.ended.is_empty() || !film.failures.is_empty(),
            None => self.failures.ends_badly(at_ms),
        }
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
    pub fn frame(&self, frame: usize) -> Option<&VideoFrame> {
        self.recording.pictures.get(frame)
    }

    /// The frame after a cursor.
    #[must_use]
    pub fn next_frame(&self, cursor: TimelineCursor) -> Option<&VideoFrame> {
        self.frame(cursor.frame.map_or(0, |frame| frame + 1))
    }

    /// The state of the version at a cursor.
    #[must_use]
    pub fn version_status(&self, cursor: TimelineCursor) -> VersionStatus {
        cursor.event.and_then(|event| self.statuses.get(event)).copied().unwrap_or_default()
    }

    /// The cursor at a time; outside the span, at its nearer end.
    #[must_use]
    pub fn at(&self, at_ms: u64) -> TimelineCursor {
        let at_ms = at_ms.clamp(self.span_ms.0, self.span_ms.1);
        let frames = self.recording.pictures.partition_point(|frame| frame.at_ms <= at_ms);
        let events = self.recording.events.partition_point(|event| event.at_ms <= at_ms);
        TimelineCursor { at_ms, frame: frames.checked_sub(1), event: events.checked_sub(1) }
    }

    /// The cursor on a frame.
    #[must_use]
    pub fn on_frame(&self, frame: usize) -> Option<TimelineCursor> {
        let at = self.at(self.frame(frame)?.at_ms);
        Some(TimelineCursor { frame: Some(frame), ..at })
    }

    /// The cursor on an event.
    #[must_use]
    pub fn on_event(&self, event: usize) -> Option<TimelineCursor> {
        let at = self.at(self.event(event)?.at_ms);
        Some(TimelineCursor { event: Some(event), ..at })
    }

    /// The first time after `at_ms` with a frame or event, ms.
    #[must_use]
    pub fn next_time_ms(&self, at_ms: u64) -> Option<u64> {
        let next = self.times_ms.partition_point(|time_ms| *time_ms <= at_ms);
        self.times_ms.get(next).copied()
    }

    /// The last time up to `at_ms` with a frame or event, ms.
    #[must_use]
    pub fn last_time_ms(&self, at_ms: u64) -> Option<u64> {
        let next = self.times_ms.partition_point(|time_ms| *time_ms <= at_ms);
        next.checked_sub(1).and_then(|last| self.times_ms.get(last)).copied()
    }

    /// The gap round a cursor, if it is in one: both ends, ms.
    #[must_use]
    pub fn gap_ms(&self, cursor: TimelineCursor) -> Option<(u64, u64)> {
        let begins = cursor.frame.and_then(|frame| self.frame(frame));
        let begins_ms = begins.map_or(self.span_ms.0, |frame| frame.at_ms);
        let ends_ms = self.next_frame(cursor).map_or(self.span_ms.1, |frame| frame.at_ms);
        // A fresh frame is in no gap.
        let is_seen = begins.is_some() && cursor.at_ms.saturating_sub(begins_ms) <= super::FRESH_MS;
        (!is_seen && ends_ms.saturating_sub(begins_ms) > GAP_MS).then_some((begins_ms, ends_ms))
    }
}

fn stretches_ms(frames: &[VideoFrame]) -> Vec<(u64, u64)> {
    let joined = |a: &VideoFrame, b: &VideoFrame| b.at_ms.saturating_sub(a.at_ms) <= GAP_MS;
    let ends = |stretch: &[VideoFrame]| Some((stretch.first()?.at_ms, stretch.last()?.at_ms));
    frames.chunk_by(joined).filter_map(ends).collect()
}

/// Whether playing stops at an event on its way through a gap. Progress counts by its end.
const fn stops_playback(kind: &EventKind) -> bool {
    !matches!(kind, EventKind::Progress { .. } | EventKind::Pace { .. })
}
