//! View 6: what waits for people, monitors' questions first, and the row under the cursor in short. Enter opens the prompt
//! with the whole decision, or the card of a version that stands.
//!
//! ```text
//! ▸ ◷ question grasp@1.0.0  rolled back in 43 s
//!   ◷ approval align@2.0.0  1 of 2  held in 29 min 2 s
//!   ‖ paused place@1.3.8  paused by mia: odd noise
//! ── align@2.0.0 ─────────────────────────────
//! replaces align@1.0.0 …
//! ```

use ratatui::layout::Rect;

use super::console_view::{ConsoleView, ViewDescription};
use super::overview::{time_left, waiting_row};
use crate::action::{Action, Scope};
use crate::approval_screen::ApprovalScreen;
use crate::effect::Effect;
use crate::formatters::reason_line;
use crate::look::ThemeRole;
use crate::model::{ConsoleModel, ItemKey, Overlay, View};
use crate::update;
use crate::waiting_rows::{WaitingRow, standing};
use crate::widgets::list::{GUTTER, place};
use crate::widgets::pen::{Pen, cut};
use crate::widgets::row::{Row, wrap};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_protocol::snapshot::{CandidateView, EscalationView};
use holdpoint_text::Untrusted;
use holdpoint_wording::console::approvals as wording;

/// View 6.
pub struct ApprovalsBehavior;

impl ConsoleView for ApprovalsBehavior {
    fn description(&self) -> &'static ViewDescription {
        &ViewDescription {
            title: "Approvals",
            brief_title: "Approve",
            action: "approvals",
            keys: &["6", "a"],
            help: wording::HELP,
            tour: wording::TOUR,
            panes: &["List"],
            scopes: &[Scope::Version],
            fixed_order: Some(wording::ORDER_OF_DEADLINES),
            queries_by_pane: false,
            is_about_version: false,
        }
    }

    fn row_count(&self, model: &ConsoleModel) -> usize {
        model.waiting_rows().len()
    }

    fn item_key(&self, model: &ConsoleModel, row: usize) -> Option<ItemKey> {
        model.waiting_rows().get(row).map(WaitingRow::item_key)
    }

    fn row_of(&self, model: &ConsoleModel, key: &ItemKey) -> Option<usize> {
        model.waiting_rows().iter().position(|row| row.item_key() == *key)
    }

    fn version_here(&self, model: &ConsoleModel) -> Option<CapabilityId> {
        model.waiting_rows().get(model.row()).map(|row| row.version().clone())
    }

    fn row_texts(&self, model: &ConsoleModel) -> Vec<String> {
        model.waiting_rows().iter().map(|row| row.version().to_string()).collect()
    }

    fn hints(&self, _model: &ConsoleModel) -> &'static [Action] {
        &[Action::Open, Action::Continue, Action::Resume, Action::Repeat, Action::Rollback, Action::Abort]
    }

    /// Opens the prompt of a waiting approval, or the card of a version with keys of its own: a monitor asks about it,
    /// or it stands until a person acts.
    fn open(&self, model: &mut ConsoleModel) -> Vec<Effect> {
        let prompt = match model.waiting_rows().get(model.row()) {
            Some(WaitingRow::Approval(question)) => model
                .engine_data
                .snapshot
                .as_ref()
                .map(|snapshot| ApprovalScreen::open(question, snapshot, model.now_ms)),
            Some(row @ (WaitingRow::MonitorQuestion(_) | WaitingRow::Standing(_))) => {
                model.view_state.chosen = Some(row.version().clone());
                return update::show(model, View::Candidate);
            }
            None => return update::refuse(model, wording::NOTHING_WAITS),
        };
        match prompt {
            Some(prompt) => {
                model.input.overlay = Some(Overlay::Approval(Box::new(prompt)));
                Vec::new()
            }
            None => update::refuse(model, wording::CANDIDATE_GONE),
        }
    }

    fn draw(&self, model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
        draw(model, pen, area);
    }

    fn small_rows(&self, model: &ConsoleModel, pen: &Pen<'_>, width: usize) -> Vec<Row> {
        model.waiting_rows().iter().map(|item| waiting_row(model, item, pen, width)).collect()
    }
}

