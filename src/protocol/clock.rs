//! Time as the engine knows it: virtual milliseconds that never go back.
//!
//! In a script the clock moves by what was simulated and jumps to the next deadline when nothing
//! is left to do; at a console it follows the machine's monotonic clock.

use std::time::Instant;

use holdpoint_body::RATE_HZ;

/// Ticks of the cell in a second.
pub const TICKS_PER_SECOND: u64 = RATE_HZ as u64;

/// Virtual time in ticks of the cell.
#[must_use]
pub fn tick_of(at_ms: u64) -> u64 {
    at_ms.saturating_mul(TICKS_PER_SECOND) / 1000
}

/// The virtual time in which so many ticks have passed, ms. Rounded up: a clock that moves on by it is never behind who
/// counted the ticks, so that `tick_of(ms_of(ticks)) >= ticks`.
#[must_use]
pub const fn ms_of(ticks: u64) -> u64 {
    ticks.saturating_mul(1000).div_ceil(TICKS_PER_SECOND)
}

/// What moves virtual time: the work of a script, or the machine's clock.
#[derive(Clone, Debug)]
pub enum Clock {
    /// Moved by the engine, by the simulated work it has done.
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
    /// A clock for scripts, which stands still until it is moved.
    #[must_use]
    pub const fn scripted(from_ms: u64) -> Self {
        Self::Virtual { now_ms: from_ms }
    }

    /// A clock that follows real time.
    #[must_use]
    pub fn real(from_ms: u64) -> Self {
        Self::Real { from_ms, since: Instant::now() }
    }

    /// Whether a script moves it.
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

    /// Simulated work took this long; real time passes by itself.
    pub const fn advance(&mut self, by_ms: u64) {
        if let Self::Virtual { now_ms } = self {
            *now_ms = now_ms.saturating_add(by_ms);
        }
    }

    /// Nothing is left to do before `at_ms`: a script's clock jumps there. Tells whether it moved.
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moved_on_by_what_was_counted_it_is_not_behind_the_count() {
        for from_ms in 0..20 {
            for ticks in 0..2_000 {
                let after = tick_of(from_ms + ms_of(ticks));
                assert!(after >= tick_of(from_ms) + ticks, "{ticks} ticks from {from_ms} ms on: {after}");
            }
        }
    }

    #[test]
    fn never_goes_back() {
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
