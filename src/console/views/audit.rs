//! View 7: the log in sentences by kind, the state of its chain, the engine's metrics since its start, and the record
//! under the cursor; Enter shows it raw.
//!
//! ```text
//! [Events] People Alarms  Store  All                                   1 of 4
//! ✔ chain holds, 391 records checked
//!   number time      engine    kind          about        what it says
//! ▸ 391    08:12:22  00:12:22  approval-put  align@2.0.0  grace says approve: read the evidence
//! ── Record 391 ─────────────────────────────── enter shows it raw ─
//! ```

use ratatui::layout::Rect;

use super::console_view::{ConsoleView, ORDER_OF_TIME, ViewDescription};
use super::tabs;
use crate::action::{Action, Scope};
use crate::audit::{self, AuditGroup, AuditItem};
use crate::effect::{Effect, EngineQuery};
use crate::formatters::{record_moment, record_time, seconds};
use crate::look::{Glyph, ThemeRole};
use crate::model::{ConsoleModel, ItemKey, OpenedRecord, View};
use crate::widgets::list::{GUTTER, place};
use crate::widgets::pen::{Fit, Pen, below, cut};
use crate::widgets::row::{Row, wrap};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::metrics::store_metrics::ObservedCounts;
use holdpoint_governance::record::AuditRecord;
use holdpoint_wording::console::audit as wording;
use holdpoint_wording::console::record::record_sentence;

/// The most lines for the record under the cursor.
const DETAIL_ROWS_MAX: u16 = 8;

/// Lines of one wrapped line of a raw record.
const RAW_WRAP_ROWS: usize = 12;

/// View 7.
pub struct AuditBehavior;

impl ConsoleView for AuditBehavior {
    fn description(&self) -> &'static ViewDescription {
        &ViewDescription {
            title: "Audit",
            brief_title: "Audit",
            action: "audit",
            keys: &["7"],
            help: "Audit log",
            tour: wording::TOUR,
            panes: &["Events", "People", "Alarms", "Store", "All"],
            scopes: &[Scope::Version],
            fixed_order: Some(ORDER_OF_TIME),
            queries_by_pane: true,
            is_about_version: false,
        }
    }

    fn row_count(&self, model: &ConsoleModel) -> usize {
        model.audit_rows().len()
    }

    fn item_key(&self, model: &ConsoleModel, row: usize) -> Option<ItemKey> {
        model.audit_rows().get(row).map(|row| ItemKey::Record(row.record.seq))
    }

    fn row_of(&self, model: &ConsoleModel, key: &ItemKey) -> Option<usize> {
        let ItemKey::Record(seq) = key else { return None };
        model.audit_rows().iter().position(|row| row.record.seq == *seq)
    }

    fn version_here(&self, model: &ConsoleModel) -> Option<CapabilityId> {
        model.audit_rows().get(model.row())?.record.subject.parse().ok()
    }

    fn row_texts(&self, model: &ConsoleModel) -> Vec<String> {
        let text = |row: &AuditItem<'_>| {
            let record = row.record;
            format!("{} {} {}", record.kind, record.subject, record_sentence(record))
        };
        model.audit_rows().iter().map(text).collect()
    }

    fn is_in_order_of_time(&self, _pane: usize) -> bool {
        true
    }

    fn is_filtered(&self, model: &ConsoleModel) -> bool {
        model.view_state.opened.is_none()
    }

    fn hints(&self, _model: &ConsoleModel) -> &'static [Action] {
        &[Action::Open, Action::NextPane, Action::Verify, Action::Filter, Action::Copy, Action::Export]
    }

    fn hint_label(&self, _model: &ConsoleModel, action: Action) -> Option<&'static str> {
        (action == Action::Open).then_some("raw record")
    }

    fn copied(&self, model: &ConsoleModel) -> Option<String> {
        let rows = model.audit_rows();
        let row = model.opened_record().or_else(|| rows.get(model.row()).map(|row| row.record))?;
        Some(format!("{} {} {} {} {}", row.seq, row.kind, row.subject, row.hash, row.body))
    }

    fn query(&self, model: &ConsoleModel) -> Option<EngineQuery> {
        Some(EngineQuery::Audit(AuditGroup::of_pane(model.view_state.pane_of(View::Audit))))
    }

    fn data(&self, model: &ConsoleModel) -> serde_json::Result<serde_json::Value> {
        serde_json::to_value(&*model.engine_data.audit)
    }

    fn open(&self, model: &mut ConsoleModel) -> Vec<Effect> {
        let seq = model.audit_rows().get(model.row()).map(|row| row.record.seq);
        model.view_state.opened = seq.map(|seq| OpenedRecord { seq, scroll: 0 });
        Vec::new()
    }

    fn draw(&self, model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
        draw(model, pen, area);
    }

    fn small_rows(&self, model: &ConsoleModel, _pen: &Pen<'_>, _width: usize) -> Vec<Row> {
        model.audit_rows().iter().map(brief).collect()
    }
}

