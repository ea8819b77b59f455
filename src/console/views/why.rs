//! The explanation of a check's result: the deciding sentence, what would change it, and the measured values.
//!
//! ```text
//! grasp@1.1.0 against grasp@1.0.0        1 of 4: interface  policy [behavior] recovery
//! ✖ behavior 0.412 (at least 0.85) incompatible
//!
//! passes a limit in 38 of 120 episodes, the active version in 0; at most 5 % more is tolerated
//!
//! To pass, this would have to change
//!   violation +0.317 … 32 fewer of 120 episodes
//! Measured, the most serious first; more is worse
//!   ✖  6.3 x tolerated  passes a limit in 38 of 120 episodes …
//! ```

use ratatui::layout::Rect;

use crate::formatters::kappa_line;
use crate::look::{Glyph, Look, ThemeRole};
use crate::model::{ConsoleModel, WhyScreen};
use crate::theme::state_mark::of_dimension;
use crate::widgets::pen::{Pen, below};
use crate::widgets::row::{Row, safe, wrap};
use holdpoint_governance::outcome::DimensionOutcome;
use holdpoint_protocol::detail::{Detail, FindingVerdict, RationaleFinding, RationaleView};
use holdpoint_wording::console::why as wording;

/// The most lines of one text.
const LINES_MAX: usize = 6;

/// The longest difference, columns.
const DIFFERENCE_MAX: usize = 160;

/// Columns of a finding's sign and weight.
const WEIGHT: usize = 22;

/// Draws it in place of the view.
pub fn draw(model: &ConsoleModel, screen: &WhyScreen, pen: &mut Pen<'_>, area: Rect) {
    pen.clear(area);
    let detail = model.subject_detail().filter(|detail| detail.version == screen.version);
    let Some((detail, why)) = detail.and_then(|detail| Some((detail, detail.why.get(screen.at)?))) else {
        pen.text(area, 0, ThemeRole::Muted, wording::NO_SUCH_CHECK);
        return;
    };
    let width = usize::from(area.width);
    pen.row(area, 0, &heading(detail, screen, width));
    let area = below(area, 1);
    let rows = rows(detail, why, pen.look, width);
    let most = rows.len().saturating_sub(usize::from(area.height));
    let first = screen.scroll.min(most);
    pen.rows(area, 0, rows.get(first..).unwrap_or_default());
    let hidden = rows.len().saturating_sub(first + usize::from(area.height));
    if hidden > 0 && area.height > 0 {
        let (y, text) =
            (area.height - 1, format!("{} {} more below", pen.look.glyph(Glyph::Down), hidden + 1));
        pen.clear(Rect { y: area.y + y, height: 1, ..area });
        pen.text(area, y, ThemeRole::Muted, &text);
    }
}

/// The explained check, and the other explanations.
fn heading(detail: &Detail, screen: &WhyScreen, width: usize) -> Row {
    let mut row = Row::of(ThemeRole::Title, &safe(&detail.version.to_string(), width));
    if let Some(against) = &detail.against {
        row.push(ThemeRole::Muted, &format!(" against {against}"));
    }
    let mut names = Row::new();
    for (at, why) in detail.why.iter().enumerate() {
        let here = at == screen.at;
        let (open, close) = if here { ("[", "]") } else { (" ", " ") };
        let role = if here { ThemeRole::Focus } else { ThemeRole::Muted };
        names.push(role, &format!("{open}{}{close}", why.about.name()));
    }
    if row.width() + names.width() + 2 > width {
        return row;
    }
    row.to_column(width.saturating_sub(names.width())).and(names)
}

/// The whole explanation, in rows of at most `width` columns.
#[must_use]
pub fn rows(detail: &Detail, why: &RationaleView, look: &Look, width: usize) -> Vec<Row> {
    let mut rows = Vec::new();
    let outcome = detail.dimensions.iter().find(|result| result.dimension == why.about);
    match outcome {
        Some(result) => {
            let (glyph, role) = of_dimension(result.outcome);
            rows.push(Row::of(role, &format!("{} {}", look.glyph(glyph), kappa_line(result))));
        }
        None => rows.push(Row::of(ThemeRole::Title, why.about.name())),
    }
    rows.push(Row::new());
    push_text(&mut rows, ThemeRole::Value, "", &sentence(&why.decisive), width);
    if !why.change.is_empty() {
        rows.push(Row::new());
        rows.push(Row::of(ThemeRole::Title, change_title(outcome.map(|result| result.outcome))));
        for text in &why.change {
            push_text(&mut rows, ThemeRole::Text, "  ", text, width);
        }
    }
    if !why.findings.is_empty() {
        rows.push(Row::new());
        rows.push(Row::of(ThemeRole::Title, wording::MEASURED));
        for finding in &why.findings {
            push_finding(&mut rows, finding, look, width);
        }
    }
    if !detail.differences.is_empty() {
        rows.push(Row::new());
        rows.push(Row::of(ThemeRole::Title, wording::DIFFERENCES));
        let arrow = look.glyph(Glyph::Arrow);
        for one in &detail.differences {
            let text =
                format!("{} {} {arrow} {}", one.field, value(one.old.as_ref()), value(one.new.as_ref()));
            push_text(&mut rows, ThemeRole::Text, "  ", &safe(&text, DIFFERENCE_MAX), width);
        }
    }
    rows
}

