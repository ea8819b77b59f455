//! Candidates in the pipeline: what a monitor watches and what runs, pinned; the queue in a line; the rest round the cursor.
//!
//! ```text
//!   align@1.4.0  ◌ active, provisional  cora, manual, risk medium
//!   ████░░░░ 38 of 100 tasks, then it is confirmed
//!   of their limits: violation 85 %, time 26 %; a trip rolls it back to align@1.0.0
//! ▸ grasp@1.1.0  ◌ running  ada, refined, risk low
//!   ✔ register  ✔ validate  ◌ sandbox  · shadow  · gate  · monitor  · confirm
//!   ██████░░░░░░░░░░ 137 of 480 paired episodes  2 min 5 s, 4 min 5 s to 6 min 2 s left
//!   QUEUE 60: next align@1.10.8, grasp@1.1.4  DONE 8, 2 in control
//!   place@1.1.0  ✖ rejected
//! ```

use ratatui::layout::Rect;
use unicode_width::UnicodeWidthStr as _;

use super::{indented, watched};
use crate::action::Action;
use crate::formatters::{
    MONITOR_PLACE, STAGES, approvals, duration, origin, pipeline_idle_reason, stage_place, stages_done,
};
use crate::look::{Glyph, Look, ThemeRole};
use crate::model::{ConsoleModel, StageProgress};
use crate::rows::CandidateRank;
use crate::state_filter::{StateFilter, counts_and_place};
use crate::theme::StateMark;
use crate::widgets::bar::progress;
use crate::widgets::list::{GUTTER, place};
use crate::widgets::pen::{Hit, Pen, below, heading_room};
use crate::widgets::row::{Row, wrap};
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::version_status::{VersionCondition, VersionStatus};
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::snapshot::{CandidateView, ProgressView, Snapshot, current_progress, waits_its_turn};
use holdpoint_protocol::work_unit::PartCount;
use holdpoint_wording::console::pipeline as wording;
use holdpoint_wording::console::shared;

/// Rows for the conditions of an early end.
const EARLY_ROWS_MAX: usize = 3;

/// Candidates of the queue that its line names.
const NEXT_NAMED: usize = 2;

/// Columns of the name of what runs, beside the time.
const WHAT_MIN: usize = 8;

/// Rows for the status of the chosen version.
const STATUS_ROWS_MAX: usize = 3;

/// Draws the pinned candidates, the queue, and the rest round the cursor.
pub fn draw(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect, focused: bool) {
    let candidates = model.pipeline_rows();
    if candidates.is_empty() {
        nothing(model, pen, area);
        return;
    }
    let cursor = if focused { model.row() } else { 0 };
    let here = focused.then_some(cursor);
    let width = usize::from(area.width.saturating_sub(GUTTER));
    let look = pen.look;
    let block_of = |index: usize| {
        candidates.get(index).map_or_else(Vec::new, |one| block(model, one, look, width, index == cursor))
    };
    let pinned = candidates.iter().take_while(|one| CandidateRank::of(one).is_pinned()).count();
    let queue = queue_line(model, width);
    // A cursor below the pinned candidates keeps a third of the lines.
    let kept = if cursor < pinned { 0 } else { area.height.div_ceil(3) };
    let room = area.height.saturating_sub(kept + u16::from(queue.is_some()));
    let briefs = candidates.iter().take(pinned).map(|one| brief(model, one, look, width));
    let blocks = shortened((0..pinned).map(block_of).zip(briefs).collect(), usize::from(room));
    let mut at = 0;
    for (index, rows) in blocks.iter().enumerate() {
        at = draw_block(pen, area, at, rows, index, here);
    }
    if let Some(queue) = queue {
        pen.row(indented(area), at, &queue);
        at = at.saturating_add(1);
    }
    let rest = below(area, at);
    // From the cursor upward for half the height, then down from there.
    let mut first = cursor.max(pinned);
    let mut above = 0;
    while first > pinned {
        above += block_of(first - 1).len();
        if above > usize::from(rest.height / 2) {
            break;
        }
        first -= 1;
    }
    let mut at = 0;
    for index in first..candidates.len() {
        if at >= rest.height {
            break;
        }
        at = draw_block(pen, rest, at, &block_of(index), index, here);
    }
}

