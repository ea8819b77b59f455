//! Moments of the machine's clock as people write them, in UTC: the one calendar of everything that shows or reads one.
//!
//! `jiff` computes and parses. Nothing here reads its clock or its time zones.

use jiff::SignedDuration;
use jiff::civil::{DateTime, Time};
use jiff::fmt::temporal::Pieces;
use jiff::tz::Offset;

/// Milliseconds of a day.
pub const DAY_MS: i64 = 86_400_000;

const EPOCH: DateTime = DateTime::constant(1970, 1, 1, 0, 0, 0, 0);

/// The names of the days of a week, in jiff's order.
const WEEKDAY_NAMES: [&str; 7] =
    ["monday", "tuesday", "wednesday", "thursday", "friday", "saturday", "sunday"];

/// The moment so many milliseconds after 1970-01-01T00:00:00Z; the nearest that jiff has for a number outside.
fn moment(wall_ms: i64) -> DateTime {
    EPOCH.saturating_add(SignedDuration::from_millis(wall_ms))
}

/// A moment in a form of `strftime`: ms since 1970, UTC.
#[must_use]
pub fn formatted(wall_ms: i64, form: &str) -> String {
    moment(wall_ms).strftime(form).to_string()
}

/// The last beginning of a day of that name, at a moment or before it, ms since 1970; `None` if the name is none. Three
/// letters are enough.
#[must_use]
pub fn weekday_named(name: &str, at_or_before_ms: i64) -> Option<i64> {
    let name = name.to_ascii_lowercase();
    let fits = |known: &&str| name.len() >= 3 && known.starts_with(&name);
    let target = i64::try_from(WEEKDAY_NAMES.iter().position(fits)?).ok()?;
    let today = i64::from(moment(at_or_before_ms).weekday().to_monday_zero_offset());
    Some((at_or_before_ms.div_euclid(DAY_MS) - (today - target).rem_euclid(7)) * DAY_MS)
}

/// A moment as `Tue 17 Nov 08:00`, with seconds where it has some: ms since 1970, UTC.
#[must_use]
pub fn day_and_time(wall_ms: i64) -> String {
    format!("{} {}", day(wall_ms), time(wall_ms))
}

/// A day as `Tue 17 Nov`.
#[must_use]
pub fn day(wall_ms: i64) -> String {
    formatted(wall_ms, "%a %-d %b")
}

/// A moment as `2026-11-17T08:00:00Z`.
#[must_use]
pub fn rfc3339(wall_ms: i64) -> String {
    formatted(wall_ms, "%FT%TZ")
}

/// The time of a day, `08:00`, with seconds where there are some.
#[must_use]
pub fn time(wall_ms: i64) -> String {
    formatted(wall_ms, if moment(wall_ms).second() == 0 { "%R" } else { "%T" })
}

/// A day as `17 Nov`.
#[must_use]
pub fn date(wall_ms: i64) -> String {
    formatted(wall_ms, "%-d %b")
}

/// `2026-11-22`, `2026-11-22T10:30`, `2026-11-22 10:30:05Z`, `2026-11-22T10:30:05+01:00` as ms since 1970; UTC by
/// default. A fraction of a second is accepted and ignored. `None` for a moment before 1970, for the name of a zone, and for
/// a text that is no moment.
#[must_use]
pub fn read(text: &str) -> Option<i64> {
    let (ms, _) = parsed(text)?;
    Some(ms - ms.rem_euclid(1_000))
}

/// A moment with its zone, to the millisecond, as ms since 1970; `None` for a text without a zone.
#[must_use]
pub fn read_zoned(text: &str) -> Option<i64> {
    parsed(text).and_then(|(ms, has_zone)| has_zone.then_some(ms))
}

/// A moment, ms since 1970, and whether its text has a zone.
fn parsed(text: &str) -> Option<(i64, bool)> {
    let pieces = Pieces::parse(text).ok()?;
    if pieces.time_zone_annotation().is_some() || pieces.date().year() < 1970 {
        return None;
    }
    let offset = pieces.to_numeric_offset();
    let local = pieces.date().to_datetime(pieces.time().unwrap_or(Time::midnight()));
    let local_ms = i64::try_from(local.duration_since(EPOCH).as_millis()).ok()?;
    Some((local_ms - 1_000 * i64::from(offset.map_or(0, Offset::seconds)), offset.is_some()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn moments_are_read_as_they_are_written() {
        for days in (0..40_000).step_by(7).chain([11_016, 19_782, 20_780, 2_932_896]) {
            assert_eq!(read(&rfc3339(days * DAY_MS)), Some(days * DAY_MS), "{days}");
        }
        assert_eq!(rfc3339(i64::MAX), "9999-12-31T23:59:59Z");
        assert!(rfc3339(i64::MIN).starts_with('-'));
    }

    #[test]
    fn times_are_parsed_and_formatted() {
        for (text, ms) in [
            ("1970-01-02", Some(86_400_000)),
            ("2026-11-22T10:30", Some(1_795_343_400_000)),
            ("2024-02-29 23:59:59", Some(1_709_251_199_000)),
            ("2000-03-01T00:00:01Z", Some(951_868_801_000)),
            ("2026-11-22T11:30:00+01:00", Some(1_795_343_400_000)),
            ("2026-11-22T08:30:00.250-02:00", Some(1_795_343_400_000)),
            ("2026-02-29", None),
            ("2026-13-01", None),
            ("2026-1-1", None),
            ("2026-11-22T24:00", None),
            ("2026-11-22T10:30+99:00", None),
            ("2026-11-22T10:30:00.x", None),
            ("2026-11-22T10:30:00[Europe/Berlin]", None),
            ("1969-12-31T23:59:59Z", None),
            ("", None),
            ("\u{e9}\u{e9}\u{e9}\u{e9}", None),
        ] {
            assert_eq!(read(text), ms, "{text:?}");
        }
        assert_eq!(day_and_time(1_795_343_400_000), "Sun 22 Nov 10:30");
        assert_eq!(day_and_time(1_795_343_405_000), "Sun 22 Nov 10:30:05");
        assert_eq!(rfc3339(1_795_343_405_999), "2026-11-22T10:30:05Z");
        assert_eq!(date(0), "1 Jan");
        assert_eq!(formatted(951_782_400_000, "%F %T UTC"), "2000-02-29 00:00:00 UTC");
    }

    #[test]
    fn weekday_names_the_most_recent_such_day() {
        let sunday_noon = 1_795_343_400_000;
        for (name, text) in [
            ("tuesday", "Tue 17 Nov 00:00"),
            ("Tue", "Tue 17 Nov 00:00"),
            ("sunday", "Sun 22 Nov 00:00"),
            ("mon", "Mon 16 Nov 00:00"),
        ] {
            assert_eq!(weekday_named(name, sunday_noon).map(day_and_time).as_deref(), Some(text));
        }
        assert_eq!(weekday_named("tu", sunday_noon), None);
        assert_eq!(weekday_named("noday", sunday_noon), None);
    }
}