fn draw(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    if let Some(record) = model.opened_record() {
        return raw(model, record, pen, area);
    }
    let rows = model.audit_rows();
    let cursor = model.view_state.cursor().min(rows.len().saturating_sub(1));
    let mut at = 1;
    let place = Row::of(ThemeRole::Muted, &place(rows.len(), cursor));
    tabs::draw_panes(model, place, pen, area);
    let inside = area;
    pen.row(inside, at, &verified(model, pen));
    at += 1;
    if let Some(text) = model.engine_data.snapshot.as_ref().and_then(|snapshot| counted(&snapshot.observed)) {
        pen.row(inside, at, &Row::of(ThemeRole::Text, &text));
        at += 1;
    }
    if rows.is_empty() {
        let page = &model.engine_data.audit;
        let text = match (page.head, page.rows.is_empty(), model.filter().is_empty()) {
            // Every store has a first record.
            (0, ..) => wording::NO_RECORD_READ,
            (_, true, true) => wording::NO_RECORD_OF_THIS_KIND,
            (_, false, true) => wording::NO_RECORD_OF_THIS_KIND_READ,
            (_, _, false) => wording::NO_RECORD_FITS,
        };
        pen.text(below(inside, at), 0, ThemeRole::Muted, text);
        return;
    }
    let columns = AuditColumns::of(pen.fit);
    pen.row(inside, at, &columns.header());
    at += 1;
    let room = inside.height.saturating_sub(at);
    let detail = (room / 4).clamp(room.min(3), DETAIL_ROWS_MAX);
    let (list, foot) = cut(below(inside, at), room.saturating_sub(detail));
    pen.list(list, rows.len(), Some(cursor), |index, _| {
        rows.get(index).map_or_else(Row::new, |row| line(row, &columns))
    });
    if let Some(row) = rows.get(cursor) {
        record(model, row, pen, foot);
    }
}

/// Widths of the columns; zero for one without room.
struct AuditColumns {
    number: usize,
    time: usize,
    /// The engine's own time.
    engine: usize,
    kind: usize,
    subject: usize,
}

impl AuditColumns {
    const fn of(fit: Fit) -> Self {
        match fit {
            Fit::Full => Self { number: 7, time: 10, engine: 10, kind: 23, subject: 22 },
            Fit::Two => Self { number: 7, time: 10, engine: 0, kind: 0, subject: 14 },
            Fit::One => Self { number: 7, time: 10, engine: 0, kind: 0, subject: 13 },
            Fit::Tiny => Self { number: 0, time: 9, engine: 0, kind: 0, subject: 12 },
        }
    }

    fn header(&self) -> Row {
        Row::new()
            .to_column(usize::from(GUTTER))
            .cell(ThemeRole::Muted, "number", self.number)
            .cell(ThemeRole::Muted, "time", self.time)
            .cell(ThemeRole::Muted, "engine", self.engine)
            .cell(ThemeRole::Muted, "kind", self.kind)
            .cell(ThemeRole::Muted, "about", self.subject)
            .with(ThemeRole::Muted, wording::SENTENCE_COLUMN)
    }
}

fn line(row: &AuditItem<'_>, columns: &AuditColumns) -> Row {
    let record = row.record;
    let apart = |text: &str, width: usize| super::short(text, width.saturating_sub(1));
    let subject = if record.subject.is_empty() { "-" } else { &record.subject };
    Row::new()
        .cell(ThemeRole::Muted, &apart(&record.seq.to_string(), columns.number), columns.number)
        .cell(ThemeRole::Muted, &apart(&record_time(record), columns.time), columns.time)
        .cell(ThemeRole::Muted, &apart(&seconds(record.at_ms), columns.engine), columns.engine)
        .cell(ThemeRole::Text, &apart(&record.kind.to_string(), columns.kind), columns.kind)
        .cell(ThemeRole::Text, &apart(subject, columns.subject), columns.subject)
        .with(ThemeRole::Text, &summary(row))
}