/// Draws the lines of a candidate; returns the line below them.
fn draw_block(
    pen: &mut Pen<'_>,
    area: Rect,
    at: u16,
    rows: &[Row],
    index: usize,
    here: Option<usize>,
) -> u16 {
    if at >= area.height {
        return at;
    }
    let taken = pen.rows(indented(area), at, rows);
    let taken_by = Rect { y: area.y + at, height: taken.min(area.height - at), ..area };
    pen.hit(taken_by, Hit::Row { pane: Some(0), row: index });
    if here == Some(index) {
        pen.row(area, at, &Row::of(ThemeRole::Text, pen.look.glyph(Glyph::Here)));
        pen.lay(Rect { y: area.y + at, height: 1, ..area }, ThemeRole::Selected);
    }
    at.saturating_add(taken)
}

/// The lines of a candidate in the list.
fn block(
    model: &ConsoleModel,
    candidate: &CandidateView,
    look: &Look,
    width: usize,
    chosen: bool,
) -> Vec<Row> {
    let headway = model.engine_data.stage_progress.get(&candidate.version);
    let now = model.engine_data.snapshot.as_deref();
    let mut rows = rows(candidate, now, headway, model.engine_ms(), look, width, chosen);
    let rank = CandidateRank::of(candidate);
    if rank == CandidateRank::Queued && !chosen && !candidate.parked {
        // The line of the queue says what all of them wait for.
        rows.truncate(1);
    }
    if rank.is_pinned() && rows.len() > 1 {
        // On a small screen the stages give way to what is counted and watched.
        let strip = rows.remove(1);
        let is_watched = rank == CandidateRank::Watched;
        let watched = now.filter(|_| is_watched).map(|now| watched::rows(now, candidate, look, width));
        let watched = watched.unwrap_or_default();
        // A sentence about what limits it is not parted by the stages.
        let limits = if is_watched { 0 } else { limit_rows(candidate, now, width, chosen).len() + 1 };
        let counted = watched.len() + limits;
        rows.splice(1..1, watched);
        rows.insert((1 + counted).min(rows.len()), strip);
    }
    if model.view_state.marked_versions.contains(&candidate.version)
        && let Some(head) = rows.first_mut()
    {
        *head = super::registry::lead(true, true, look).and(head.clone());
    }
    rows
}

/// A pinned candidate in one line: how far it is stands before its state.
fn brief(model: &ConsoleModel, candidate: &CandidateView, look: &Look, width: usize) -> Row {
    let families = model.engine_data.snapshot.iter().flat_map(|now| &now.families);
    let window = families
        .filter(|family| family.active.as_ref() == Some(&candidate.version))
        .find_map(|family| family.provisional);
    let count = match (current_progress(candidate), window) {
        (Some(progress), _) => format!("{} of {}  ", progress.done, progress.budget),
        (None, Some((worked, needed))) => format!("{worked} of {needed} tasks  "),
        (None, None) => String::new(),
    };
    let is_marked = model.view_state.marked_versions.contains(&candidate.version);
    let lead = super::registry::lead(is_marked, true, look);
    let state = super::candidate_state(candidate, 0, look);
    let room = width.saturating_sub(lead.width());
    let behind = Row::of(ThemeRole::Text, &count).and(state);
    lead.and(super::named(&candidate.version.to_string(), behind, room))
}

