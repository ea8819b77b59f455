//! Time by the machine's clock: the unit of approvers' deadlines, and clock mismatches.
//!
//! Engine time stands still while no engine runs; people do not. So approvals, questions, freezes, reviews and shelves end
//! at a [`WallTime`]. Reads no clock: readings come in.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::calendar;
use super::ids::text_form;

/// A moment by the machine's clock, with milliseconds, from 1970 to the end of the year 9999. As text and in JSON it is
/// RFC 3339 with its zone, written in UTC.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct WallTime(i64);

/// Whole milliseconds of a span of seconds.
#[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "in the range of the target")]
fn ms_of(secs: f64) -> u64 {
    (secs.clamp(0.0, 1.0e12) * 1_000.0) as u64
}

/// The last moment there is, ms since 1970.
const LAST_MS: i64 = 253_402_300_799_999;

impl WallTime {
    /// The wall time of a script when its engine's clock is 0: 2026-01-01T00:00:00Z.
    pub const SCRIPT_EPOCH: Self = Self(1_767_225_600_000);

    /// So many milliseconds after 1970-01-01T00:00:00Z; the nearest moment there is for a number outside.
    #[must_use]
    pub const fn from_ms(ms: i64) -> Self {
        Self(if ms < 0 {
            0
        } else if ms > LAST_MS {
            LAST_MS
        } else {
            ms
        })
    }

    /// Milliseconds since 1970-01-01T00:00:00Z.
    #[must_use]
    pub const fn ms(self) -> i64 {
        self.0
    }

    /// The moment so many milliseconds later.
    #[must_use]
    pub const fn plus_ms(self, ms: u64) -> Self {
        Self::from_ms(self.0.saturating_add_unsigned(ms))
    }

    /// The moment so many seconds later; a span that is negative or no number is none.
    #[must_use]
    pub fn plus_secs(self, secs: f64) -> Self {
        self.plus_ms(ms_of(secs))
    }

    /// The moment so many seconds earlier; a span that is negative or no number is none.
    #[must_use]
    pub fn minus_secs(self, secs: f64) -> Self {
        Self::from_ms(self.0.saturating_sub_unsigned(ms_of(secs)))
    }

    /// The moment for people, to the second: `Thu 1 Jan 00:15:20 UTC`.
    #[must_use]
    pub fn label(self) -> String {
        format!("{} UTC", calendar::day_and_time(self.0 - self.0.rem_euclid(1_000)))
    }

    /// The moment as a deadline, to a reader at `now`: the time of day, with its day where that is another one, and how long
    /// is left. `10:15:20 UTC, 14 min left`.
    #[must_use]
    pub fn as_deadline(self, now: Self) -> String {
        let whole = self.0 - self.0.rem_euclid(1_000);
        let same_day = whole.div_euclid(calendar::DAY_MS) == now.0.div_euclid(calendar::DAY_MS);
        let deadline = if same_day { calendar::time(whole) } else { calendar::day_and_time(whole) };
        let left = match now.ms_until(self) / 1_000 {
            _ if self <= now => "over".to_owned(),
            secs @ ..60 => format!("{secs} s left"),
            secs @ ..7_200 => format!("{} min left", secs / 60),
            secs @ ..172_800 => format!("{} h left", secs / 3_600),
            secs => format!("{} days left", secs / 86_400),
        };
        format!("{deadline} UTC, {left}")
    }

    /// Milliseconds from here to a later moment, 0 if it is not later.
    #[must_use]
    pub fn ms_until(self, later: Self) -> u64 {
        (later.0 - self.0).max(0).unsigned_abs()
    }
}

impl fmt::Display for WallTime {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let text = calendar::rfc3339(self.0);
        match self.0.rem_euclid(1_000) {
            0 => f.write_str(&text),
            part => write!(f, "{}.{part:03}Z", text.trim_end_matches('Z')),
        }
    }
}

/// A text that is no moment with its zone.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{0:?} is no time with its zone; write it as \"2026-12-24T06:00:00+01:00\"")]
pub struct WallTimeError(String);

impl FromStr for WallTime {
    type Err = WallTimeError;
    fn from_str(text: &str) -> Result<Self, WallTimeError> {
        calendar::read_zoned(text).map(Self::from_ms).ok_or_else(|| WallTimeError(text.to_owned()))
    }
}

