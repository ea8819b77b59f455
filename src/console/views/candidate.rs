//! View 3: why a version is in its state: checks, difference, sandbox, drills, timeline, audit.
//!
//! ```text
//! align@2.0.0 against align@1.0.0  ◷ awaiting approval  ada, refined, risk medium
//! [Checks]  Difference  Sandbox  Drills  Timeline  Audit             1 of 9
//! ▸ ✔ interface 1.000 ██████┃                  limit 0.90 compatible
//!   ⚠ recovery  0.821 █████░┃ [0.790, 0.845]  limit 0.85 suspicious
//!   recovery-conditional: recovery is above the floor …
//! ```

use ratatui::layout::Rect;
use unicode_width::UnicodeWidthStr as _;

use super::candidate_rows::item;
use super::console_view::{ConsoleView, ORDER_OF_TIME, ViewDescription};
use super::status::priority_label;
use super::watched::below_limit;
use super::{pipeline, tabs};
use crate::action::{Action, Scope};
use crate::effect::{Effect, EngineQuery};
use crate::formatters::origin;
use crate::look::{Glyph, Look, ThemeRole};
use crate::model::{ConsoleModel, ItemKey, View};
use crate::rows::{CandidateItem, row_keys, search_text};
use crate::update::{navigation, why};
use crate::widgets::list::place;
use crate::widgets::pen::{Fit, Hit, Pen, below, cut};
use crate::widgets::row::{Row, wrap};
use holdpoint_governance::alarms::AlarmKey;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::record::{AuditRecord, RecordKind};
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::detail::Detail;
use holdpoint_wording::approval::stale_evidence;
use holdpoint_wording::console::candidate as wording;
use holdpoint_wording::console::shared;
use holdpoint_wording::{alarm as alarm_wording, counted_try, notice, version_status};
use serde::Deserialize;

const DIFFERENCE: usize = 1;

const SANDBOX: usize = 2;

const DRILLS: usize = 3;

/// The pane of the decisions, which stands beside the checks if there is room.
const TIMELINE: usize = 4;

const AUDIT: usize = 5;

/// The least columns for the version that it is compared with.
const AGAINST_MIN: usize = 16;

/// Columns from which the timeline stands beside the checks.
const BESIDE_WIDTH: u16 = 110;

/// View 3.
pub struct CandidateBehavior;

impl ConsoleView for CandidateBehavior {
    fn description(&self) -> &'static ViewDescription {
        &ViewDescription {
            title: "Candidate",
            brief_title: "Candid.",
            action: "candidate",
            keys: &["3"],
            help: wording::HELP,
            tour: wording::TOUR,
            panes: &["Checks", "Difference", "Sandbox", "Drills", "Timeline", "Audit"],
            scopes: &[Scope::Version],
            fixed_order: Some(ORDER_OF_TIME),
            queries_by_pane: false,
            is_about_version: true,
        }
    }

    fn row_count(&self, model: &ConsoleModel) -> usize {
        model.candidate_rows(model.view_state.pane()).len()
    }

    fn item_key(&self, model: &ConsoleModel, row: usize) -> Option<ItemKey> {
        row_keys(&model.candidate_rows(model.view_state.pane())).into_iter().nth(row)
    }

    fn row_of(&self, model: &ConsoleModel, key: &ItemKey) -> Option<usize> {
        row_keys(&model.candidate_rows(model.view_state.pane())).iter().position(|item| item == key)
    }

    fn version_here(&self, model: &ConsoleModel) -> Option<CapabilityId> {
        model.subject()
    }

    fn row_texts(&self, model: &ConsoleModel) -> Vec<String> {
        model.candidate_rows(model.view_state.pane()).iter().map(search_text).collect()
    }

    fn hints(&self, _model: &ConsoleModel) -> &'static [Action] {
        &[
            Action::Open,
            Action::NextPane,
            Action::OpenRecording,
            Action::Pause,
            Action::Resume,
            Action::Continue,
            Action::Refuse,
            Action::Rollback,
            Action::Release,
            Action::Repeat,
            Action::Rearm,
            Action::Abort,
            Action::Copy,
        ]
    }

    fn hint_label(&self, _model: &ConsoleModel, action: Action) -> Option<&'static str> {
        (action == Action::Open).then_some("why")
    }

    fn can_open(&self, model: &ConsoleModel, _rows: usize, _version: Option<&CapabilityId>) -> bool {
        model.subject_detail().is_some_and(|detail| !detail.why.is_empty())
    }

    fn query(&self, model: &ConsoleModel) -> Option<EngineQuery> {
        model.subject().map(EngineQuery::Detail)
    }

    fn data(&self, model: &ConsoleModel) -> serde_json::Result<serde_json::Value> {
        serde_json::to_value(model.engine_data.detail.as_deref())
    }

    fn open(&self, model: &mut ConsoleModel) -> Vec<Effect> {
        if why::open(model) { Vec::new() } else { navigation::step_pane(model, true) }
    }

    fn draw(&self, model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
        draw(model, pen, area);
    }

    fn small_rows(&self, model: &ConsoleModel, pen: &Pen<'_>, width: usize) -> Vec<Row> {
        let rows = model.candidate_rows(model.view_state.pane());
        let first = |row| item(model, row, pen.look, width).into_iter().next();
        rows.iter().map(|row| first(row).unwrap_or_default()).collect()
    }
}