/// The blocks with so many lines in all at most: the longest lose their last lines, and one that would keep its first alone
/// becomes its brief line.
fn shortened(blocks: Vec<(Vec<Row>, Row)>, room: usize) -> Vec<Vec<Row>> {
    let (mut blocks, briefs): (Vec<Vec<Row>>, Vec<Row>) = blocks.into_iter().unzip();
    while blocks.iter().map(Vec::len).sum::<usize>() > room {
        match blocks.iter_mut().max_by_key(|rows| rows.len()) {
            Some(longest) if longest.len() > 1 => {
                longest.pop();
            }
            _ => {
                blocks.truncate(room);
                break;
            }
        }
    }
    for (rows, brief) in blocks.iter_mut().zip(briefs) {
        if rows.len() == 1 {
            *rows = vec![brief];
        }
    }
    blocks
}

/// The queue in a line, with the first of it and what is done; absent without a queue. A filter hides from the list, not
/// from here.
fn queue_line(model: &ConsoleModel, width: usize) -> Option<Row> {
    let now = model.engine_data.snapshot.as_deref()?;
    let ranked = now.candidates.iter().map(|one| (CandidateRank::of(one), one));
    let of = |wanted: CandidateRank| {
        let those = ranked.clone().filter(move |(rank, _)| *rank == wanted);
        those.map(|(_, one)| one).collect::<Vec<&CandidateView>>()
    };
    let (at_work, mut queued, settled) =
        (of(CandidateRank::AtWork), of(CandidateRank::Queued), of(CandidateRank::Settled));
    // A stage that rests goes on before any other begins.
    queued.sort_by_key(|one| !one.parked);
    let names = |of: &[&CandidateView]| {
        let names: Vec<String> = of.iter().map(|one| one.version.to_string()).collect();
        names.join(", ")
    };
    let is_filtered = !model.filter().is_empty() || model.view_state.state_filter != StateFilter::All;
    let mut row = Row::new();
    if is_filtered && !at_work.is_empty() {
        row.push(ThemeRole::Running, &format!("RUNS {}  ", names(&at_work)));
    }
    if !queued.is_empty() {
        // The stages of all of them begin in this order.
        let first = queued.get(..NEXT_NAMED).unwrap_or(&queued);
        row.push(ThemeRole::Title, &format!("QUEUE {}", queued.len()));
        row.push(ThemeRole::Text, &format!(": next {}  ", names(first)));
        if !settled.is_empty() {
            let active = settled.iter().filter(|one| one.state == State::Active).count();
            let done = Row::of(ThemeRole::Muted, &wording::done_and_in_control(settled.len(), active));
            if row.width() + done.width() <= width {
                row = row.and(done);
            }
        }
    }
    (row.width() > 0).then_some(row)
}

/// The counts by state and the cursor's place, for the heading of a pane of this title and width; a filtered list must not
/// look complete.
#[must_use]
pub fn extent(model: &ConsoleModel, cursor: usize, title: &str, width: u16) -> String {
    let count = model.pipeline_rows().len();
    let room = heading_room(title, width);
    let filter = model.filter();
    if filter.is_empty() {
        return counts_and_place(model, &place(count, cursor), room);
    }
    let all = model.engine_data.snapshot.as_ref().map_or(0, |now| now.candidates.len());
    let here = if count == 0 { "none".to_owned() } else { place(count, cursor) };
    let here = match model.view_state.state_filter {
        StateFilter::All => here,
        by_state => format!("[{}] {here}", by_state.name()),
    };
    let filter_text = |width| super::short(filter, width);
    let wordings = [
        wording::place_in_filter_of_all(&here, &filter_text(24), all),
        format!("{here} with {:?}", filter_text(24)),
        format!("{here} with {:?}", filter_text(6)),
    ];
    let fits = wordings.iter().position(|text| text.width() <= room);
    wordings.into_iter().nth(fits.unwrap_or(2)).unwrap_or_default()
}

