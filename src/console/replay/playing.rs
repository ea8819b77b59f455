//! How time passes while a replay plays: recorded time at the chosen speed, gaps skipped if that is wanted.
//!
//! Pure: the clock is an argument. Must not show a moment that was not recorded as if it had been.

use super::model::ReplayModel;
use super::timeline::GAP_MS;
use crate::words::duration;

/// How long playing stands on an event that it has jumped to, ms: long enough to read it, and less if somebody
/// wants to get on.
const REST_MS: (u64, u64) = (150, 900);

/// The longest step, ms: a terminal that was stopped does not make the replay leap.
const STEP_MS_MAX: u64 = 1_000;

/// Times between two frames while playing, ms: at most twenty a second, and four while only the clock moves.
const FRAME_MS: (u64, u64) = (50, 250);

/// The clock moved on to `now_ms`. Tells whether what is shown changed.
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
        model.tell("end of the recording; g goes to its beginning", false);
        return true;
    }
    if model.skips_gaps && skip(model) {
        return true;
    }
    let quarters = model.speed.quarters(passed_ms).saturating_add(model.carried_quarters);
    model.carried_quarters = quarters % 4;
    let mut target_ms = at_ms.saturating_add(quarters / 4).min(ends_ms);
    // Not into a gap: what is there last is shown before it is skipped.
    if model.skips_gaps
        && let Some(last_ms) = model.timeline.last_moment_ms(target_ms)
        && last_ms > at_ms
        && model.timeline.next_moment_ms(target_ms).is_some_and(|next_ms| next_ms - last_ms > GAP_MS)
    {
        target_ms = last_ms;
    }
    model.cursor = model.timeline.at(target_ms);
    over || target_ms != at_ms
}

/// Jumps over a gap if the cursor stands before one.
fn skip(model: &mut ReplayModel) -> bool {
    let at_ms = model.cursor.at_ms;
    let Some(next_ms) = model.timeline.next_moment_ms(at_ms).filter(|next_ms| next_ms - at_ms > GAP_MS)
    else {
        return false;
    };
    model.cursor = model.timeline.at(next_ms);
    model.carried_quarters = 0;
    let is_picture = model.picture_age_ms() == Some(0);
    if !is_picture {
        // Nothing moves here: the event is given time to be read.
        rest(model);
    }
    model
        .tell(format!("skipped {} without pictures; s plays them through", duration(next_ms - at_ms)), false);
    true
}

/// Playing stands for a moment.
pub fn rest(model: &mut ReplayModel) {
    let (least_ms, most_ms) = REST_MS;
    let rest_ms = model.speed.real_ms(most_ms).clamp(least_ms, most_ms);
    model.rests_until_ms = model.now_ms.saturating_add(rest_ms);
}

/// In how many ms something changes by itself; absent if nothing does before a key.
#[must_use]
pub fn wakes_in_ms(model: &ReplayModel) -> Option<u64> {
    let notice = model.notice.as_ref().map(|notice| notice.until_ms.saturating_sub(model.now_ms));
    let playing = model.playing.then(|| {
        let rests_ms = model.rests_until_ms.saturating_sub(model.now_ms);
        if rests_ms > 0 {
            return rests_ms;
        }
        let next_ms = model.timeline.next_moment_ms(model.cursor.at_ms);
        let left_ms = next_ms.map_or(0, |next_ms| next_ms - model.cursor.at_ms);
        model.speed.real_ms(left_ms).clamp(FRAME_MS.0, FRAME_MS.1)
    });
    notice.into_iter().chain(playing).min()
}
