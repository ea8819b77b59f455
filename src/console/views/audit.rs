//! View 7: the log, the newest first, whether its chain has been checked, what the engine has counted of the metrics
//! since it came up, and the record under the cursor in full.
//!
//! ```text
//! ▸ Audit ─────────── ✔ chain holds, 391 records checked · 1 of 4 ─
//!   number  time      kind      subject      content
//! ▸ 391     00:12:22  approval  align@2.0.0  {"by":"grace", …
//! ── Record 391 ─────────────────────────────────────────────
//! ```

use ratatui::layout::Rect;

use crate::action::Action;
use crate::look::{Glyph, ThemeRole};
use crate::model::Model;
use crate::widgets::list::place;
use crate::widgets::pen::{Fit, Pen, below, cut};
use crate::widgets::row::Row;
use crate::words::seconds;
use holdpoint_governance::metrics::observed::ObservedCounts;
use holdpoint_governance::record::AuditRecord;

/// Characters of a record's content that a list's row looks at.
const CONTENT_CHARS: usize = 200;

pub fn draw(model: &Model, pen: &mut Pen<'_>, area: Rect) {
    let rows = model.audit_rows();
    let cursor = model.place.cursor().min(rows.len().saturating_sub(1));
    let mut at = 0;
    let inside = pen.pane(area, "Audit", true, &place(rows.len(), cursor));
    pen.row(inside, at, &verified(model, pen));
    at += 1;
    if let Some(text) = model.told.snapshot.as_ref().and_then(|snapshot| counted(&snapshot.observed)) {
        pen.row(inside, at, &Row::of(ThemeRole::Text, &text));
        at += 1;
    }
    if rows.is_empty() {
        let text = if model.filter().is_empty() {
            "No record has been read yet"
        } else {
            "No record fits the filter"
        };
        pen.text(below(inside, at), 0, ThemeRole::Muted, text);
        return;
    }
    let subject = if pen.fit >= Fit::Full { 24 } else { 14 };
    let header = Row::new()
        .to_column(2)
        .cell(ThemeRole::Muted, "number", 8)
        .cell(ThemeRole::Muted, "time", 10)
        .cell(ThemeRole::Muted, "kind", 16)
        .cell(ThemeRole::Muted, "subject", subject + 1)
        .with(ThemeRole::Muted, "content");
    pen.row(inside, at, &header);
    at += 1;
    let room = inside.height.saturating_sub(at);
    let detail = (room / 3).clamp(room.min(4), 10);
    let (list, foot) = cut(below(inside, at), room.saturating_sub(detail));
    pen.list(list, rows.len(), Some(cursor), |index, _| {
        rows.get(index).map_or_else(Row::new, |row| line(row, subject))
    });
    if let Some(row) = rows.get(cursor) {
        record(row, pen, foot);
    }
}

fn line(row: &AuditRecord, subject: usize) -> Row {
    let content: String = row.body.chars().take(CONTENT_CHARS).collect();
    Row::new()
        .cell(ThemeRole::Muted, &row.seq.to_string(), 8)
        .cell(ThemeRole::Muted, &seconds(row.at_ms), 10)
        .cell(ThemeRole::Text, &row.kind.to_string(), 15)
        .with(ThemeRole::Text, " ")
        .cell(ThemeRole::Text, &row.subject, subject)
        .with(ThemeRole::Text, " ")
        .with(ThemeRole::Muted, &content)
}

/// What the engine has counted since it came up; nothing before an upgrade was active in its life.
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
    let mut text = format!(
        "upgrades: {activations} let in, {unsafe_activations} unsafe; {episodes} tasks, {violations} violations"
    );
    if *rollbacks > 0 {
        text.push_str(&format!("; {recovered} of {rollbacks} rolled back safely"));
    }
    Some(text)
}

/// What the last check came to.
fn verified(model: &Model, pen: &Pen<'_>) -> Row {
    let key = model.keymap.key(Action::Verify);
    match &model.told.verified {
        None => Row::of(
            ThemeRole::Unknown,
            &format!("{} chain not checked yet: ", pen.look.glyph(Glyph::Unknown)),
        )
        .with(ThemeRole::Key, &key)
        .with(ThemeRole::Text, " checks it"),
        Some(verified) if verified.holds => Row::of(
            ThemeRole::Good,
            &format!(
                "{} chain holds, {} records checked: {}",
                pen.look.glyph(Glyph::Good),
                verified.records,
                verified.text
            ),
        ),
        Some(verified) => Row::of(
            ThemeRole::Bad,
            &format!(
                "{} CHAIN BROKEN after {} records: {}",
                pen.look.glyph(Glyph::Bad),
                verified.records,
                verified.text
            ),
        ),
    }
}

fn record(row: &AuditRecord, pen: &mut Pen<'_>, area: Rect) {
    let hash = format!("hash {}", row.hash.short());
    let inside = pen.pane(area, &format!("Record {}", row.seq), false, &hash);
    let head = format!("{} {} {}", seconds(row.at_ms), row.kind, row.subject);
    let at = pen.text(inside, 0, ThemeRole::Title, &head);
    pen.text(inside, at, ThemeRole::Text, &row.body);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_was_counted_is_said_once_there_is_something() {
        let none = ObservedCounts::default();
        let working =
            ObservedCounts { activations: 3, unsafe_activations: 1, episodes: 41, violations: 2, ..none };
        let rolled_back = ObservedCounts { rollbacks: 2, recovered: 1, ..working };
        for (observed, expected) in [
            (none, None),
            (working, Some("upgrades: 3 let in, 1 unsafe; 41 tasks, 2 violations")),
            (
                rolled_back,
                Some("upgrades: 3 let in, 1 unsafe; 41 tasks, 2 violations; 1 of 2 rolled back safely"),
            ),
        ] {
            assert_eq!(counted(&observed).as_deref(), expected);
        }
    }
}