/// The first steps if there is no candidate yet.
fn nothing(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    if !model.filter().is_empty() || model.view_state.state_filter != StateFilter::All {
        pen.text(area, 0, ThemeRole::Muted, wording::NO_CANDIDATE_FITS);
        return;
    }
    if model.engine_data.snapshot.is_none() {
        pen.text(area, 0, ThemeRole::Muted, shared::ENGINE_STARTING);
        return;
    }
    let keys = model.keymap.key(Action::Help);
    let lines = [
        (ThemeRole::Title, wording::NO_CANDIDATE.to_owned()),
        (ThemeRole::Text, String::new()),
        (ThemeRole::Text, wording::DEMO.to_owned()),
        (ThemeRole::Text, wording::REGISTER.to_owned()),
        (ThemeRole::Text, wording::keys_of_this_view(&keys)),
    ];
    let mut at = 0;
    for (role, line) in lines {
        at += if line.is_empty() { 1 } else { pen.text(below(area, at), 0, role, &line) };
    }
}

/// One candidate's lines; all of them if it is the chosen one.
fn rows(
    candidate: &CandidateView,
    now: Option<&Snapshot>,
    headway: Option<&StageProgress>,
    now_ms: u64,
    look: &Look,
    width: usize,
    chosen: bool,
) -> Vec<Row> {
    let name = candidate.version.to_string();
    let room = width.saturating_sub(name.width() + 2);
    // Before the assessment, the engine has only the author's estimate.
    let basis = if candidate.dimensions.is_empty() { "estimated risk" } else { "risk" };
    let (author, origin) = (super::short(&candidate.author, 24), origin(candidate.provenance));
    let by = format!("  {author}, {origin}, {basis} {}", candidate.risk);
    let state = super::candidate_state(candidate, room, look);
    // The last column is for the sign that the author is cut off.
    let head = super::named(&name, state, width.saturating_sub(1)).with(ThemeRole::Muted, &by);
    let mut rows = vec![head];
    if !candidate.state.is_terminal() || chosen {
        rows.push(strip(candidate, look, width));
    }
    let status = status_in(candidate, now);
    rows.extend(limit_rows(candidate, now, width, chosen));
    let question =
        now.and_then(|now| now.prompts.iter().find(|request| request.version == candidate.version));
    let turn = status.as_ref().filter(|status| status.obstacle.is_some() && waits_its_turn(candidate));
    let turn = turn.map(|status| holdpoint_wording::status_end(&candidate.version, status));
    let still = now.and_then(pipeline_idle_reason).or(turn.as_deref());
    let muted = |text: &str| Row::of(ThemeRole::Muted, &super::short(text, width));
    let time = now.map_or_else(WallTime::default, |now| now.time_at(now_ms));
    if let Some(question) = question.filter(|_| candidate.flags.awaiting_approval) {
        let (count, next) = approvals(question, now.is_some_and(|now| now.stopped.is_some()), time);
        rows.push(Row::of(ThemeRole::Waiting, &super::short(&format!("{count} approved, {next}"), width)));
    } else if let (Some(progress), Some(why)) = (current_progress(candidate), still) {
        // Time passes, but says nothing about the end.
        let PartCount { done, budget } = progress.unit_count();
        rows.push(muted(&wording::stands_still_at(done, budget, &progress.what.to_string(), why)));
    } else if let Some(progress) = current_progress(candidate) {
        rows.extend(running(progress, headway, now_ms, look, width, chosen));
    } else if let Some(stage) = candidate.flags.running.filter(|_| !candidate.flags.paused) {
        let name = stage.name();
        rows.push(match still {
            _ if candidate.flags.awaiting_approval => muted(wording::PEOPLE_ARE_ASKED),
            Some(why) => muted(&wording::stage_stands_still(name, why)),
            None => muted(&wording::stage_begins(name)),
        });
    } else if let Some(status) = status.filter(|status| !status.is_limited()) {
        let has_failed =
            matches!(status.condition, VersionCondition::Rejected | VersionCondition::RolledBack);
        if chosen || has_failed || status.is_waiting() {
            rows.extend(status_rows(candidate, &status, width, chosen));
        }
    }
    rows
}

fn status_in(candidate: &CandidateView, now: Option<&Snapshot>) -> Option<VersionStatus> {
    now.map(|now| now.status(candidate)).or_else(|| candidate.status.clone())
}

