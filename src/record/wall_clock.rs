//! The machine's clock, which ends approvers' deadlines, and its mismatch.
//!
//! A script has its own wall clock, which advances with its engine's clock from a fixed moment. The rules decide when there is
//! a mismatch ([`holdpoint_governance::wall_time`]); this module reads the clocks and stores the last trusted reading.

use std::fs::File;
use std::io::Read as _;
use std::time::{SystemTime, UNIX_EPOCH};

use holdpoint_governance::wall_time::{
    ClockMismatch, ClockReading, WallTime, clock_mismatch, time_for_deadlines,
};
use rustix::time::{ClockId, clock_gettime};
use serde::{Deserialize, Serialize};

/// The machine's two clocks.
pub trait Clocks: Send {
    /// Reads both at the same moment.
    fn read(&self) -> ClockReading;

    /// Names the start of the machine since which one of them counts; empty where the system does not.
    fn boot(&self) -> String;
}

/// The clocks of this machine.
pub struct SystemClocks;

impl Clocks for SystemClocks {
    fn read(&self) -> ClockReading {
        let since = clock_gettime(ClockId::Boottime);
        let boot_ms = since.tv_sec.saturating_mul(1_000).saturating_add(since.tv_nsec / 1_000_000);
        ClockReading {
            // A clock before 1970 is behind every record.
            wall: wall_now().unwrap_or_default(),
            boot_ms: u64::try_from(boot_ms).unwrap_or(0),
        }
    }

    fn boot(&self) -> String {
        let mut id = String::new();
        let read = File::open("/proc/sys/kernel/random/boot_id")
            .and_then(|file| file.take(BOOT_ID_BYTES_MAX).read_to_string(&mut id));
        read.map(|_| id.trim().to_owned()).unwrap_or_default()
    }
}

/// The most bytes read of the name of a start; it has 36.
const BOOT_ID_BYTES_MAX: u64 = 64;

/// A trusted reading in the chain. The next engine compares its clocks with it, unless the machine restarted.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TrustedClockReading {
    /// The start of the machine.
    boot: String,
    boot_ms: u64,
    wall: WallTime,
}

/// The time of the machine's clock; `None` before 1970.
#[must_use]
pub fn wall_now() -> Option<WallTime> {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).ok()?;
    i64::try_from(since.as_millis()).ok().map(WallTime::from_ms)
}

/// See the module comment.
pub struct WallClock(ClockSource);

enum ClockSource {
    /// A script's: its time when the engine's clock is 0.
    Script(WallTime),
    Machine {
        clocks: Box<dyn Clocks>,
        /// The trusted reading: the engine's first, or the one that a person confirmed.
        believed: ClockReading,
        /// The latest wall time in the chain since a person last confirmed the time.
        newest_record: WallTime,
        /// The profile's limit, s.
        jump_max_s: f64,
        /// The mismatch, until a person confirms the time.
        doubt: Option<ClockMismatch>,
    },
}

impl WallClock {
    /// A script's clock, behind neither time of the store's newest record.
    #[must_use]
    pub fn scripted(at_ms: u64, newest_record: Option<WallTime>) -> Self {
        let at_zero = newest_record.map_or(0, |time| time.ms().saturating_sub_unsigned(at_ms));
        Self(ClockSource::Script(WallTime::SCRIPT_EPOCH.max(WallTime::from_ms(at_zero))))
    }

    /// The machine's clock, for an engine that starts on a store whose newest record has this time. `jump_max_s`: the profile's.
    #[must_use]
    pub fn of_machine(clocks: Box<dyn Clocks>, newest_record: Option<WallTime>, jump_max_s: f64) -> Self {
        let believed = clocks.read();
        let newest_record = newest_record.unwrap_or_default();
        Self(ClockSource::Machine { clocks, believed, newest_record, jump_max_s, doubt: None })
    }

    /// The time that deadlines are compared with, when the engine's clock is at `at_ms`.
    #[must_use]
    pub fn now(&self, at_ms: u64) -> WallTime {
        match &self.0 {
            ClockSource::Script(at_zero) => at_zero.plus_ms(at_ms),
            ClockSource::Machine { clocks, believed, newest_record, .. } => {
                let now = clocks.read();
                time_for_deadlines(believed, &now, *newest_record, self.clock_mismatch_at(&now).is_some())
            }
        }
    }

    /// The time of the machine's clock, even with a mismatch; `None` in a script.
    #[must_use]
    pub fn machine_time(&self) -> Option<WallTime> {
        match &self.0 {
            ClockSource::Script(_) => None,
            ClockSource::Machine { clocks, .. } => Some(clocks.read().wall),
        }
    }

    /// The present mismatch.
    #[must_use]
    pub fn clock_mismatch(&self) -> Option<ClockMismatch> {
        match &self.0 {
            ClockSource::Script(_) => None,
            ClockSource::Machine { clocks, .. } => self.clock_mismatch_at(&clocks.read()),
        }
    }

    fn clock_mismatch_at(&self, now: &ClockReading) -> Option<ClockMismatch> {
        match &self.0 {
            ClockSource::Script(_) => None,
            ClockSource::Machine { believed, newest_record, jump_max_s, doubt, .. } => {
                doubt.or_else(|| clock_mismatch(believed, now, *newest_record, *jump_max_s))
            }
        }
    }

    /// The trusted reading, for the chain; `None` in a script, with a mismatch, or if the machine's start has no name.
    /// All readings since are compared with it; else each session could add an error up to the profile's limit.
    #[must_use]
    pub fn reading(&self) -> Option<TrustedClockReading> {
        let ClockSource::Machine { clocks, believed, .. } = &self.0 else { return None };
        let boot = clocks.boot();
        let is_believed = self.clock_mismatch_at(&clocks.read()).is_none() && !boot.is_empty();
        is_believed.then_some(TrustedClockReading { boot, boot_ms: believed.boot_ms, wall: believed.wall })
    }

    /// Compares the clocks with the trusted reading of an earlier engine, unless the machine restarted since.
    pub fn compare_with_stored(&mut self, stored: &TrustedClockReading) {
        if let ClockSource::Machine { clocks, believed, .. } = &mut self.0
            && stored.boot == clocks.boot()
        {
            *believed = ClockReading { wall: stored.wall, boot_ms: stored.boot_ms };
        }
    }

    /// Whether the mismatch stays until a person confirms the time.
    #[must_use]
    pub const fn is_mismatch_stored(&self) -> bool {
        matches!(&self.0, ClockSource::Machine { doubt: Some(_), .. })
    }

    /// Sets the mismatch, until a person confirms the time.
    pub const fn set_mismatch(&mut self, why: ClockMismatch) {
        if let ClockSource::Machine { doubt, .. } = &mut self.0 {
            *doubt = Some(why);
        }
    }

    /// Trusts the machine's clock from now on.
    pub fn believe(&mut self) {
        if let ClockSource::Machine { clocks, believed, newest_record, doubt, .. } = &mut self.0 {
            *believed = clocks.read();
            *newest_record = believed.wall;
            *doubt = None;
        }
    }

    /// The wall time of a record written now, ms since 1970; 0 in a script.
    pub fn stamp(&mut self, at_ms: u64) -> i64 {
        let now = self.now(at_ms);
        match &mut self.0 {
            ClockSource::Script(_) => 0,
            ClockSource::Machine { newest_record, .. } => {
                *newest_record = now;
                now.ms()
            }
        }
    }
}
