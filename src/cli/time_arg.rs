//! Moments as people write them on a command line: one reader, one help text, one error.

use std::str::FromStr;

use super::metrics::span_ms;
use holdpoint_explain::health_series::PresentTime;
use holdpoint_governance::calendar::{self, DAY_MS};
use holdpoint_protocol::health::HealthClock;

/// A moment, as written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum TimeArg {
    /// By the machine's clock, ms since 1970.
    Wall(i64),
    /// A span before the end, by the displayed clock, ms.
    Back(u64),
    /// The beginning of the day of the end, by the machine's clock in UTC.
    Today,
    /// The beginning of the day before it.
    Yesterday,
    /// The last beginning of that weekday: of one of the last seven days.
    Weekday(String),
    /// By the engine's own clock, ms.
    Virtual(u64),
}

/// The allowed forms, for errors.
pub const ALLOWED: &str = "a span back (30m, 24h, 2d), `today`, `yesterday` or a weekday (its last beginning, UTC), a \
    moment (2026-11-17, 2026-11-17T08:00, RFC 3339; UTC where no offset is given), or seconds of the engine's clock (@3600)";

/// The allowed forms, for the help of every option that takes a `WHEN`.
macro_rules! when_help {
    () => {
        "\
WHEN is one of
  today, yesterday, or one of the last seven days by its name, such as monday: its beginning, UTC
  a span back from the end of the record: 30m, 24h, 2d
  a moment by the machine's clock, UTC by default: 2026-11-17, 2026-11-17T08:00, 2026-11-17T08:00:00+01:00
  seconds of the engine's own clock: @3600
"
    };
}
pub(super) use when_help;

impl FromStr for TimeArg {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("{text:?} is not a moment; allowed: {ALLOWED}");
        if let Some(secs) = text.strip_prefix('@') {
            let secs: f64 = secs.parse().map_err(|_| wrong())?;
            let ms = std::time::Duration::try_from_secs_f64(secs).map_err(|_| wrong())?.as_millis();
            return u64::try_from(ms)
                .ok()
                .filter(|ms| i64::try_from(*ms).is_ok())
                .map(Self::Virtual)
                .ok_or_else(wrong);
        }
        if text.eq_ignore_ascii_case("today") {
            return Ok(Self::Today);
        }
        if text.eq_ignore_ascii_case("yesterday") {
            return Ok(Self::Yesterday);
        }
        if calendar::weekday_named(text, 0).is_some() {
            return Ok(Self::Weekday(text.to_owned()));
        }
        let found = span_ms(text).map(Self::Back).or_else(|| calendar::read(text).map(Self::Wall));
        found.ok_or_else(wrong)
    }
}

impl TimeArg {
    /// The clock it refers to; `None` for the displayed one.
    pub const fn clock(&self) -> Option<HealthClock> {
        match self {
            Self::Wall(_) | Self::Today | Self::Yesterday | Self::Weekday(_) => Some(HealthClock::Wall),
            Self::Virtual(_) => Some(HealthClock::Virtual),
            Self::Back(_) => None,
        }
    }

    /// Its place on a clock, ms, in a history that ends at `end`.
    ///
    /// # Errors
    /// One sentence, if that clock has no such place.
    pub fn on(&self, clock: HealthClock, end: PresentTime) -> Result<i64, String> {
        let end_ms = match clock {
            HealthClock::Virtual => i64::try_from(end.at_ms).unwrap_or(i64::MAX),
            HealthClock::Wall => {
                end.wall_ms.ok_or("this history comes from a script and has no machine time")?
            }
        };
        let wrong = || format!("the moments are of two clocks; here all are by the {clock} clock");
        match (self, clock) {
            (Self::Back(ms), _) => Ok(end_ms.saturating_sub(i64::try_from(*ms).unwrap_or(i64::MAX))),
            (Self::Virtual(ms), HealthClock::Virtual) => Ok(i64::try_from(*ms).unwrap_or(i64::MAX)),
            (Self::Wall(ms), HealthClock::Wall) => Ok(*ms),
            (Self::Today, HealthClock::Wall) => Ok(end_ms.div_euclid(DAY_MS) * DAY_MS),
            (Self::Yesterday, HealthClock::Wall) => Ok((end_ms.div_euclid(DAY_MS) - 1) * DAY_MS),
            (Self::Weekday(name), HealthClock::Wall) => {
                calendar::weekday_named(name, end_ms).ok_or_else(wrong)
            }
            (Self::Virtual(_), HealthClock::Wall)
            | (Self::Wall(_) | Self::Today | Self::Yesterday | Self::Weekday(_), HealthClock::Virtual) => {
                Err(wrong())
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_are_read_and_placed() {
        // Sun 22 Nov 2026, 10:30.
        let end = PresentTime { at_ms: 7_200_000, wall_ms: Some(1_795_343_400_000) };
        for (text, clock, place) in [
            ("2d", HealthClock::Wall, Some(1_795_343_400_000 - 2 * DAY_MS)),
            ("1h", HealthClock::Virtual, Some(3_600_000)),
            ("@3600", HealthClock::Virtual, Some(3_600_000)),
            ("@1.5", HealthClock::Virtual, Some(1_500)),
            ("@3600", HealthClock::Wall, None),
            ("yesterday", HealthClock::Wall, Some(1_795_219_200_000)),
            ("today", HealthClock::Wall, Some(1_795_305_600_000)),
            ("sunday", HealthClock::Wall, Some(1_795_305_600_000)),
            ("monday", HealthClock::Wall, Some(1_794_787_200_000)),
            ("Tuesday", HealthClock::Wall, Some(1_794_873_600_000)),
            ("2026-11-17T09:00:00+01:00", HealthClock::Wall, Some(1_794_902_400_000)),
            ("yesterday", HealthClock::Virtual, None),
        ] {
            let time: TimeArg = text.parse().unwrap();
            assert_eq!(time.on(clock, end).ok(), place, "{text}");
        }
        for text in ["", "soon", "@", "@-1", "@1e30", "@nan", "2026-02-30", "5x", "99999999d", "tu"] {
            let error = text.parse::<TimeArg>().unwrap_err();
            assert!(error.contains(&format!("{text:?}")) && error.ends_with(ALLOWED), "{text}: {error}");
        }
        assert!(TimeArg::Back(1).on(HealthClock::Wall, PresentTime { at_ms: 1, wall_ms: None }).is_err());
    }
}
