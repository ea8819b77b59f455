//! Maps a time span to the records written in it, without reading their bodies.
//!
//! The clocks of engine and machine advance together while an engine runs. Where the machine's clock advances alone, no engine
//! runs or the machine sleeps.

use holdpoint_protocol::health::HealthClock;
use holdpoint_store::{RecordTime, RecordViews, StoreError};

/// The smallest advance of the machine's clock alone that counts as a gap, ms.
const ALONE_MS: i64 = 2_000;

/// The most gaps searched for.
const GAPS_MAX: usize = 200;

/// The most records read to find them.
const LOOKS_MAX: usize = 20_000;

/// The records of a time span.
#[derive(Clone, Copy, Debug)]
pub(super) struct RecordSpan {
    pub(super) clock: HealthClock,
    /// On that clock, ms; the end is exclusive.
    pub(super) from_ms: i64,
    pub(super) until_ms: i64,
    /// The first record within.
    pub(super) first: u64,
    /// The first record after.
    pub(super) after: u64,
    /// The last record there is.
    pub(super) head: u64,
}

/// A record's place on a clock, ms; absent where it has none.
pub(super) fn on_clock(clock: HealthClock, at_ms: u64, wall_ms: Option<i64>) -> Option<i64> {
    match clock {
        HealthClock::Virtual => i64::try_from(at_ms).ok(),
        HealthClock::Wall => wall_ms,
    }
}

impl RecordSpan {
    /// Finds the records by bisection: both clocks advance with the chain.
    pub(super) fn find(
        views: &dyn RecordViews,
        clock: HealthClock,
        from_ms: i64,
        until_ms: i64,
    ) -> Result<Self, StoreError> {
        let head = views.head()?.seq;
        let first = Self::first_at(views, clock, head, from_ms)?;
        let after = Self::first_at(views, clock, head, until_ms)?;
        Ok(Self { clock, from_ms, until_ms, first, after, head })
    }

    /// The first record at or after a moment; one after the last if there is none.
    pub(super) fn first_at(
        views: &dyn RecordViews,
        clock: HealthClock,
        head: u64,
        time_ms: i64,
    ) -> Result<u64, StoreError> {
        let (mut low, mut high) = (1, head + 1);
        while low < high {
            let middle = low + (high - low) / 2;
            let stamp = views.stamp(middle)?;
            // A record without a time on this clock is from a script, before all others.
            let place = stamp.and_then(|stamp| on_clock(clock, stamp.at_ms, stamp.wall_ms));
            if place.is_none_or(|place| place < time_ms) {
                low = middle + 1;
            } else {
                high = middle;
            }
        }
        Ok(low)
    }

    pub(super) const fn contains(&self, on_clock_ms: i64) -> bool {
        self.from_ms <= on_clock_ms && on_clock_ms < self.until_ms
    }
}

/// The gaps in which the machine's clock advanced alone: the first record afterward and the length, ms. A backward step is
/// not a gap.
pub(super) fn gaps(views: &dyn RecordViews, span: &RecordSpan) -> Result<Vec<(RecordTime, i64)>, StoreError> {
    let mut found = Vec::new();
    // Includes the record before the span: a gap before the first record within belongs to this span.
    let (first, last) = (span.first.saturating_sub(1).max(1), span.after.min(span.head));
    let (Some(first), Some(last)) = (views.stamp(first)?, views.stamp(last)?) else { return Ok(found) };
    let mut looks = LOOKS_MAX;
    let mut open = vec![(first, last)];
    while let Some((one, other)) = open.pop() {
        let ahead = |stamp: RecordTime| Some(stamp.wall_ms?.saturating_sub(i64::try_from(stamp.at_ms).ok()?));
        let (Some(before), Some(after)) = (ahead(one), ahead(other)) else { continue };
        let alone_ms = after.saturating_sub(before);
        if alone_ms < ALONE_MS || other.seq <= one.seq || found.len() >= GAPS_MAX || looks == 0 {
            continue;
        }
        if other.seq == one.seq + 1 {
            found.push((other, alone_ms));
            continue;
        }
        looks -= 1;
        let Some(middle) = views.stamp(one.seq + (other.seq - one.seq) / 2)? else { continue };
        // The later half is visited last, so that reversing the result sorts it.
        open.push((one, middle));
        open.push((middle, other));
    }
    found.sort_by_key(|(stamp, _)| stamp.seq);
    Ok(found)
}