fn draw(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    let Some(subject) = model.subject() else {
        pen.text(area, 0, ThemeRole::Muted, wording::NO_CANDIDATE);
        return;
    };
    let Some(detail) = model.subject_detail() else {
        let glyph = pen.look.glyph(Glyph::Running);
        pen.text(area, 0, ThemeRole::Muted, &wording::asking_the_engine(glyph, &subject));
        return;
    };
    let head = heading(model, detail, pen.look, usize::from(area.width), pen.fit);
    let at = pen.rows(area, 0, &head);
    let area = below(area, at);
    let pane = model.view_state.pane();
    let rows = model.candidate_rows(pane);
    let cursor = if model.view_state.view == View::Candidate { model.row() } else { 0 };
    let place = Row::of(ThemeRole::Muted, &place(rows.len(), cursor));
    let width = usize::from(area.width);
    pen.row(area, 0, &tabs::panes(model).to_column(width.saturating_sub(place.width())).and(place));
    let area = below(area, 1);
    if pane == 0 && area.width >= BESIDE_WIDTH {
        let (left, right) = pen.split(area, area.width * 3 / 5);
        items(model, &rows, cursor, &without_rows(model, detail, pane, pen.look), pen, left);
        let inside = pen.pane(right, "Timeline", false, "");
        let decisions = model.candidate_rows(TIMELINE);
        timeline(model, &decisions, pen, inside);
    } else {
        items(model, &rows, cursor, &without_rows(model, detail, pane, pen.look), pen, area);
    }
}

