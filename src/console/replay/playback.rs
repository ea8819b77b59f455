//! The passing of time while a replay plays: recorded time at the chosen speed, gaps skipped on request.
//!
//! Pure: the clock is an argument. Must not present an unrecorded moment as recorded.

use super::message::ReplayMessage;
use super::model::ReplayModel;
use super::timeline::GAP_MS;

/// How long playing pauses on an event that it jumped to, ms: long enough to read it, shorter if the user moves on.
const REST_MS: (u64, u64) = (150, 900);

/// The longest step, ms: after a pause of the terminal the replay does not leap.
const STEP_MS_MAX: u64 = 1_000;

/// Times between two frames while playing, ms: at most twenty a second, and four while only the clock moves.
const FRAME_MS: (u64, u64) = (50, 250);

/// Advances the clock to `now_ms`. Returns whether the screen changed.
pub fn pass(model: &mut ReplayModel, now_ms: u64) -> bool {
    let passed_ms = now_ms.saturating_sub(model.now_ms).min(STEP_MS_MAX);
    model.now_ms = now_ms;
    let over = model.notice.take_if(|notice| notice.until_ms <= now_ms).is_some();
    if !model.playing || now_ms < model.rests_until_ms {
        return over;
    }
    let (at_ms, ends_ms) = (model.cursor.at_ms, model.timeline.span_ms().1);
    if at_ms >= ends_ms {
        model.playing = false;
        model.show_notice(ReplayMessage::End);
        return true;
    }
    if model.skips_gaps && skip(model) {
        return true;
    }
    let quarters = model.speed.quarters(passed_ms).saturating_add(model.carried_quarters);
    model.carried_quarters = quarters % 4;
    let mut target_ms = at_ms.saturating_add(quarters / 4).min(ends_ms);
    // Stops before a gap: its last frame is shown before the gap is skipped.
    if model.skips_gaps
        && let Some(last_ms) = model.timeline.last_time_ms(target_ms)
        && last_ms > at_ms
        && model.timeline.next_time_ms(target_ms).is_some_and(|next_ms| next_ms - last_ms > GAP_MS)
    {
        target_ms = last_ms;
    }
    model.cursor = model.timeline.at(target_ms);
    over || target_ms != at_ms
}

/// Jumps over a gap if the cursor is before one.
fn skip(model: &mut ReplayModel) -> bool {
    let at_ms = model.cursor.at_ms;
    let Some(next_ms) = model.timeline.next_time_ms(at_ms).filter(|next_ms| next_ms - at_ms > GAP_MS) else {
        return false;
    };
    model.cursor = model.timeline.at(next_ms);
    model.carried_quarters = 0;
    let is_frame = model.frame_age_ms() == Some(0);
    if !is_frame {
        // Nothing moves here, so the event stays long enough to be read.
        rest(model);
    }
    model.show_notice(ReplayMessage::Skipped(next_ms - at_ms));
    true
}

/// Pauses playing for a moment.
pub fn rest(model: &mut ReplayModel) {
    let (least_ms, most_ms) = REST_MS;
    let rest_ms = model.speed.real_ms(most_ms).clamp(least_ms, most_ms);
    model.rests_until_ms = model.now_ms.saturating_add(rest_ms);
}

/// The time until the screen changes by itself, ms; absent if only a key changes it.
#[must_use]
pub fn wakes_in_ms(model: &ReplayModel) -> Option<u64> {
    let notice = model.notice.as_ref().map(|notice| notice.until_ms.saturating_sub(model.now_ms));
    let playing = model.playing.then(|| {
        let rests_ms = model.rests_until_ms.saturating_sub(model.now_ms);
        if rests_ms > 0 {
            return rests_ms;
        }
        let next_ms = model.timeline.next_time_ms(model.cursor.at_ms);
        let left_ms = next_ms.map_or(0, |next_ms| next_ms - model.cursor.at_ms);
        model.speed.real_ms(left_ms).clamp(FRAME_MS.0, FRAME_MS.1)
    });
    notice.into_iter().chain(playing).min()
}