/// What the changes are for: a check with these outcomes passes already.
const fn change_title(of: Option<DimensionOutcome>) -> &'static str {
    match of {
        Some(
            DimensionOutcome::Compatible
            | DimensionOutcome::Conditional
            | DimensionOutcome::Suspicious
            | DimensionOutcome::Fragile,
        ) => wording::TO_PASS_UNRESTRICTED,
        Some(
            DimensionOutcome::Review
            | DimensionOutcome::Incompatible
            | DimensionOutcome::Inconclusive
            | DimensionOutcome::NoData,
        )
        | None => wording::TO_PASS,
    }
}

/// The value of a field as text, or a note that it is missing.
fn value(of: Option<&serde_json::Value>) -> String {
    match of {
        None => "(none)".to_owned(),
        Some(serde_json::Value::String(text)) => text.clone(),
        Some(other) => other.to_string(),
    }
}

/// With a capital and a period.
fn sentence(text: &str) -> String {
    let mut letters = text.chars();
    let first: String = letters.next().map(char::to_uppercase).into_iter().flatten().collect();
    format!("{first}{}.", letters.as_str())
}

fn push_text(rows: &mut Vec<Row>, role: ThemeRole, lead: &str, text: &str, width: usize) {
    let lines = wrap(text, width.saturating_sub(lead.len()), LINES_MAX);
    rows.extend(lines.iter().map(|line| Row::of(role, &format!("{lead}{line}"))));
}

fn push_finding(rows: &mut Vec<Row>, finding: &RationaleFinding, look: &Look, width: usize) {
    let (glyph, role) = match finding.verdict {
        FindingVerdict::Worse => (Glyph::Bad, ThemeRole::Bad),
        FindingVerdict::Doubtful => (Glyph::Warning, ThemeRole::Warning),
        FindingVerdict::Tolerable => (Glyph::Good, ThemeRole::Good),
    };
    let weight = match finding.weight {
        Some(weight) if weight > 0.0 && weight < 1_000.0 => format!("{weight:>5.1} x tolerated"),
        Some(weight) if weight > 0.0 => wording::FAR_BEYOND.to_owned(),
        Some(_) => wording::NO_WORSE.to_owned(),
        None => String::new(),
    };
    // If the weight would leave no room, it stands before the text.
    let column = if width >= 3 * WEIGHT && finding.weight.is_some() { WEIGHT } else { 4 };
    let lines = wrap(&finding.text, width.saturating_sub(column), LINES_MAX);
    for (at, line) in lines.iter().enumerate() {
        let lead = match (at, column == WEIGHT) {
            (0, true) => Row::of(role, &format!("  {} ", look.glyph(glyph))).with(ThemeRole::Muted, &weight),
            (0, false) => Row::of(role, &format!("  {} ", look.glyph(glyph))),
            _ => Row::new(),
        };
        rows.push(lead.to_column(column).with(ThemeRole::Text, line));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_governance::outcome::{BehaviorOutcome, CheckResult, PolicyOutcome, RecoveryOutcome};

    /// Regression: a check that passes with conditions said `To pass, this would have to change`.
    #[test]
    fn changes_of_a_check_that_passes_are_not_there_to_pass() {
        for outcome in DimensionOutcome::ALL {
            let result = match outcome {
                DimensionOutcome::Compatible => CheckResult::Pass,
                DimensionOutcome::Conditional => PolicyOutcome::Conditional.into(),
                DimensionOutcome::Review => PolicyOutcome::Review.into(),
                DimensionOutcome::Suspicious => BehaviorOutcome::Suspicious.into(),
                DimensionOutcome::Fragile => RecoveryOutcome::Fragile.into(),
                DimensionOutcome::Incompatible => CheckResult::Fail,
                DimensionOutcome::Inconclusive => BehaviorOutcome::Inconclusive.into(),
                DimensionOutcome::NoData => CheckResult::NoData,
            };
            let passes = change_title(Some(outcome)) == wording::TO_PASS_UNRESTRICTED;
            assert_eq!(passes, result.advances(), "{outcome}");
        }
        assert_eq!(change_title(None), wording::TO_PASS);
    }

    #[test]
    fn a_sentence_begins_and_ends_as_one() {
        assert_eq!(sentence("passes a limit"), "Passes a limit.");
        assert_eq!(sentence(""), ".");
    }
}