/// The version, its counterpart, its state, its status, and its author's statement.
fn heading(model: &ConsoleModel, detail: &Detail, look: &Look, width: usize, fit: Fit) -> Vec<Row> {
    let name = detail.version.to_string();
    let against = detail.against.as_ref().map_or_else(String::new, |against| format!(" against {against}"));
    let candidate = model.candidate(&detail.version);
    let state = model.version_state(&detail.version).map_or_else(Row::new, |(state, flags)| {
        let room = width.saturating_sub(name.width() + against.width() + 2);
        let shown = candidate.map(|candidate| super::candidate_state(candidate, room, look));
        Row::of(ThemeRole::Text, "  ")
            .and(shown.unwrap_or_else(|| super::state_row(state, &flags, room, look)))
    });
    // A long name loses its middle, and the version it is compared with gives way; the state stays whole.
    let room = width.saturating_sub(state.width());
    let mut first = Row::of(ThemeRole::Title, &super::cut_middle(&name, room));
    let room = room.saturating_sub(first.width());
    if room >= AGAINST_MIN {
        first.push(ThemeRole::Muted, &super::cut_middle(&against, room));
    }
    first = first.and(state);
    let short = super::short;
    // Before the assessment, the engine has only the author's estimate.
    let basis = if detail.risk_causes.is_empty() { "estimated risk" } else { "risk" };
    let (author, origin) = (short(&detail.author, 20), origin(detail.provenance));
    first.push(ThemeRole::Muted, &format!("  {author}, {origin}, {basis} {}", detail.risk));
    let mut rows = vec![first];
    let now = model.engine_data.snapshot.as_deref();
    if let Some(status) = now.and_then(|now| Some(now.status(candidate?))) {
        let told = version_status(&detail.version, &status);
        // The cause comes first, and in full where there is room.
        let lines = if fit >= Fit::Two { 2 } else { 1 };
        rows.extend(wrap(&told, width, lines).iter().map(|line| Row::of(ThemeRole::Text, line)));
    }
    let lines = if fit >= Fit::Two { 2 } else { 1 };
    rows.extend(wrap(&detail.summary, width, lines).iter().map(|line| Row::of(ThemeRole::Text, line)));
    if fit >= Fit::Two {
        if let Some(candidate) = candidate {
            rows.push(pipeline::strip(candidate, look, width));
        }
        let parent = detail.parent.as_ref().map_or_else(|| "nothing".to_owned(), ToString::to_string);
        rows.push(Row::of(
            ThemeRole::Muted,
            &wording::origin(
                &detail.digest.short(),
                &detail.evidence.map_or_else(|| "none yet".to_owned(), |digest| digest.short()),
                &short(&parent, 24),
                &detail.registered_at.map_or_else(|| model.moment(detail.registered_ms), WallTime::label),
            ),
        ));
    }
    rows.extend(waived_line(model, detail).map(|line| Row::of(ThemeRole::Warning, &short(&line, width))));
    let stale = candidate.and_then(|candidate| stale_evidence(&candidate.stale));
    rows.extend(stale.map(|line| Row::of(ThemeRole::Warning, &line)));
    let counted = candidate.and_then(|candidate| candidate.counted.as_ref());
    let counted = counted.map(|counted| counted_try(&detail.version.family, counted));
    rows.extend(counted.map(|line| Row::of(ThemeRole::Muted, &short(&line, width))));
    // A version that is out of the pipeline is deployed nowhere, whatever an earlier decision gave.
    let in_pipeline = candidate.filter(|candidate| !candidate.state.is_terminal());
    if let Some(deployment) = in_pipeline.and_then(|candidate| candidate.deployment) {
        rows.push(Row::of(ThemeRole::Text, &format!("deployment {deployment}")));
    }
    rows
}

/// The limits that an active version was admitted below, and whose approvals its activation used; absent without both.
fn waived_line(model: &ConsoleModel, detail: &Detail) -> Option<String> {
    let (State::Active, _) = model.version_state(&detail.version)? else { return None };
    let below = below_limit(&detail.dimensions);
    let people = used_approvals(&detail.audit);
    (!below.is_empty() && !people.is_empty())
        .then(|| wording::admitted_and_waived(&below.join(", "), &people.join(", ")))
}

/// The people whose approvals the newest activation used, by the version's records, newest first.
fn used_approvals(records: &[AuditRecord]) -> Vec<String> {
    let changes = |kind: RecordKind| {
        let of_kind = records.iter().filter(move |record| record.kind.known() == Some(&kind));
        of_kind.filter_map(|record| serde_json::from_str::<ApprovalRecordBody>(&record.body).ok())
    };
    let used: Vec<String> = changes(RecordKind::ApprovalConsumed).map(|record| record.change.nonce).collect();
    let approvals = changes(RecordKind::ApprovalPut).map(|record| record.change);
    let approvals: Vec<RecordedVote> = approvals.filter(|approval| used.contains(&approval.nonce)).collect();
    // Those of an earlier activation were for other evidence.
    let newest = approvals.first().map(|approval| approval.evidence_digest.clone());
    let is_newest = |approval: &RecordedVote| Some(&approval.evidence_digest) == newest.as_ref();
    approvals.into_iter().filter(is_newest).map(|approval| approval.who).collect()
}

/// The body of a record of an approval.
#[derive(Deserialize)]
struct ApprovalRecordBody {
    change: RecordedVote,
}

#[derive(Deserialize)]
struct RecordedVote {
    nonce: String,
    #[serde(default)]
    evidence_digest: String,
    /// Empty where an approval is used.
    #[serde(default)]
    who: String,
}

