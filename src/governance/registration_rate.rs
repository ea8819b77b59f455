//! How many versions one person registers within a minute.
//!
//! A total function over times and the profile's limit. Owns no memory of registrations, and refuses nothing itself.

/// The span that the limit is about, ms.
pub const SPAN_MS: u64 = 60_000;

/// The time until a person may register again, ms; `None` if they may now. `registered_ms` are the times of their
/// registrations, oldest first, by the clock of `now_ms`.
#[must_use]
pub fn wait_ms(registered_ms: &[u64], now_ms: u64, per_minute_max: u32) -> Option<u64> {
    let age_ms = |at: &u64| now_ms.saturating_sub(*at);
    let newest_first = registered_ms.iter().rev().map(age_ms).take_while(|age| *age < SPAN_MS);
    // As soon as this one is older than the span, one more fits.
    let deciding = newest_first.take(usize::try_from(per_minute_max).unwrap_or(usize::MAX));
    let ages: Vec<u64> = deciding.collect();
    let is_full = u64::try_from(ages.len()).unwrap_or(u64::MAX) >= u64::from(per_minute_max);
    is_full.then(|| SPAN_MS.saturating_sub(ages.last().copied().unwrap_or(0)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn as_many_as_the_profile_permits_fit_into_any_minute() {
        let mut registered = Vec::new();
        for at in (0..300_000).step_by(1_000) {
            if wait_ms(&registered, at, 10).is_none() {
                registered.push(at);
            }
        }
        assert_eq!(registered.len(), 50, "10 in each of five minutes");
        assert!(registered.windows(11).all(|eleven| eleven[10] - eleven[0] >= SPAN_MS));
    }

    #[test]
    fn the_wait_ends_when_the_oldest_of_the_last_ones_is_a_minute_old() {
        let registered = [0, 10_000, 20_000];
        assert_eq!(wait_ms(&registered, 20_000, 4), None);
        assert_eq!(wait_ms(&registered, 20_000, 3), Some(40_000));
        assert_eq!(wait_ms(&registered, 20_000, 2), Some(50_000));
        assert_eq!(wait_ms(&registered, 60_000, 3), None);
        assert_eq!(wait_ms(&[], 0, 1), None);
        // A clock that was set back counts what is ahead of it as new.
        assert_eq!(wait_ms(&[90_000], 20_000, 1), Some(60_000));
    }
}
