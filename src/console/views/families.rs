//! The active version of each family, and their recent results in the live cell.
//!
//! ```text
//! grasp  ✔ active               grasp@1.0.0
//! place  ◌ active, provisional  place@1.1.0  7 of 40, back to place@1.0.0
//! success •••••••✖••••••••  94 % of the last 50, 211 sequences since 06:00:02
//! ```

use crate::look::ThemeRole;
use crate::model::ConsoleModel;
use crate::theme::StateMark;
use crate::widgets::bar::outcomes;
use crate::widgets::pen::Pen;
use crate::widgets::row::Row;
use holdpoint_governance::lifecycle::State;
use holdpoint_protocol::snapshot::{
    CandidateView, FamilyView, Snapshot, current_progress, is_at_work, re_evaluation,
};
use holdpoint_wording::console::families as wording;
use holdpoint_wording::console::shared;

/// The longest trend, signs.
const TREND_MAX: usize = 30;

/// The shortest trend beside the count of this session, signs.
const TREND_MIN: usize = 12;

/// The least columns for the name of an active version.
const NAME_MIN: usize = 16;

/// One line for each family, then what is wrong with the live cell, then its results.
#[must_use]
pub fn rows(model: &ConsoleModel, pen: &Pen<'_>, width: usize) -> Vec<Row> {
    let Some(snapshot) = model.engine_data.snapshot.as_deref() else {
        return vec![Row::of(ThemeRole::Muted, shared::ENGINE_STARTING)];
    };
    let name_width =
        snapshot.families.iter().map(|family| family.family.to_string().len()).max().unwrap_or(0);
    let mut rows: Vec<Row> = snapshot
        .families
        .iter()
        .map(|family| row(snapshot, family, pen, name_width.min(16), width))
        .collect();
    if let Some(fault) = &snapshot.live.fault {
        rows.push(Row::of(
            ThemeRole::Bad,
            &format!("{} broken: {}", pen.look.mark_label(StateMark::FAILED), fault.name()),
        ));
    }
    if let Some(drift) = &snapshot.live.drift {
        let glyph = pen.look.glyph(crate::look::Glyph::Warning);
        rows.push(Row::of(ThemeRole::Warning, &format!("{glyph} drift: {drift}")));
    }
    // The first to go where lines are few.
    rows.push(live(snapshot, pen, width));
    rows
}

fn row(now: &Snapshot, family: &FamilyView, pen: &Pen<'_>, name_width: usize, width: usize) -> Row {
    let flags = family.flags.unwrap_or_default();
    let name = family.active.as_ref().map(ToString::to_string);
    let room = width.saturating_sub(name_width + 3 + name.as_ref().map_or(0, String::len));
    let look = pen.look;
    let mark_row = |mark: StateMark| Row::of(mark.role, &look.mark_label(mark));
    let state = match &family.active {
        _ if family.safe_stopped => mark_row(StateMark::SAFE_STOPPED),
        None => mark_row(StateMark::UNKNOWN),
        Some(_) => super::state_row(State::Active, &flags, room, look),
    };
    let mut row = Row::new()
        .cell(ThemeRole::Text, &family.family.to_string(), name_width)
        .with(ThemeRole::Text, "  ")
        .and(state)
        .to_column(name_width + 23)
        .with(ThemeRole::Text, " ");
    let mut behind = Row::new();
    if let Some(progress) = own(now, family).and_then(re_evaluation) {
        behind.push(ThemeRole::Warning, &wording::re_evaluated(progress.done, progress.budget));
    } else if let Some((worked, needed)) = family.provisional {
        let so_far =
            if worked < needed { format!("{worked} of {needed}") } else { after_window(now, family) };
        behind.push(ThemeRole::Text, &format!("  {so_far}"));
    }
    let name_room = width.saturating_sub(row.width() + behind.width()).max(NAME_MIN);
    match &family.active {
        Some(active) => row.push(ThemeRole::Title, &super::cut_middle(&active.to_string(), name_room)),
        None => row.push(ThemeRole::Bad, wording::NO_ACTIVE_VERSION),
    }
    if let Some(pinned) = &family.pinned {
        behind.push(ThemeRole::Muted, &format!("  back: {}", pinned.version));
    }
    row.and(behind)
}

/// The candidate entry of a family's active version, if there is one.
fn own<'a>(now: &'a Snapshot, family: &FamilyView) -> Option<&'a CandidateView> {
    now.candidates.iter().find(|candidate| Some(&candidate.version) == family.active.as_ref())
}

/// What a provisional version waits for after its window.
fn after_window(now: &Snapshot, family: &FamilyView) -> String {
    let flags = family.flags.unwrap_or_default();
    if flags.paused || flags.restricted {
        // The next step is a person's, and shown beside it.
        return wording::WINDOW_OVER.to_owned();
    }
    let own = own(now, family);
    let is_other = |candidate: &&CandidateView| Some(&candidate.version) != family.active.as_ref();
    let other = now.candidates.iter().filter(is_other).find(|other| is_at_work(other));
    match (own.and_then(current_progress), other) {
        (Some(progress), _) => wording::in_confirmation(progress.done, progress.budget),
        (None, Some(other)) => wording::waits_behind(&other.version),
        (None, None) => wording::WAITS_FOR_CONFIRMATION.to_owned(),
    }
}

fn live(now: &Snapshot, pen: &Pen<'_>, width: usize) -> Row {
    let live = &now.live;
    let Some(share) = live.recent_success else {
        return Row::of(ThemeRole::Muted, wording::NO_SEQUENCE);
    };
    let mut tail = wording::success(share * 100.0, live.recent);
    let head = "success ";
    let session = now.up_since_ms.map(|at| wording::sequences_since(live.sequences, &now.moment(at)));
    tail.extend(session.filter(|session| head.len() + tail.len() + session.len() + TREND_MIN <= width));
    let room = width.saturating_sub(head.len() + tail.len()).min(TREND_MAX);
    Row::of(ThemeRole::Muted, head).and(outcomes(pen.look, &live.outcomes, room)).with(ThemeRole::Text, &tail)
}