/// What stands in a pane without rows: why it has none and, of a commissioned version, its open alarms. `enter` on an alarm
/// leads here.
fn without_rows(model: &ConsoleModel, detail: &Detail, pane: usize, look: &Look) -> Vec<String> {
    let mut lines = vec![nothing(model, detail, pane)];
    if !is_commissioned(model, detail) || matches!(pane, DIFFERENCE | TIMELINE | AUDIT) {
        return lines;
    }
    for alarm in model.engine_data.snapshot.iter().flat_map(|now| &now.alarms) {
        let Ok(key) = alarm.alarm.parse::<AlarmKey>() else { continue };
        if key.version() != Some(&detail.version) {
            continue;
        }
        let (priority, since) = (priority_label(look, alarm.priority), model.moment(alarm.since_ms));
        lines.push(format!("{priority} since {since}: {}", notice(&alarm.text)));
        lines.push(format!("  {}", shared::without_action(alarm_wording::consequence(key.kind()))));
        lines.push(format!("  {}", shared::look_at(alarm_wording::look_at(key.kind()))));
    }
    lines.push(wording::shows_live_tasks(&model.keymap.key(Action::Show(View::Health))));
    lines
}

/// Whether a version came with the cell: no evaluation is on record.
fn is_commissioned(model: &ConsoleModel, detail: &Detail) -> bool {
    model.candidate(&detail.version).is_none() && detail.dimensions.is_empty()
}

/// Why a pane has no rows.
fn nothing(model: &ConsoleModel, detail: &Detail, pane: usize) -> String {
    let current = model.version_state(&detail.version);
    match (pane, &detail.against) {
        (DIFFERENCE, Some(against)) => wording::no_field_differs(against),
        (DIFFERENCE, None) => match current.map(|(state, _)| state) {
            Some(State::Active | State::Superseded | State::RolledBack) => {
                wording::TOOK_OVER_FROM_NONE.to_owned()
            }
            _ => wording::nothing_to_compare_with(&detail.version.family),
        },
        (TIMELINE, _) => wording::NO_DECISION_YET.to_owned(),
        (AUDIT, _) => wording::NO_RECORD_READ.to_owned(),
        _ if is_commissioned(model, detail) => wording::COMMISSIONED.to_owned(),
        (place, _) => {
            let what = match place {
                SANDBOX => wording::NO_SANDBOX_EPISODE,
                DRILLS => wording::NO_RECOVERY_DRILL,
                _ => wording::NO_CHECK,
            };
            match current {
                Some((state, _)) if state.is_terminal() => wording::nothing_on_record(what, state.name()),
                _ => wording::nothing_ran_yet(what),
            }
        }
    }
}

/// Rows of differing height, scrolled so that the one under the cursor is in sight.
fn items(
    model: &ConsoleModel,
    rows: &[CandidateItem<'_>],
    cursor: usize,
    nothing: &[String],
    pen: &mut Pen<'_>,
    area: Rect,
) {
    if rows.is_empty() {
        let mut at = 0_u16;
        for line in nothing {
            at = at.saturating_add(pen.text(area, at, ThemeRole::Muted, line));
        }
        return;
    }
    let look = pen.look;
    let width = usize::from(area.width.saturating_sub(2));
    let height = usize::from(area.height);
    let (marks, inner) = (Rect { width: area.width.min(1), ..area }, super::indented(area));
    // Up from the cursor for half the height, but no further than can be shown.
    let mut first = cursor;
    let mut above = 0;
    while let Some(row) = first.checked_sub(1).and_then(|before| rows.get(before)) {
        above += item(model, row, look, width).len();
        if above > height / 2 {
            break;
        }
        first -= 1;
    }
    let mut at = 0u16;
    for (index, row) in rows.iter().enumerate().skip(first) {
        if at >= area.height {
            break;
        }
        let taken = pen.rows(inner, at, &item(model, row, look, width));
        let place = Rect { y: area.y + at, height: taken.min(area.height - at), ..area };
        pen.hit(place, Hit::Row { pane: None, row: index });
        if index == cursor {
            pen.row(marks, at, &Row::of(ThemeRole::Text, look.glyph(Glyph::Here)));
            pen.lay(Rect { y: area.y + at, height: 1, ..area }, ThemeRole::Selected);
        }
        at = at.saturating_add(taken);
    }
}

fn timeline(model: &ConsoleModel, rows: &[CandidateItem<'_>], pen: &mut Pen<'_>, area: Rect) {
    let look = pen.look;
    let width = usize::from(area.width);
    let mut rest = area;
    for row in rows {
        let lines = item(model, row, look, width);
        let taken = pen.rows(rest, 0, &lines);
        (_, rest) = cut(rest, taken);
        if rest.is_empty() {
            return;
        }
    }
    if rows.is_empty() {
        pen.text(area, 0, ThemeRole::Muted, wording::NO_DECISION);
    }
}