text_form! { WallTime, WallTimeError }

impl schemars::JsonSchema for WallTime {
    fn schema_name() -> std::borrow::Cow<'static, str> {
        "WallTime".into()
    }

    fn json_schema(_: &mut schemars::SchemaGenerator) -> schemars::Schema {
        schemars::json_schema!({
            "type": "string",
            "format": "date-time",
            "description": "A moment by the machine's clock, RFC 3339 with its zone."
        })
    }
}

/// Serializes a moment as milliseconds since 1970, for fields that are numbers in earlier records. Earlier
/// versions wrote the engine's time there, which reads as a moment in 1970 and so has passed.
pub mod as_ms {
    use serde::{Deserialize, Deserializer, Serializer};

    use super::WallTime;

    /// Writes the number.
    ///
    /// # Errors
    /// The serializer's.
    #[allow(clippy::trivially_copy_pass_by_ref, reason = "serde asks for it")]
    pub fn serialize<S: Serializer>(time: &WallTime, to: S) -> Result<S::Ok, S::Error> {
        to.serialize_i64(time.ms())
    }

    /// Reads the number.
    ///
    /// # Errors
    /// The deserializer's.
    pub fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<WallTime, D::Error> {
        let ms = u64::deserialize(from)?;
        Ok(WallTime::from_ms(i64::try_from(ms).unwrap_or(i64::MAX)))
    }
}

/// Two clocks of one machine, read together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ClockReading {
    /// The time of the machine's clock; any administrator of the machine can set it.
    pub wall: WallTime,
    /// Time since the machine was started, ms; it cannot be set, and it advances while the machine is suspended.
    pub boot_ms: u64,
}

impl ClockReading {
    /// What the wall clock would say at a later reading if it was not set since this one.
    #[must_use]
    pub const fn expected(&self, later: &Self) -> WallTime {
        self.wall.plus_ms(later.boot_ms.saturating_sub(self.boot_ms))
    }
}

/// A clock mismatch, until a person has confirmed the time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(rename_all = "kebab-case", tag = "doubt", deny_unknown_fields)]
pub enum ClockMismatch {
    /// It diverged from the time since the machine's start by more than the profile allows.
    Jumped {
        /// How far it is ahead of where it would stand, ms; negative if it is behind.
        by_ms: i64,
    },
    /// It is behind the newest record.
    Behind {
        /// By how much, ms.
        by_ms: u64,
    },
}

/// Returns a mismatch if the machine's clock is behind the newest record, or jumped by more than `jump_max_s`, s. A jump is
/// the divergence from the time since boot after the last trusted reading.
#[must_use]
pub fn clock_mismatch(
    believed: &ClockReading,
    now: &ClockReading,
    newest_record: WallTime,
    jump_max_s: f64,
) -> Option<ClockMismatch> {
    let by_ms = now.wall.ms() - believed.expected(now).ms();
    let jumped = by_ms.unsigned_abs() as f64 / 1_000.0;
    // A bound that is no number allows nothing.
    if jumped > 0.0 && !(jumped <= jump_max_s) {
        return Some(ClockMismatch::Jumped { by_ms });
    }
    let behind_ms = now.wall.ms_until(newest_record);
    (behind_ms > 0).then_some(ClockMismatch::Behind { by_ms: behind_ms })
}