fn draw(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    let items = model.waiting_rows();
    let height = u16::try_from(items.len() + 2).unwrap_or(u16::MAX).clamp(3, (area.height / 2).max(3));
    let (upper, lower) = cut(area, height);
    let inside = pen.pane(upper, wording::WAITS_FOR_PEOPLE, true, &place(items.len(), model.row()));
    if items.is_empty() {
        pen.text(inside, 0, ThemeRole::Muted, wording::NOTHING_WAITS_FOR_A_PERSON);
        return;
    }
    let width = usize::from(inside.width.saturating_sub(GUTTER));
    let rows: Vec<Row> = items.iter().map(|item| waiting_row(model, item, pen, width)).collect();
    pen.list(inside, rows.len(), Some(model.row()), |index, _| rows.get(index).cloned().unwrap_or_default());
    let Some(item) = items.get(model.row()) else { return };
    let inside = pen.pane(lower, &item.version().to_string(), false, "");
    let width = usize::from(inside.width);
    let lines = match item {
        WaitingRow::MonitorQuestion(question) => monitor_question_rows(model, question),
        WaitingRow::Standing(candidate) => standing_rows(model, candidate),
        WaitingRow::Approval(question) => {
            let key = model.keymap.key(Action::Open);
            let mut lines = vec![(ThemeRole::Waiting, wording::opens_the_decision(&key))];
            let safe = |line: &String| Untrusted::new(line.clone()).line().into_string();
            let now = model.engine_data.snapshot.as_deref();
            let status = now.and_then(|now| Some(now.status(model.candidate(&question.version)?)));
            let told = status.map(|status| holdpoint_wording::version_status(&question.version, &status));
            lines.extend(told.map(|told| (ThemeRole::Text, safe(&told))));
            lines.extend(question.lines.iter().map(|line| (ThemeRole::Text, safe(line))));
            lines
        }
    };
    let rows: Vec<Row> = lines
        .iter()
        .flat_map(|(role, line)| {
            wrap(line, width, 6).into_iter().map(|line| Row::of(*role, &line)).collect::<Vec<_>>()
        })
        .collect();
    let hidden = rows.len().saturating_sub(usize::from(inside.height));
    pen.rows(inside, 0, &rows);
    if hidden > 0 && inside.height > 0 {
        let last = inside.height - 1;
        let more = wording::more_lines(hidden + 1);
        pen.clear(Rect { y: inside.y + last, height: 1, ..inside });
        pen.row(inside, last, &Row::of(ThemeRole::Muted, &more));
    }
}

/// A version that stands until a person acts: its status, and the keys.
fn standing_rows(model: &ConsoleModel, candidate: &CandidateView) -> Vec<(ThemeRole, String)> {
    let Some(now) = model.engine_data.snapshot.as_deref() else { return Vec::new() };
    let status = now.status(candidate);
    let open = model.keymap.key(Action::Open);
    let act = standing(status.condition).map_or_else(String::new, |(_, action)| {
        wording::act_here_and_there(&model.keymap.key(action), action.name())
    });
    let told = holdpoint_wording::version_status(&candidate.version, &status);
    vec![
        (ThemeRole::Waiting, wording::opens_its_card(&open, &act)),
        (ThemeRole::Text, Untrusted::new(told).line().into_string()),
    ]
}

/// A monitor's question in sentences.
fn monitor_question_rows(model: &ConsoleModel, question: &EscalationView) -> Vec<(ThemeRole, String)> {
    let key = |action| model.keymap.key(action);
    let mut lines = vec![(ThemeRole::Waiting, wording::monitor_asks(&question.version))];
    lines.extend(question.reasons.iter().map(|reason| (ThemeRole::Text, reason_line(reason))));
    let left = time_left(question.deadline_ms, model.engine_ms());
    let by = model.moment(question.deadline_ms);
    lines.push((ThemeRole::Warning, wording::no_answer_by(&by, &left)));
    lines.push((
        ThemeRole::Text,
        wording::monitor_keys(
            &key(Action::Continue),
            &key(Action::Release),
            &key(Action::Rollback),
            &key(Action::Restrict),
        ),
    ));
    lines
}