/// The status of a version that goes on under a limit; `None` for any other version.
fn limit_rows(candidate: &CandidateView, now: Option<&Snapshot>, width: usize, chosen: bool) -> Vec<Row> {
    let limited = status_in(candidate, now).filter(VersionStatus::is_limited);
    limited.map_or_else(Vec::new, |status| status_rows(candidate, &status, width, chosen))
}

/// The status of the chosen version in full. Of another one, what is needed at a glance: a limit and its author, the cause of
/// a rejection or a rollback, or what it waits for.
fn status_rows(candidate: &CandidateView, status: &VersionStatus, width: usize, chosen: bool) -> Vec<Row> {
    let id = &candidate.version;
    let role = if status.is_waiting() { ThemeRole::Waiting } else { ThemeRole::Muted };
    if chosen {
        let told = holdpoint_wording::version_status(id, status);
        return wrap(&told, width, STATUS_ROWS_MAX).iter().map(|line| Row::of(role, line)).collect();
    }
    let told = match status.condition {
        _ if status.is_limited() => holdpoint_wording::version_status(id, status),
        VersionCondition::Rejected | VersionCondition::RolledBack => {
            let cause = holdpoint_wording::status_cause(status);
            cause.unwrap_or_else(|| holdpoint_wording::status_end(id, status))
        }
        _ => holdpoint_wording::status_end(id, status),
    };
    vec![Row::of(role, &super::short(&told, width))]
}

fn stage_mark(candidate: &CandidateView, place: usize) -> StateMark {
    let done = stages_done(candidate.state, candidate.left, candidate.ran, &candidate.flags);
    let running = candidate.flags.running.map(stage_place);
    let stopped = matches!(candidate.state, State::Rejected | State::RolledBack);
    // A confirmed version keeps its stage; a later stop is the monitor's.
    let confirmed = candidate.confirmed && place > MONITOR_PLACE;
    // A version whose promotion is paused is still monitored.
    let works = candidate.state == State::Active;
    let held = if works { MONITOR_PLACE + 1 } else { running.unwrap_or(done) };
    if candidate.flags.paused && place == held {
        StateMark::PAUSED
    } else if candidate.flags.awaiting_approval && !works && place == running.unwrap_or(done) {
        // The gate has passed; the approvers decide next.
        StateMark::WAITING
    } else if running == Some(place) {
        if waits_its_turn(candidate) { StateMark::WAITS_ITS_TURN } else { StateMark::RUNNING }
    } else if place < done || confirmed {
        StateMark::DONE
    } else if stopped && place == done {
        StateMark::FAILED
    } else if candidate.flags.provisional && place == done {
        StateMark::RUNNING
    } else {
        StateMark::AHEAD
    }
}

/// The seven stages: signs and words, or signs with the word of the present stage if there is no room.
#[must_use]
pub fn strip(candidate: &CandidateView, look: &Look, width: usize) -> Row {
    let marks = STAGES.iter().enumerate().map(|(place, stage)| (stage_mark(candidate, place), *stage));
    for gap in ["  ", " "] {
        let mut row = Row::new();
        for (mark, stage) in marks.clone() {
            let between = if row.width() == 0 { "" } else { gap };
            let space = if gap.len() > 1 { " " } else { "" };
            row.push(ThemeRole::Text, between);
            row.push(mark.role, &format!("{}{space}{stage}", look.glyph(mark.glyph)));
        }
        if row.width() <= width {
            return row;
        }
    }
    let mut row = Row::new();
    let mut is_named = false;
    for (mark, stage) in marks {
        row.push(mark.role, look.glyph(mark.glyph));
        if !is_named && mark != StateMark::DONE || mark == StateMark::PAUSED {
            row.push(mark.role, &format!(" {stage} {} ", mark.label));
            is_named = true;
        }
    }
    row
}

