//! Health over time: live tasks from record and telemetry as a time series, also beside a running engine.
//!
//! Reads and computes; changes and judges nothing. The cost of a query is bounded: from a span with more telemetry, evenly
//! spread blocks are read, and the answer contains both counts. Every batch is compared with the digest in the chain; a
//! differing one counts nowhere.

mod alarms;
mod clock;
mod export;
mod marks;
mod tasks;

use std::borrow::Cow;
use std::collections::BTreeMap;

use holdpoint_protocol::health::{HealthClock, HealthCoverage, HealthQuery, HealthSeries};
use holdpoint_store::{ReadableStore, RecordViews, StoreError, TelemetryReader};
use holdpoint_text::{ErrorDetails, ErrorReason, Hint};
use holdpoint_wording::health::NO_MACHINE_TIME;

use self::clock::RecordSpan;

pub use self::export::{csv, svg};
pub use self::tasks::TASKS_READ;

/// Why there is no answer.
#[derive(Debug, thiserror::Error)]
pub enum HealthError {
    /// Record or telemetry cannot be read.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// The query is not valid.
    #[error("{0}")]
    InvalidQuery(String),
}

impl Hint for HealthError {
    fn details(&self) -> Option<ErrorDetails> {
        match self {
            Self::Store(error) => error.details(),
            Self::InvalidQuery(_) => Some(ErrorReason::Usage.into()),
        }
    }

    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Store(error) => error.hint(),
            Self::InvalidQuery(_) => None,
        }
    }
}

/// The present time of a running engine, which may be later than the last record.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PresentTime {
    /// Virtual time, ms.
    pub at_ms: u64,
    /// The machine's time, ms since 1970; absent in scripts.
    pub wall_ms: Option<i64>,
}

/// The parts of a store that answers need.
pub struct HealthReader {
    views: Box<dyn RecordViews>,
    telemetry: Option<Box<dyn TelemetryReader>>,
}

impl HealthReader {
    /// The record, opened as the caller needs it, and the telemetry, if there is any.
    #[must_use]
    pub fn new(views: Box<dyn RecordViews>, telemetry: Option<Box<dyn TelemetryReader>>) -> Self {
        Self { views, telemetry }
    }

    /// As [`Self::new`], for a store that a running engine has verified.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn open(reader: &dyn ReadableStore) -> Result<Self, StoreError> {
        Ok(Self::new(reader.views()?, reader.telemetry()?))
    }

    /// The end of the record: without a running engine, this is the end of what can be queried.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn end(&self) -> Result<PresentTime, StoreError> {
        let head = self.views.head()?;
        let wall_ms = self.views.stamp(head.seq)?.and_then(|stamp| stamp.wall_ms);
        Ok(PresentTime { at_ms: head.at_ms, wall_ms })
    }

    /// The answer. `present` is the present time of the running engine; absent if none runs.
    ///
    /// # Errors
    /// [`HealthError`].
    pub fn read(
        &self,
        query: &HealthQuery,
        present: Option<PresentTime>,
    ) -> Result<HealthSeries, HealthError> {
        self.read_bounded(query, present, TASKS_READ)
    }

    /// As [`Self::read`], with no bound on the telemetry read.
    ///
    /// # Errors
    /// As [`Self::read`].
    pub fn read_every_task(
        &self,
        query: &HealthQuery,
        present: Option<PresentTime>,
    ) -> Result<HealthSeries, HealthError> {
        self.read_bounded(query, present, u64::MAX)
    }

    fn read_bounded(
        &self,
        query: &HealthQuery,
        present: Option<PresentTime>,
        tasks_read: u64,
    ) -> Result<HealthSeries, HealthError> {
        if let Some(problem) = query.problem() {
            return Err(HealthError::InvalidQuery(problem));
        }
        let end = self.end()?;
        let now = present.unwrap_or(end);
        let clock = query.clock.unwrap_or(if now.wall_ms.is_some() {
            HealthClock::Wall
        } else {
            HealthClock::Virtual
        });
        let now_ms = match clock {
            HealthClock::Virtual => i64::try_from(now.at_ms).unwrap_or(i64::MAX),
            HealthClock::Wall => {
                now.wall_ms.ok_or_else(|| HealthError::InvalidQuery(NO_MACHINE_TIME.to_owned()))?
            }
        };
        let width = i64::try_from(query.bucket_ms).unwrap_or(i64::MAX);
        let until_ms = query
            .until_ms
            .unwrap_or_else(|| now_ms.div_euclid(width).saturating_add(1).saturating_mul(width));
        let from_ms = until_ms.saturating_sub(width.saturating_mul(i64::from(query.buckets)));
        let mut coverage = HealthCoverage::default();
        let mut series = HealthSeries {
            clock,
            from_ms,
            bucket_ms: query.bucket_ms,
            buckets: u32::from(query.buckets),
            last_at_ms: end.at_ms,
            last_wall_ms: end.wall_ms,
            points: Vec::new(),
            marks: Vec::new(),
            alarms: Vec::new(),
            coverage,
            unsealed: BTreeMap::new(),
        };
        let span = RecordSpan::find(&*self.views, clock, from_ms, until_ms)?;
        series.alarms = alarms::read(&*self.views, &span, &mut coverage)?;
        if query.only_alarms {
            series.coverage = coverage;
            return Ok(series);
        }
        if let Some(telemetry) = &self.telemetry {
            series.points =
                tasks::points(&*self.views, &**telemetry, (&span, &series), &mut coverage, tasks_read)?;
            // The newest tasks belong to a span that reaches the end of the record.
            if span.after > span.head {
                series.unsealed = tasks::unsealed(&*self.views, &**telemetry)?;
            }
        }
        let mut marks = marks::read(&*self.views, &span, &mut coverage)?;
        marks.extend(marks::of_alarms(&span, &series.alarms));
        series.marks = marks::bounded(marks, &span, &mut coverage);
        series.coverage = coverage;
        Ok(series)
    }
}

#[cfg(test)]
mod tests;
