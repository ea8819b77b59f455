//! The health view: how it is cut, where its cursor is, and when it is read again.

use super::{asking, refuse, tell};
use crate::action::Action;
use crate::effect::Effect;
use crate::model::{HEALTH_WIDTH, HealthPlace, Model};
use crate::trend::SCALE;
use holdpoint_protocol::health::{BUCKET_WIDTHS_MS, BUCKETS_MAX, HealthAsked};

/// The fewest buckets that are asked for, however narrow the screen.
const BUCKETS_MIN: u16 = 24;

/// How old a series gets before it is read again although nothing happened but work, ms.
const READ_AGAIN_MS: u64 = 15_000;

/// How often it is read at most, whatever happens, ms.
const READ_MS_MIN: u64 = 5_000;

/// What the course of alarms is asked for: thirty days.
pub(super) const HISTORY: HealthAsked =
    HealthAsked { clock: None, until_ms: None, only_alarms: true, bucket_ms: 86_400_000, buckets: 30 };

/// A column stands for a bucket, so that many are asked for as there are columns.
pub(super) fn asked(model: &Model) -> HealthAsked {
    let columns = model.size.0.saturating_sub(SCALE).clamp(BUCKETS_MIN, BUCKETS_MAX);
    HealthAsked { bucket_ms: model.place.health.bucket_ms(), buckets: columns, ..HealthAsked::default() }
}

/// Whether what is shown need not be read again. Work itself is no event here: it is looked at from time to time. What is
/// frozen stays as it is.
pub(super) fn is_fresh(model: &Model, unchanged: bool) -> bool {
    let Some((series, came_ms)) = &model.told.health else { return unchanged };
    if model.place.frozen.is_some() {
        return true;
    }
    let asked = asked(model);
    // The screen has another width, or what was asked last was not answered.
    if (series.buckets, series.bucket_ms) != (u32::from(asked.buckets), asked.bucket_ms) {
        return false;
    }
    let age_ms = model.now_ms.saturating_sub(*came_ms);
    age_ms < if unchanged { READ_AGAIN_MS } else { READ_MS_MIN }
}

/// Narrower or wider buckets; the cursor stays at its moment.
pub(super) fn zoom(model: &mut Model, action: Action) -> Vec<Effect> {
    let width = model.place.health.width;
    let next = match action {
        Action::ZoomIn => width.checked_sub(1),
        Action::ZoomOut => Some(width + 1).filter(|next| *next < BUCKET_WIDTHS_MS.len()),
        _ => Some(HEALTH_WIDTH),
    };
    let Some(next) = next else {
        let end = if action == Action::ZoomIn { "narrower than a minute" } else { "wider than a day" };
        tell(model, format!("a column is no {end}"), false);
        return Vec::new();
    };
    model.place.health.width = next;
    if action == Action::ZoomReset {
        model.place.health = HealthPlace::default();
    }
    asking::refresh_now(model)
}

/// One bucket to the left or to the right; at the right end the cursor stays with the newest.
pub(super) fn step(model: &mut Model, right: bool) -> Vec<Effect> {
    let (Some(bucket), Some((series, _))) = (model.health_bucket(), model.told.health.clone()) else {
        return refuse(model, "nothing has been read yet");
    };
    let next = if right { bucket.saturating_add(1) } else { bucket.saturating_sub(1) };
    let is_newest = next.saturating_add(1) >= series.buckets;
    model.place.health.cursor_ms = (!is_newest).then(|| series.start_ms(next));
    Vec::new()
}
