//! The machine's clock as people's deadlines are held against it, and whether it is believed.
//!
//! A script has one of its own, which goes with its engine's clock from a fixed moment on. What is to be believed is the
//! rules' ([`holdpoint_governance::wall_time`]); this reads the clocks and remembers what was believed last.

use std::fs::File;
use std::io::Read as _;
use std::time::{SystemTime, UNIX_EPOCH};

use holdpoint_governance::wall_time::{ClockDoubt, ClockReading, WallTime, clock_doubt, time_for_deadlines};
use rustix::time::{ClockId, clock_gettime};
use serde::{Deserialize, Serialize};

/// Where the machine's two clocks are read.
pub trait Clocks: Send {
    /// Both, at the same moment.
    fn read(&self) -> ClockReading;

    /// Names the start of the machine since which one of them counts; empty where the system does not tell.
    fn boot(&self) -> String;
}

/// The clocks of this machine.
pub struct MachineClocks;

impl Clocks for MachineClocks {
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

/// The most of the name of a start that is read, bytes; it has 36.
const BOOT_ID_BYTES_MAX: u64 = 64;

/// A reading that was believed, as the chain keeps it: whatever engine reads the clocks next, as long as the machine is not
/// started anew, holds them against it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(crate) struct KeptReading {
    /// The start of the machine.
    boot: String,
    boot_ms: u64,
    wall: WallTime,
}

/// What the machine's clock says; `None` before 1970.
pub(crate) fn wall_now() -> Option<WallTime> {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).ok()?;
    i64::try_from(since.as_millis()).ok().map(WallTime::from_ms)
}

/// See the module's head.
pub struct WallClock(Kind);

enum Kind {
    /// A script's: where it stands when the engine's clock stands at 0.
    Script(WallTime),
    Machine {
        clocks: Box<dyn Clocks>,
        /// A reading that was believed: the engine's first, or the one that a person confirmed.
        believed: ClockReading,
        /// The latest wall time in the chain since a person last confirmed the time.
        newest_record: WallTime,
        /// The profile's, s.
        jump_max_s: f64,
        /// Why it is not believed, until a person confirms the time.
        doubt: Option<ClockDoubt>,
    },
}

impl WallClock {
    /// A script's, on a store whose newest record has these times, engine's and wall's: behind no record.
    #[must_use]
    pub fn scripted(at_ms: u64, newest_record: Option<WallTime>) -> Self {
        let at_zero = newest_record.map_or(0, |time| time.ms().saturating_sub_unsigned(at_ms));
        Self(Kind::Script(WallTime::SCRIPT_EPOCH.max(WallTime::from_ms(at_zero))))
    }

    /// The machine's, for an engine that begins on a store whose newest record has this time. `jump_max_s` is the
    /// profile's, s.
    #[must_use]
    pub fn of_machine(clocks: Box<dyn Clocks>, newest_record: Option<WallTime>, jump_max_s: f64) -> Self {
        let believed = clocks.read();
        let newest_record = newest_record.unwrap_or_default();
        Self(Kind::Machine { clocks, believed, newest_record, jump_max_s, doubt: None })
    }

    /// The time that deadlines are held against, when the engine's clock stands at `at_ms`.
    pub(crate) fn now(&self, at_ms: u64) -> WallTime {
        match &self.0 {
            Kind::Script(at_zero) => at_zero.plus_ms(at_ms),
            Kind::Machine { clocks, believed, newest_record, .. } => {
                let now = clocks.read();
                time_for_deadlines(believed, &now, *newest_record, self.doubt_at(&now).is_some())
            }
        }
    }

    /// What the machine's clock says, whether it is believed or not; `None` in a script.
    pub(crate) fn said(&self) -> Option<WallTime> {
        match &self.0 {
            Kind::Script(_) => None,
            Kind::Machine { clocks, .. } => Some(clocks.read().wall),
        }
    }

    /// Why it is not believed now, if so.
    pub(crate) fn doubt(&self) -> Option<ClockDoubt> {
        match &self.0 {
            Kind::Script(_) => None,
            Kind::Machine { clocks, .. } => self.doubt_at(&clocks.read()),
        }
    }

    fn doubt_at(&self, now: &ClockReading) -> Option<ClockDoubt> {
        match &self.0 {
            Kind::Script(_) => None,
            Kind::Machine { believed, newest_record, jump_max_s, doubt, .. } => {
                doubt.or_else(|| clock_doubt(believed, now, *newest_record, *jump_max_s))
            }
        }
    }

    /// What is believed, for the chain; `None` in a script, in doubt, or where the system does not name the machine's start. It is
    /// the reading that all since were held against: else each life of an engine could be off by as much as the profile allows.
    pub(crate) fn reading(&self) -> Option<KeptReading> {
        let Kind::Machine { clocks, believed, .. } = &self.0 else { return None };
        let boot = clocks.boot();
        let is_believed = self.doubt_at(&clocks.read()).is_none() && !boot.is_empty();
        is_believed.then_some(KeptReading { boot, boot_ms: believed.boot_ms, wall: believed.wall })
    }

    /// Holds the clocks against what an earlier engine believed, if the machine was not started since.
    pub(crate) fn hold_against(&mut self, kept: &KeptReading) {
        if let Kind::Machine { clocks, believed, .. } = &mut self.0
            && kept.boot == clocks.boot()
        {
            *believed = ClockReading { wall: kept.wall, boot_ms: kept.boot_ms };
        }
    }

    /// Whether the doubt is kept until a person confirms the time.
    pub(crate) const fn is_doubt_kept(&self) -> bool {
        matches!(&self.0, Kind::Machine { doubt: Some(_), .. })
    }

    /// It is not believed from now on.
    pub(crate) const fn keep_doubt(&mut self, why: ClockDoubt) {
        if let Kind::Machine { doubt, .. } = &mut self.0 {
            *doubt = Some(why);
        }
    }

    /// What the machine's clock says now is believed from now on.
    pub(crate) fn believe(&mut self) {
        if let Kind::Machine { clocks, believed, newest_record, doubt, .. } = &mut self.0 {
            *believed = clocks.read();
            *newest_record = believed.wall;
            *doubt = None;
        }
    }

    /// The wall time of a record that is written now, ms since 1970; 0 in a script.
    pub(crate) fn stamp(&mut self, at_ms: u64) -> i64 {
        let now = self.now(at_ms);
        match &mut self.0 {
            Kind::Script(_) => 0,
            Kind::Machine { newest_record, .. } => {
                *newest_record = now;
                now.ms()
            }
        }
    }
}
