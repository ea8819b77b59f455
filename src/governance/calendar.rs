//! Moments of the machine's clock as people write them, in UTC: the one calendar of everything that shows or reads one.
//!
//! Days from civil and back after Howard Hinnant: years begin in March.

/// Milliseconds of a day.
pub const DAY_MS: i64 = 86_400_000;

/// The days of a week as they are shown, from 1970-01-01 on, which was a Thursday.
const WEEKDAYS: [&str; 7] = ["Thu", "Fri", "Sat", "Sun", "Mon", "Tue", "Wed"];

/// Their names, in the same order.
const WEEKDAY_NAMES: [&str; 7] =
    ["thursday", "friday", "saturday", "sunday", "monday", "tuesday", "wednesday"];

const MONTHS: [&str; 12] =
    ["Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec"];

/// A day of the Gregorian calendar.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Day {
    /// Of the common era.
    pub year: i64,
    /// From 1.
    pub month: i64,
    /// Of the month, from 1.
    pub day: i64,
}

impl Day {
    /// The day so many days after 1970-01-01.
    #[must_use]
    pub const fn of_epoch(days: i64) -> Self {
        let days = days.saturating_add(719_468);
        let (era, day) = (days.div_euclid(146_097), days.rem_euclid(146_097));
        let year = (day - day / 1_460 + day / 36_524 - day / 146_096) / 365;
        let day = day - (365 * year + year / 4 - year / 100);
        let month = (5 * day + 2) / 153;
        let (day, month) = (day - (153 * month + 2) / 5 + 1, if month < 10 { month + 3 } else { month - 9 });
        Self { year: year + era * 400 + (month <= 2) as i64, month, day }
    }

    /// Days since 1970-01-01; `None` if there is no such day from then to the year 9999.
    #[must_use]
    pub const fn epoch(self) -> Option<i64> {
        let Self { year, month, day } = self;
        let leap = year % 4 == 0 && (year % 100 != 0 || year % 400 == 0);
        let days_of_month = match month {
            2 if leap => 29,
            2 => 28,
            4 | 6 | 9 | 11 => 30,
            1..=12 => 31,
            _ => return None,
        };
        if year < 1970 || year > 9999 || day < 1 || day > days_of_month {
            return None;
        }
        let (y, m) = if month <= 2 { (year - 1, month + 9) } else { (year, month - 3) };
        let (era, of_era) = (y / 400, y % 400);
        Some(era * 146_097 + of_era * 365 + of_era / 4 - of_era / 100 + (153 * m + 2) / 5 + day - 1 - 719_468)
    }
}

/// Day of the week of a moment, ms since 1970: from 0, in the order of the names that [`weekday_named`] reads.
fn weekday(wall_ms: i64) -> usize {
    usize::try_from(wall_ms.div_euclid(DAY_MS).rem_euclid(7)).unwrap_or(0)
}

/// The last beginning of a day of that name, at a moment or before it, ms since 1970; `None` if the name is none. Three
/// letters are enough.
#[must_use]
pub fn weekday_named(name: &str, at_or_before_ms: i64) -> Option<i64> {
    let name = name.to_ascii_lowercase();
    let fits = |known: &str| name.len() >= 3 && known.starts_with(&name);
    let target = WEEKDAY_NAMES.iter().position(|known| fits(known))?;
    let back = (weekday(at_or_before_ms) + 7 - target) % 7;
    let day = at_or_before_ms.div_euclid(DAY_MS) - i64::try_from(back).ok()?;
    Some(day * DAY_MS)
}

/// A moment as `Tue 17 Nov 08:00`, with seconds where it has some: ms since 1970, UTC.
#[must_use]
pub fn day_and_time(wall_ms: i64) -> String {
    format!("{} {}", day(wall_ms), time(wall_ms))
}

/// A day as `Tue 17 Nov`.
#[must_use]
pub fn day(wall_ms: i64) -> String {
    format!("{} {}", WEEKDAYS.get(weekday(wall_ms)).copied().unwrap_or(""), date(wall_ms))
}

/// A moment as `2026-11-17T08:00:00Z`.
#[must_use]
pub fn rfc3339(wall_ms: i64) -> String {
    let Day { year, month, day } = Day::of_epoch(wall_ms.div_euclid(DAY_MS));
    let secs = wall_ms.rem_euclid(DAY_MS) / 1_000;
    format!("{year:04}-{month:02}-{day:02}T{:02}:{:02}:{:02}Z", secs / 3_600, secs / 60 % 60, secs % 60)
}

/// The time of a day, `08:00`, with seconds where there are some.
#[must_use]
pub fn time(wall_ms: i64) -> String {
    let secs = wall_ms.rem_euclid(DAY_MS) / 1_000;
    let (hour, minute, second) = (secs / 3_600, secs / 60 % 60, secs % 60);
    if second == 0 { format!("{hour:02}:{minute:02}") } else { format!("{hour:02}:{minute:02}:{second:02}") }
}