/// The time for approvers' deadlines. It never goes back before a person has confirmed the time: during a clock
/// mismatch, it is the latest of what the clock says, what it would say, and the newest record.
#[must_use]
pub fn time_for_deadlines(
    believed: &ClockReading,
    now: &ClockReading,
    newest_record: WallTime,
    in_doubt: bool,
) -> WallTime {
    let time = now.wall.max(newest_record);
    if in_doubt { time.max(believed.expected(now)) } else { time }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(secs: i64) -> WallTime {
        WallTime::from_ms(WallTime::SCRIPT_EPOCH.ms() + secs * 1_000)
    }

    #[test]
    fn a_time_is_written_with_its_zone_and_read_to_the_millisecond() {
        for ms in [0, 1, 999, 1_000, 1_767_225_600_000, 1_795_343_405_250, LAST_MS] {
            let time = WallTime::from_ms(ms);
            assert_eq!(time.to_string().parse(), Ok(time), "{time}");
            assert_eq!(
                serde_json::from_str::<WallTime>(&serde_json::to_string(&time).unwrap()).unwrap(),
                time
            );
        }
        assert_eq!(WallTime::SCRIPT_EPOCH.to_string(), "2026-01-01T00:00:00Z");
        assert_eq!("2026-01-01T01:00:00.250+01:00".parse(), Ok(WallTime::SCRIPT_EPOCH.plus_ms(250)));
        for text in ["2026-01-01T00:00:00", "2026-01-01", "tomorrow", "9.0", "", "2026-01-01T00:00:00+1:00"] {
            assert!(text.parse::<WallTime>().is_err(), "{text:?} has no zone");
        }
        for (ms, kept) in [(i64::MIN, 0), (-1, 0), (i64::MAX, LAST_MS)] {
            assert_eq!(WallTime::from_ms(ms).ms(), kept);
        }
        assert_eq!(at(0).plus_secs(f64::NAN), at(0));
        assert_eq!(at(0).plus_secs(1.5).ms(), at(0).ms() + 1_500);
    }

    #[test]
    fn deadline_is_shown_as_a_time_of_day_with_the_time_left() {
        for (until_s, now_s, text) in [
            (920, 0, "00:15:20 UTC, 15 min left"),
            (900, 860, "00:15 UTC, 40 s left"),
            (900, 900, "00:15 UTC, over"),
            (86_400 + 900, 86_399, "Fri 2 Jan 00:15 UTC, 15 min left"),
            (86_400 + 900, 0, "Fri 2 Jan 00:15 UTC, 24 h left"),
            (9 * 86_400, 0, "Sat 10 Jan 00:00 UTC, 9 days left"),
        ] {
            assert_eq!(at(until_s).as_deadline(at(now_s)), text);
        }
        assert_eq!(at(920).plus_ms(250).label(), "Thu 1 Jan 00:15:20 UTC");
    }

    /// Both clocks start at 0; the machine's clock shows `wall` after `boot_s` seconds.
    #[test]
    fn clock_is_trusted_while_it_agrees_with_the_time_since_boot() {
        let believed = ClockReading { wall: at(0), boot_ms: 7_000 };
        let nine_days = 9 * 86_400;
        for (name, wall_s, boot_s, newest_s, doubt) in [
            ("an hour later", 3_600, 3_600, 0, None),
            ("suspended for nine days", nine_days, nine_days, 0, None),
            ("slewed within the bound", 3_604, 3_600, 0, None),
            ("set back within the bound, and no record is later", 3_596, 3_600, 3_000, None),
            (
                "set forward",
                nine_days,
                60,
                0,
                Some(ClockMismatch::Jumped { by_ms: (nine_days - 60) * 1_000 }),
            ),
            ("set back", 0, 3_600, 0, Some(ClockMismatch::Jumped { by_ms: -3_600_000 })),
            ("behind the newest record", 100, 100, 101, Some(ClockMismatch::Behind { by_ms: 1_000 })),
        ] {
            let now =
                ClockReading { wall: at(wall_s), boot_ms: 7_000 + u64::try_from(boot_s).unwrap() * 1_000 };
            assert_eq!(clock_mismatch(&believed, &now, at(newest_s), 5.0), doubt, "{name}");
        }
        let later = ClockReading { wall: at(2), boot_ms: 8_000 };
        assert!(clock_mismatch(&believed, &later, at(0), f64::NAN).is_some(), "a bound that is no number");
    }

    #[test]
    fn a_mismatch_extends_no_deadline() {
        let believed = ClockReading { wall: at(0), boot_ms: 0 };
        let (back, forward) = (
            ClockReading { wall: at(-500), boot_ms: 60_000 },
            ClockReading { wall: at(900), boot_ms: 60_000 },
        );
        assert_eq!(time_for_deadlines(&believed, &back, at(30), true), at(60));
        assert_eq!(time_for_deadlines(&believed, &back, at(90), true), at(90));
        assert_eq!(time_for_deadlines(&believed, &forward, at(30), true), at(900));
        assert_eq!(time_for_deadlines(&believed, &forward, at(30), false), at(900));
    }
}
