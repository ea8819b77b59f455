//! Jump targets, parsed from typed text.

use holdpoint_wording::console::replay as wording;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JumpTarget {
    /// This virtual time, ms.
    At(u64),
    /// This many ms forward.
    On(u64),
    /// This many ms back.
    Back(u64),
}

/// A text that is not a jump target.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{}", wording::cannot_jump(.0))]
pub struct JumpError(String);

/// Reads a target: `12.5s`, `12.5`, `1:02.5`, `1:00:00`, `t 3000`, `+5s`, `-1:00`.
///
/// # Errors
/// [`JumpError`] with the text, sanitized.
pub fn parse(text: &str) -> Result<JumpTarget, JumpError> {
    let wrong = || JumpError(holdpoint_text::Untrusted::new(text).display(20).into_string());
    let plain = text.trim().to_ascii_lowercase();
    let time = |part: &str| span_ms(part.trim()).ok_or_else(wrong);
    if let Some(on) = plain.strip_prefix('+') {
        return time(on).map(JumpTarget::On);
    }
    if let Some(back) = plain.strip_prefix('-') {
        return time(back).map(JumpTarget::Back);
    }
    time(&plain).map(JumpTarget::At)
}

/// The first ms of a tick.
#[must_use]
pub fn ms_of_tick(tick: u64) -> u64 {
    let rate = u64::from(holdpoint_body::RATE_HZ);
    // Saturating first keeps a senseless number at the end of time.
    tick.saturating_mul(1000).div_ceil(rate)
}

fn span_ms(text: &str) -> Option<u64> {
    if let Some(tick) = text.strip_prefix("tick").or_else(|| text.strip_prefix('t')) {
        return tick.trim().parse().ok().map(ms_of_tick);
    }
    let text = text.strip_suffix('s').unwrap_or(text).trim_end();
    let mut parts = text.rsplit(':');
    let mut total_ms = seconds_ms(parts.next()?)?;
    for (unit_ms, part) in [60_000u64, 3_600_000].into_iter().zip(parts.by_ref()) {
        let count: u64 = part.parse().ok()?;
        total_ms = total_ms.checked_add(count.checked_mul(unit_ms)?)?;
    }
    parts.next().is_none().then_some(total_ms)
}

fn seconds_ms(text: &str) -> Option<u64> {
    let is_number = text.starts_with(|sign: char| sign.is_ascii_digit() || sign == '.')
        && text.chars().all(|sign| sign.is_ascii_digit() || sign == '.');
    let secs: f64 = if is_number { text.parse().ok()? } else { return None };
    let span = std::time::Duration::try_from_secs_f64(secs).ok()?;
    u64::try_from(span.as_millis()).ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_protocol::clock::tick_of;

    #[test]
    fn jump_texts_give_their_targets() {
        for (text, target) in [
            ("12.5s", JumpTarget::At(12_500)),
            (" 12.5 s ", JumpTarget::At(12_500)),
            ("7", JumpTarget::At(7_000)),
            (".5", JumpTarget::At(500)),
            ("1:02.5", JumpTarget::At(62_500)),
            ("1:00:00", JumpTarget::At(3_600_000)),
            ("t 3000", JumpTarget::At(12_500)),
            ("T240", JumpTarget::At(1_000)),
            ("tick 1", JumpTarget::At(5)),
            ("+5s", JumpTarget::On(5_000)),
            ("- 1:00", JumpTarget::Back(60_000)),
        ] {
            assert_eq!(parse(text), Ok(target), "{text}");
        }
        for text in [
            "",
            "s",
            "t",
            "t -1",
            "1:2:3:4",
            "1e9",
            "nan",
            "inf",
            "12..5",
            "a:1",
            "+-3",
            "99999999999999999999999",
        ] {
            let error = parse(text).unwrap_err().to_string();
            let shown = holdpoint_text::Untrusted::new(text).display(20).into_string();
            assert_eq!(error, wording::cannot_jump(&shown));
            assert!(error.len() < 120, "{error}");
        }
        assert!(parse("\u{1b}[2J").unwrap_err().to_string().contains("u{1b}"));
    }

    #[test]
    fn tick_starts_in_its_first_millisecond() {
        for tick in [0, 1, 2, 239, 240, 241, 182_640] {
            let at_ms = ms_of_tick(tick);
            assert_eq!(tick_of(at_ms), tick);
            assert!(at_ms == 0 || tick_of(at_ms - 1) < tick, "{tick}");
        }
    }
}