/// The text of a row; for a run, the number of its records.
fn summary(row: &AuditItem<'_>) -> String {
    if row.count > 1 {
        return wording::run_of_telemetry(row.count, &record_sentence(row.record));
    }
    record_sentence(row.record)
}

/// One line of the log for the smallest windows.
#[must_use]
fn brief(row: &AuditItem<'_>) -> Row {
    line(row, &AuditColumns::of(Fit::Tiny))
}

/// A record as it was written, line by line.
fn raw(model: &ConsoleModel, record: &AuditRecord, pen: &mut Pen<'_>, area: Rect) {
    let lines = audit::raw(record);
    let scroll = model.view_state.opened.map_or(0, |opened| opened.scroll).min(lines.len().saturating_sub(1));
    let key = model.keymap.key(Action::Back);
    let right = wording::raw_place(scroll + 1, lines.len(), &key);
    let inside = pen.pane(area, &wording::raw_title(record.seq), true, &right);
    let width = usize::from(inside.width);
    let shown = lines.iter().skip(scroll).take(usize::from(inside.height));
    let rows: Vec<Row> = shown
        .flat_map(|line| {
            let lead = line.chars().take_while(|sign| *sign == ' ').count().min(width / 2);
            let lines = wrap(line.trim_start(), width.saturating_sub(lead), RAW_WRAP_ROWS);
            let lines = if lines.is_empty() { vec![String::new()] } else { lines };
            lines
                .into_iter()
                .map(move |line| Row::of(ThemeRole::Text, &format!("{}{line}", " ".repeat(lead))))
        })
        .take(usize::from(inside.height))
        .collect();
    pen.rows(inside, 0, &rows);
}

/// The engine's counts since its start; nothing before an upgrade was active in this session.
fn counted(observed: &ObservedCounts) -> Option<String> {
    let ObservedCounts {
        activations,
        unsafe_activations,
        episodes,
        successes: _,
        violations,
        rollbacks,
        recovered,
    } = observed;
    if *activations == 0 && *episodes == 0 {
        return None;
    }
    let mut text = wording::observed(*activations, *unsafe_activations, *episodes, *violations);
    if *rollbacks > 0 {
        text.push_str(&wording::rolled_back_safely(*recovered, *rollbacks));
    }
    Some(text)
}

/// The result of the last check.
fn verified(model: &ConsoleModel, pen: &Pen<'_>) -> Row {
    let key = model.keymap.key(Action::Verify);
    match &model.engine_data.verified {
        None => Row::of(ThemeRole::Unknown, &wording::chain_not_checked(pen.look.glyph(Glyph::Unknown)))
            .with(ThemeRole::Key, &key)
            .with(ThemeRole::Text, wording::CHECKS_IT),
        Some(verified) if verified.holds => Row::of(
            ThemeRole::Good,
            &wording::chain_holds(pen.look.glyph(Glyph::Good), verified.records, &verified.text),
        ),
        Some(verified) => Row::of(
            ThemeRole::Bad,
            &wording::chain_broken(pen.look.glyph(Glyph::Bad), verified.records, &verified.text),
        ),
    }
}

fn record(model: &ConsoleModel, row: &AuditItem<'_>, pen: &mut Pen<'_>, area: Rect) {
    let of = row.record;
    let key = model.keymap.key(Action::Open);
    let right = wording::hash_and_key(&of.hash.short(), &key);
    let inside = pen.pane(area, &format!("Record {}", of.seq), false, &right);
    let head = format!("{}, {} {}", record_moment(of), of.kind, of.subject);
    let at = pen.text(inside, 0, ThemeRole::Title, &head);
    pen.text(inside, at, ThemeRole::Text, &summary(row));
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_are_shown_only_above_zero() {
        let none = ObservedCounts::default();
        let working =
            ObservedCounts { activations: 3, unsafe_activations: 1, episodes: 41, violations: 2, ..none };
        let rolled_back = ObservedCounts { rollbacks: 2, recovered: 1, ..working };
        let counts = wording::observed(3, 1, 41, 2);
        let with_rollbacks = format!("{counts}{}", wording::rolled_back_safely(1, 2));
        for (observed, expected) in
            [(none, None), (working, Some(counts)), (rolled_back, Some(with_rollbacks))]
        {
            assert_eq!(counted(&observed), expected);
        }
    }
}
