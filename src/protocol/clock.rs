//! Time as the engine knows it: virtual milliseconds that never go back.
//!
//! In a script the clock advances with the simulation and jumps to the next deadline when no work is left; at a console
//! it follows the machine's monotonic clock.

use std::time::Instant;

use holdpoint_body::RATE_HZ;
use holdpoint_governance::wall_time::WallTime;

use super::snapshot::Snapshot;

/// Ticks of the cell in a second.
pub const TICKS_PER_SECOND: u64 = RATE_HZ as u64;

/// Virtual time in ticks of the cell.
#[must_use]
pub fn tick_of(at_ms: u64) -> u64 {
    at_ms.saturating_mul(TICKS_PER_SECOND) / 1000
}

/// The virtual time of `ticks` ticks, ms. Rounded up, so that a clock advanced by it is never behind a tick counter:
/// `tick_of(ms_of(ticks)) >= ticks`.
#[must_use]
pub const fn ms_of(ticks: u64) -> u64 {
    ticks.saturating_mul(1000).div_ceil(TICKS_PER_SECOND)
}

/// The source of virtual time: the work of a script, or the machine's clock.
#[derive(Clone, Debug)]
pub enum Clock {
    /// Advanced by the engine with its simulated work.
    Virtual {
        /// Virtual time now, ms.
        now_ms: u64,
    },
    /// Follows the monotonic clock from a starting point.
    Real {
        /// Virtual time at the start, ms.
        from_ms: u64,
        /// The machine's monotonic time at the start.
        since: Instant,
    },
}

impl Clock {
    /// A clock for scripts, which advances only on request.
    #[must_use]
    pub const fn scripted(from_ms: u64) -> Self {
        Self::Virtual { now_ms: from_ms }
    }

    /// A clock that follows real time.
    #[must_use]
    pub fn real(from_ms: u64) -> Self {
        Self::Real { from_ms, since: Instant::now() }
    }

    /// Whether a script advances it.
    #[must_use]
    pub const fn is_scripted(&self) -> bool {
        matches!(self, Self::Virtual { .. })
    }

    /// Virtual time now, ms; never less than at an earlier call.
    #[must_use]
    pub fn now_ms(&self) -> u64 {
        match self {
            Self::Virtual { now_ms } => *now_ms,
            Self::Real { from_ms, since } => {
                let passed = u64::try_from(since.elapsed().as_millis()).unwrap_or(u64::MAX);
                from_ms.saturating_add(passed)
            }
        }
    }

    /// Advances a script's clock by simulated work; real time advances by itself.
    pub const fn advance(&mut self, by_ms: u64) {
        if let Self::Virtual { now_ms } = self {
            *now_ms = now_ms.saturating_add(by_ms);
        }
    }

    /// Jumps a script's clock to `at_ms`, because no work is left before; returns whether it moved.
    pub const fn jump_to(&mut self, at_ms: u64) -> bool {
        match self {
            Self::Virtual { now_ms } if *now_ms < at_ms => {
                *now_ms = at_ms;
                true
            }
            _ => false,
        }
    }
}

/// Virtual time as hours, minutes and seconds since the store began: `00:12:41`.
#[must_use]
pub fn clock_time(at_ms: u64) -> String {
    let secs = at_ms / 1000;
    format!("{:02}:{:02}:{:02}", secs / 3600, secs / 60 % 60, secs % 60)
}

/// A wall time as hours, minutes and seconds of its day, UTC.
#[must_use]
pub fn time_of_day(wall_ms: i64) -> String {
    let secs = wall_ms.div_euclid(1_000).rem_euclid(86_400);
    format!("{:02}:{:02}:{:02}", secs / 3_600, secs / 60 % 60, secs % 60)
}

impl Snapshot {
    /// A moment of virtual time as a time of day, `18:31:56`. Virtual time stands while no engine runs: a moment before this
    /// engine came up is only known to be before that, `before 18:00:02`. Virtual time where the engine reports no other.
    #[must_use]
    pub fn moment(&self, at_ms: u64) -> String {
        let (Some(wall_ms), Some(up_since_ms)) = (self.wall_ms, self.up_since_ms) else {
            return clock_time(at_ms);
        };
        let known_ms = at_ms.max(up_since_ms);
        // An event may be newer than the snapshot.
        let [ago_ms, ahead_ms] = [self.at_ms.saturating_sub(known_ms), known_ms.saturating_sub(self.at_ms)]
            .map(|ms| i64::try_from(ms).unwrap_or(i64::MAX));
        let time = time_of_day(wall_ms.saturating_sub(ago_ms).saturating_add(ahead_ms));
        if at_ms < up_since_ms { format!("before {time}") } else { time }
    }

    /// As [`Self::moment`], for what is on record with its wall time: that is known for a moment before this engine, too.
    #[must_use]
    pub fn recorded_moment(&self, at_ms: u64, wall: Option<WallTime>) -> String {
        let is_earlier = self.up_since_ms.is_some_and(|up_since_ms| at_ms < up_since_ms);
        wall.filter(|_| is_earlier).map_or_else(|| self.moment(at_ms), WallTime::label)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clock_advanced_by_counted_ticks_is_not_behind_them() {
        for from_ms in 0..20 {
            for ticks in 0..2_000 {
                let after = tick_of(from_ms + ms_of(ticks));
                assert!(after >= tick_of(from_ms) + ticks, "{ticks} ticks from {from_ms} ms on: {after}");
            }
        }
    }

    #[test]
    fn virtual_clock_never_goes_back() {
        let mut clock = Clock::scripted(100);
        clock.advance(50);
        assert!(!clock.jump_to(120));
        assert_eq!(clock.now_ms(), 150);
        assert!(clock.jump_to(200));
        assert_eq!(clock.now_ms(), 200);
        let mut real = Clock::real(7);
        assert!(!real.jump_to(u64::MAX));
        assert!(real.now_ms() >= 7);
    }
}