/// A day as `17 Nov`.
#[must_use]
pub fn date(wall_ms: i64) -> String {
    let Day { month, day, .. } = Day::of_epoch(wall_ms.div_euclid(DAY_MS));
    let month = usize::try_from(month - 1).ok().and_then(|at| MONTHS.get(at)).copied().unwrap_or("");
    format!("{day} {month}")
}

/// `2026-11-22`, `2026-11-22T10:30`, `2026-11-22 10:30:05Z`, `2026-11-22T10:30:05+01:00` as ms since 1970; UTC by
/// default. A fraction of a second is accepted and ignored. `None` for any other form.
#[must_use]
pub fn read(text: &str) -> Option<i64> {
    let ms = read_ms(text)?;
    Some(ms - ms.rem_euclid(1_000))
}

/// A moment with its zone, to the millisecond, as ms since 1970; `None` for a text without a zone.
#[must_use]
pub fn read_zoned(text: &str) -> Option<i64> {
    let (without, _) = without_offset(text)?;
    if without.len() == text.len() { None } else { read_ms(text) }
}

fn read_ms(text: &str) -> Option<i64> {
    let (text, offset_ms) = without_offset(text)?;
    let (day, time) = text.split_once(['T', 't', ' ']).unwrap_or((text, "00:00"));
    let (time, part) = time.split_once('.').map_or((time, None), |(whole, part)| (whole, Some(part)));
    let part_ms = part.map_or(Some(0), thousandths)?;
    let &[year, month, day] = numbers(day, '-', &[4, 2, 2])?.as_slice() else { return None };
    let time = numbers(time, ':', &[2, 2]).or_else(|| numbers(time, ':', &[2, 2, 2]))?;
    let &[hour, minute, ref second @ ..] = time.as_slice() else { return None };
    let second = second.first().copied().unwrap_or(0);
    if hour > 23 || minute > 59 || second > 59 {
        return None;
    }
    let days = Day { year, month, day }.epoch()?;
    Some(days * DAY_MS + (hour * 3_600 + minute * 60 + second) * 1_000 + part_ms - offset_ms)
}

/// The digits behind the point of a second, up to nine, as whole milliseconds.
fn thousandths(part: &str) -> Option<i64> {
    let digits = !part.is_empty() && part.len() <= 9 && part.bytes().all(|one| one.is_ascii_digit());
    if digits { format!("{part:0<3}").get(..3)?.parse().ok() } else { None }
}

/// A text without its final `Z` or `+01:00`, and that offset, ms.
fn without_offset(text: &str) -> Option<(&str, i64)> {
    if let Some(text) = text.strip_suffix(['Z', 'z']) {
        return Some((text, 0));
    }
    let Some(at) = text.len().checked_sub(6) else { return Some((text, 0)) };
    let Some((head, tail)) = text.split_at_checked(at) else { return Some((text, 0)) };
    let sign = match tail.as_bytes().first() {
        Some(b'+') => 1,
        Some(b'-') if tail.contains(':') => -1,
        _ => return Some((text, 0)),
    };
    let &[hours, minutes] = numbers(tail.get(1..)?, ':', &[2, 2])?.as_slice() else { return None };
    (hours <= 23 && minutes <= 59).then_some((head, sign * (hours * 60 + minutes) * 60_000))
}

fn numbers(text: &str, mark: char, digits: &[usize]) -> Option<Vec<i64>> {
    let parts: Vec<&str> = text.split(mark).collect();
    let well_formed = parts.len() == digits.len()
        && parts
            .iter()
            .zip(digits)
            .all(|(part, digits)| part.len() == *digits && part.bytes().all(|byte| byte.is_ascii_digit()));
    if well_formed { parts.iter().map(|part| part.parse().ok()).collect() } else { None }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn days_round_trip_through_the_epoch() {
        for days in (-1_000..40_000).step_by(7).chain([0, 11_016, 19_782, 20_780]) {
            let day = Day::of_epoch(days);
            assert!(days < 0 || day.epoch() == Some(days), "{day:?}");
        }
        assert_eq!(Day { year: 2026, month: 2, day: 29 }.epoch(), None);
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
            ("", None),
            ("\u{e9}\u{e9}\u{e9}\u{e9}", None),
        ] {
            assert_eq!(read(text), ms, "{text:?}");
        }
        assert_eq!(day_and_time(1_795_343_400_000), "Sun 22 Nov 10:30");
        assert_eq!(day_and_time(1_795_343_405_000), "Sun 22 Nov 10:30:05");
        assert_eq!(rfc3339(1_795_343_405_999), "2026-11-22T10:30:05Z");
        assert_eq!(date(0), "1 Jan");
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
