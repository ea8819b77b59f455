//! The health view: its buckets, its cursor, and when it is read again.

use super::{engine_requests, refuse, show_message};
use crate::action::Action;
use crate::effect::Effect;
use crate::model::{ConsoleModel, HEALTH_WIDTH, HealthViewState};
use crate::trend::SCALE;
use holdpoint_protocol::health::{BUCKET_WIDTHS_MS, BUCKETS_MAX, HealthQuery};
use holdpoint_wording::console::health as wording;

/// The fewest buckets in a query, however narrow the screen.
const BUCKETS_MIN: u16 = 24;

/// The age at which a series is read again without new events, ms.
const READ_AGAIN_MS: u64 = 15_000;

/// The shortest interval between two reads, ms.
const READ_MS_MIN: u64 = 5_000;

/// The span of the alarm history: 30 days.
pub(crate) const HISTORY: HealthQuery =
    HealthQuery { clock: None, until_ms: None, only_alarms: true, bucket_ms: 86_400_000, buckets: 30 };

/// Each column stands for a bucket, so the query has one for each column.
pub(crate) fn health_query(model: &ConsoleModel) -> HealthQuery {
    let columns = model.size.0.saturating_sub(SCALE).clamp(BUCKETS_MIN, BUCKETS_MAX);
    HealthQuery { bucket_ms: model.view_state.health.bucket_ms(), buckets: columns, ..HealthQuery::default() }
}

/// Whether the series is fresh enough. Running episodes are no event here; they only matter from time to time. A
/// frozen view keeps its series.
pub(super) fn is_fresh(model: &ConsoleModel, unchanged: bool) -> bool {
    let Some((series, came_ms)) = &model.engine_data.health else { return unchanged };
    if model.view_state.frozen.is_some() {
        return true;
    }
    let query = health_query(model);
    // The screen has another width, or the last query was not answered.
    if (series.buckets, series.bucket_ms) != (u32::from(query.buckets), query.bucket_ms) {
        return false;
    }
    let age_ms = model.now_ms.saturating_sub(*came_ms);
    age_ms < if unchanged { READ_AGAIN_MS } else { READ_MS_MIN }
}

/// Narrower or wider buckets; the cursor stays at its moment.
pub(crate) fn zoom(model: &mut ConsoleModel, action: Action) -> Vec<Effect> {
    let width = model.view_state.health.width;
    let next = match action {
        Action::ZoomIn => width.checked_sub(1),
        Action::ZoomOut => Some(width + 1).filter(|next| *next < BUCKET_WIDTHS_MS.len()),
        _ => Some(HEALTH_WIDTH),
    };
    let Some(next) = next else {
        let end = if action == Action::ZoomIn {
            wording::NARROWER_THAN_A_MINUTE
        } else {
            wording::WIDER_THAN_A_DAY
        };
        show_message(model, wording::column_is_no(end), false);
        return Vec::new();
    };
    model.view_state.health.width = next;
    if action == Action::ZoomReset {
        model.view_state.health = HealthViewState::default();
    }
    engine_requests::refresh_now(model)
}

/// One bucket to the left or to the right; at the right end the cursor stays with the newest.
pub(crate) fn step(model: &mut ConsoleModel, right: bool) -> Vec<Effect> {
    let (Some(bucket), Some((series, _))) = (model.health_bucket(), model.engine_data.health.clone()) else {
        return refuse(model, wording::NOTHING_READ_YET);
    };
    let next = if right { bucket.saturating_add(1) } else { bucket.saturating_sub(1) };
    let is_newest = next.saturating_add(1) >= series.buckets;
    model.view_state.health.cursor_ms = (!is_newest).then(|| series.start_ms(next));
    Vec::new()
}