fn running(
    view: &ProgressView,
    headway: Option<&StageProgress>,
    now_ms: u64,
    look: &Look,
    width: usize,
    chosen: bool,
) -> Vec<Row> {
    let elapsed_ms = now_ms.saturating_sub(view.since_ms);
    let elapsed = duration(elapsed_ms);
    let time = match headway.and_then(|headway| headway.remaining_ms(view, now_ms)) {
        Some((least_ms, most_ms)) => match [least_ms, most_ms].map(duration) {
            [least, most] if least == most => format!("{elapsed}, {most} left"),
            [least, most] => wording::between_left(&elapsed, &least, &most),
        },
        None => elapsed,
    };
    let PartCount { done, budget } = view.unit_count();
    let count = format!(" {done} of {budget} ");
    let bar = (width / 4).clamp(6, 24);
    let mut head = progress(look, view.done, view.budget, bar).with(ThemeRole::Text, &count);
    // What runs comes before the time.
    let what = view.what.to_string();
    let room = width.saturating_sub(head.width());
    let beside_time = room.saturating_sub(time.len() + 2);
    let is_readable = beside_time >= what.width().min(WHAT_MIN);
    let what = super::short(&what, if is_readable { beside_time } else { room });
    let time = format!("  {time}");
    head.push(ThemeRole::Muted, &what);
    if head.width() + time.len() <= width {
        head.push(ThemeRole::Text, &time);
    }
    // The bar and the time are those of the whole stage.
    let whole = wording::whole_stage(view.done, view.budget);
    if view.part.is_some() && head.width() + whole.len() <= width {
        head.push(ThemeRole::Muted, &whole);
    }
    let mut rows = vec![head];
    if chosen && !view.early.is_empty() {
        let early = wrap(&view.early, width, EARLY_ROWS_MAX);
        rows.extend(early.iter().map(|line| Row::of(ThemeRole::Muted, line)));
    }
    rows
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test says what it expects by failing")]
mod tests {
    use super::*;
    use holdpoint_governance::lifecycle::Stage;
    use holdpoint_governance::version_status::{RecordedChanges, StatusFacts};
    use serde_json::json;

    fn candidate(state: &str, left: &str, confirmed: bool) -> CandidateView {
        let flags = json!({ "running": null, "paused": false, "awaiting_approval": false, "provisional": false,
            "restricted": false, "rollback_pending": false });
        serde_json::from_value(json!({
            "version": "grasp@1.3.0", "digest": "a".repeat(64), "state": state, "left": left,
            "confirmed": confirmed, "flags": flags, "row_version": 7, "author": "cora", "provenance": "manual",
            "risk": "medium", "progress": null, "dimensions": [], "composite": null, "pairs": null,
            "drills": null, "shadow": null, "reasons": [], "conditions": [] }))
        .unwrap()
    }

    fn marks(state: &str, left: &str, confirmed: bool) -> Vec<&'static str> {
        marks_of(&candidate(state, left, confirmed))
    }

    fn marks_of(candidate: &CandidateView) -> Vec<&'static str> {
        let failed = |place: &usize| stage_mark(candidate, *place) == StateMark::FAILED;
        let done =
            (0..STAGES.len()).take_while(|place| stage_mark(candidate, *place) == StateMark::DONE).count();
        let mut names = vec![STAGES.get(done).copied().unwrap_or("all done")];
        names.extend((0..STAGES.len()).filter(failed).map(|place| STAGES[place]));
        names
    }

    #[test]
    fn stage_strip_marks_the_stage_that_ended_the_version() {
        assert_eq!(marks("rejected", "registered", false), ["validate", "validate"]);
        assert_eq!(marks("rejected", "validated", false), ["sandbox", "sandbox"]);
        assert_eq!(marks("rejected", "sandboxed", false), ["shadow", "shadow"]);
        assert_eq!(marks("rejected", "shadowed", false), ["gate", "gate"]);
        assert_eq!(marks("rolled-back", "active", false), ["monitor", "monitor"]);
        assert_eq!(marks("superseded", "active", true), ["all done"]);
    }

    /// A repeated version leaves from `demoted`: the strip said that it was not valid.
    #[test]
    fn stage_strip_marks_the_retried_stage_that_ended_the_version() {
        for (ran, stage) in [(Stage::Sandbox, "sandbox"), (Stage::Shadow, "shadow")] {
            let repeated = CandidateView { ran: Some(ran), ..candidate("rejected", "demoted", false) };
            assert_eq!(marks_of(&repeated), [stage, stage]);
        }
        assert_eq!(
            marks("rejected", "demoted", false),
            ["sandbox", "sandbox"],
            "nothing ran: a person did it"
        );
    }

    #[test]
    fn pinned_candidates_keep_a_line_each_where_lines_are_few() {
        let row = |text: &str| Row::of(ThemeRole::Text, text);
        let texts = |room: usize| {
            let first = (vec![row("a"), row("a 2"), row("a 3")], row("a brief"));
            let second = (vec![row("b"), row("b 2")], row("b brief"));
            let blocks = shortened(vec![first, second], room);
            let text = |row: &Row| row.parts().map(|(text, _)| text).collect::<String>();
            blocks.iter().map(|rows| rows.iter().map(text).collect::<Vec<String>>()).collect::<Vec<_>>()
        };
        assert_eq!(texts(9), [vec!["a", "a 2", "a 3"], vec!["b", "b 2"]]);
        assert_eq!(texts(4), [["a", "a 2"], ["b", "b 2"]]);
        assert_eq!(texts(2), [["a brief"], ["b brief"]]);
        assert_eq!(texts(1), [["a brief"]]);
        assert!(texts(0).is_empty());
    }

    /// The end of an evaluation alone does not tell the operator what was wrong.
    #[test]
    fn a_rejected_candidate_shows_the_reason() {
        let reasons = json!([
            { "code": "behavior-ended-early", "dimension": "behavior", "text": "ended after 24 of 120 episode pairs",
              "evidence": 24.0, "limit": 120.0 },
            { "code": "behavior-established-worse", "dimension": "behavior",
              "text": "violation is worse in the pairs worked so far", "evidence": 0.375, "limit": 0.05 }
        ]);
        let rejected = CandidateView {
            reasons: serde_json::from_value(reasons).unwrap(),
            ..candidate("rejected", "validated", false)
        };
        let theme = crate::look::Theme::builtin("mono").unwrap();
        let look = Look::new(theme, crate::look::ColorDepth::Mono, crate::look::Glyphs::Ascii);
        // A rejected version is in no running stage.
        let what = holdpoint_protocol::work_unit::WorkUnit::PairedEpisodes.into();
        let early = String::new();
        let progress = ProgressView {
            stage: Stage::Sandbox,
            what,
            done: 24,
            budget: 120,
            part: None,
            since_ms: 0,
            early,
        };
        let recorded = RecordedChanges::default();
        let status = VersionStatus::of(&StatusFacts {
            state: rejected.state,
            flags: &rejected.flags,
            held: false,
            reasons: &rejected.reasons,
            obstacle: None,
            recorded: &recorded,
        });
        let rejected = CandidateView { progress: Some(progress), status: Some(status), ..rejected };
        let rows = rows(&rejected, None, None, 9_000, &look, 120, false);
        let text = |row: &Row| row.parts().map(|(text, _)| text).collect::<String>();
        let lines: Vec<String> = rows.iter().map(text).collect();
        let flat = lines.join(" ").split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(flat.contains("[measured 0.375, limit 0.050]"), "{lines:?}");
        assert!(lines.iter().all(|row| !row.contains("ended after") && !row.contains("9 s")), "{lines:?}");
    }

    #[test]
    fn a_version_that_was_confirmed_stays_so_after_a_rollback() {
        let confirmed = candidate("rolled-back", "active", true);
        let marks = [MONITOR_PLACE, MONITOR_PLACE + 1].map(|place| stage_mark(&confirmed, place));
        assert_eq!(marks, [StateMark::FAILED, StateMark::DONE]);
    }
}
