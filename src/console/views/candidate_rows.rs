//! The rows of the candidate view: each kind of fact in one to a few lines.

use crate::formatters::{reason_line, record_time};
use crate::look::{Glyph, Look, ThemeRole};
use crate::model::ConsoleModel;
use crate::rows::CandidateItem;
use crate::theme::state_mark::{of_dimension, of_ruling};
use crate::widgets::bar::against_limit;
use crate::widgets::row::{Row, wrap};
use holdpoint_governance::decision::Reason;
use holdpoint_governance::outcome::DimensionOutcome;
use holdpoint_protocol::detail::{DrillView, FieldDiff, MeasuredValue};
use holdpoint_protocol::event::DimensionResult;
use holdpoint_protocol::explanation::DecisionExplanation;
use holdpoint_record::rationale::remedy::is_in_favor;
use holdpoint_wording::console::candidate as wording;
use holdpoint_wording::explanation::permission_use;
use serde_json::Value;

/// Lines of one wrapped text.
const LINES_MAX: usize = 6;

/// The lines of a row, at most `width` columns wide.
#[must_use]
pub fn item(model: &ConsoleModel, item: &CandidateItem<'_>, look: &Look, width: usize) -> Vec<Row> {
    match item {
        CandidateItem::Dimension(result) => vec![dimension(result, look, width)],
        CandidateItem::Worsening(measure) => vec![worsened(measure, look, width)],
        CandidateItem::Measure(measure) => vec![measured(measure, width)],
        CandidateItem::Reason(reason) => text(ThemeRole::Text, &signed_reason(reason), width),
        CandidateItem::Unproven(reason, measure) => {
            let caveat = wording::not_established(&change(measure.interval.unwrap_or_default()));
            text(ThemeRole::Text, &format!("{}; {caveat}", signed_reason(reason)), width)
        }
        CandidateItem::Condition(condition) => {
            let glyph = look.glyph(Glyph::Warning);
            let condition = holdpoint_wording::condition_of_use(condition);
            text(ThemeRole::Warning, &format!("{glyph} condition: {condition}"), width)
        }
        CandidateItem::Untested(what) => {
            let glyph = look.glyph(Glyph::Unknown);
            text(ThemeRole::Unknown, &wording::not_tested(glyph, what), width)
        }
        CandidateItem::Difference(difference) => differs(difference, width),
        CandidateItem::Mode(mode) => {
            vec![Row::of(ThemeRole::Title, &format!("mode {}", super::short(mode, width)))]
        }
        CandidateItem::Drill(drill) => vec![drilled(drill, look, width)],
        CandidateItem::Decision(decision) => decision_rows(model, decision, look, width),
        CandidateItem::Record(record) => vec![
            Row::new()
                .cell(ThemeRole::Muted, &record.seq.to_string(), 7)
                .cell(ThemeRole::Muted, &record_time(record), 10)
                .cell(ThemeRole::Text, &record.kind.to_string(), 15)
                .with(ThemeRole::Muted, " ")
                .with(ThemeRole::Text, &super::short(&record.body, 400)),
        ],
    }
}

/// Whether a reason speaks for the version.
const fn sign(in_favor: bool) -> &'static str {
    if in_favor { "+" } else { "-" }
}

fn signed_reason(reason: &Reason) -> String {
    format!("{} {}", sign(is_in_favor(reason.code)), reason_line(reason))
}

fn text(role: ThemeRole, text: &str, width: usize) -> Vec<Row> {
    let mut lines = wrap(text, width.saturating_sub(2), LINES_MAX).into_iter();
    let first = lines.next().map(|line| Row::of(role, &line));
    let rest = lines.map(|line| Row::of(role, &format!("  {line}")));
    first.into_iter().chain(rest).collect()
}

fn dimension(result: &DimensionResult, look: &Look, width: usize) -> Row {
    // The outcome of declarations alone is no result of a measurement.
    let is_declared =
        result.kappa.is_none() && !result.measured && result.outcome == DimensionOutcome::Compatible;
    let (glyph, role) =
        if is_declared { (Glyph::Unknown, ThemeRole::Unknown) } else { of_dimension(result.outcome) };
    let value = match result.kappa {
        Some(kappa) => format!("{kappa:.3}"),
        None if is_declared => "  -  ".to_owned(),
        None => "  ?  ".to_owned(),
    };
    let mut row = Row::of(role, &format!("{} ", look.glyph(glyph)))
        .cell(ThemeRole::Text, result.dimension.name(), 10)
        .with(ThemeRole::Value, &format!("{value} "));
    let interval = result.interval.map_or_else(String::new, |[low, high]| format!(" [{low:.3}, {high:.3}]"));
    let tail = Row::new()
        .cell(ThemeRole::Muted, &interval, 16)
        .with(ThemeRole::Limit, &format!(" limit {:.2} ", result.threshold))
        .cell(role, result.outcome.name(), 13);
    let bar = width.saturating_sub(row.width() + tail.width()).min(24);
    row = if is_declared {
        row.cell(ThemeRole::Muted, wording::NOT_MEASURED_YET, bar)
    } else {
        row.and(against_limit(look, result.kappa, result.threshold, bar))
    };
    row = row.and(tail);
    if !result.measured && !is_declared && row.width() + 10 <= width {
        row.push(ThemeRole::Muted, " estimated");
    }
    row
}

/// A component: both values, and the candidate's worsening against the margin.
fn worsened(measure: &MeasuredValue, look: &Look, width: usize) -> Row {
    let mut row = values(measure, width);
    let Some([low, high]) = measure.interval else {
        row.push(ThemeRole::Muted, wording::NOT_COMPARED);
        return row;
    };
    row.push(ThemeRole::Muted, &format!(" {}", change([low, high])));
    if let Some(limit) = measure.limit {
        // The rules judge; a value that may lie beyond the limit is only marked.
        if high > limit {
            row.push(ThemeRole::Warning, &format!(" {}", look.glyph(Glyph::Warning)));
        }
        row.push(ThemeRole::Limit, &format!(" max {limit:.3}"));
    }
    row
}

/// An interval of a worsening without signs: a negative one is an improvement.
fn change([low, high]: [f64; 2]) -> String {
    if high < 0.0 {
        wording::better_by(-high, -low)
    } else if low < 0.0 {
        wording::better_to_worse(-low, high)
    } else {
        wording::worse_by(low, high)
    }
}

/// A measured value of the candidate, with its interval, beside the active version's.
fn measured(measure: &MeasuredValue, width: usize) -> Row {
    let mut row = values(measure, width);
    if let Some([low, high]) = measure.interval {
        row.push(ThemeRole::Muted, &format!(" [{low:.3}, {high:.3}]"));
    }
    row.push(ThemeRole::Muted, &format!(" n {}", measure.n));
    row
}

fn values(measure: &MeasuredValue, width: usize) -> Row {
    let number = |value: Option<f64>| value.map_or_else(|| "?".to_owned(), |value| format!("{value:.3}"));
    // The names of components are short; those of tails contain their component.
    let (name_width, value_width) = match (measure.limit.is_some(), width >= 60) {
        // A measure of harm, or of sequences, needs more room than a component.
        (true, _) => (measure.name.chars().count().clamp(10, (width / 3).max(10)), 6),
        (false, true) => (38, 8),
        (false, false) => (14, 8),
    };
    let row = Row::new().cell(ThemeRole::Text, &measure.name, name_width).cell_right(
        ThemeRole::Value,
        &number(measure.candidate),
        value_width,
    );
    match measure.active {
        Some(active) => row.with(ThemeRole::Muted, &format!(" against {active:.3}")),
        None => row,
    }
}

fn differs(difference: &FieldDiff, width: usize) -> Vec<Row> {
    let mut rows = vec![Row::of(ThemeRole::Title, &super::short(&difference.field, width))];
    let mut line = |sign: &'static str, role: ThemeRole, value: &str| {
        let lines = wrap(value, width.saturating_sub(4), LINES_MAX);
        rows.extend(lines.iter().map(|line| Row::of(role, &format!("  {sign} {line}"))));
    };
    let value_text = |value: &Option<Value>, missing: &str| match value {
        None => missing.to_owned(),
        Some(Value::String(text)) => text.clone(),
        Some(other) => other.to_string(),
    };
    line("-", ThemeRole::Removed, &value_text(&difference.old, "(not there)"));
    line("+", ThemeRole::Added, &value_text(&difference.new, "(gone)"));
    rows
}

fn drilled(drill: &DrillView, look: &Look, width: usize) -> Row {
    let share = |[passed, all]: [u64; 2]| (all > 0).then(|| passed as f64 / all as f64);
    let ([passed, all], [active_passed, active_all]) = (drill.candidate, drill.active);
    let limit = share(drill.active).unwrap_or(0.0);
    let worse = share(drill.candidate).is_some_and(|share| share < limit);
    let (glyph, role) = match share(drill.candidate) {
        None => (Glyph::Unknown, ThemeRole::Unknown),
        Some(_) if worse => (Glyph::Warning, ThemeRole::Warning),
        Some(_) => (Glyph::Good, ThemeRole::Good),
    };
    let row = Row::of(role, look.glyph(glyph))
        .with(ThemeRole::Text, " ")
        .cell(ThemeRole::Text, drill.kind.name(), 12)
        .cell_right(ThemeRole::Value, &format!("{passed} of {all}"), 12)
        .with(ThemeRole::Text, " ");
    let tail = Row::of(ThemeRole::Muted, &wording::drills_of_the_active(active_passed, active_all));
    let bar = width.saturating_sub(row.width() + tail.width()).min(24);
    row.and(against_limit(look, share(drill.candidate), limit, bar)).and(tail)
}

/// A decision with its reasons, what would change it, and its result.
fn decision_rows(
    model: &ConsoleModel,
    decision: &DecisionExplanation,
    look: &Look,
    width: usize,
) -> Vec<Row> {
    let (glyph, role) = of_ruling(&decision.ruling);
    let mut rows = vec![
        Row::of(ThemeRole::Muted, &format!("{} ", model.moment(decision.at_ms)))
            .with(ThemeRole::Title, &format!("{} ", decision.ruling.stage()))
            .with(role, &format!("{} {}", look.glyph(glyph), super::short(&decision.ruling.outcome(), 40))),
    ];
    let mut say = |role: ThemeRole, line: &str| {
        let lines = wrap(line, width.saturating_sub(4), LINES_MAX);
        rows.extend(lines.iter().map(|line| Row::of(role, &format!("  {line}"))));
    };
    say(ThemeRole::Muted, &format!("record {}", decision.record));
    for reason in &decision.reasons {
        let sign = sign(reason.in_favour);
        let measured = reason.measured.as_deref().map(|text| format!(" ({text})")).unwrap_or_default();
        let code = reason.code.as_ref().map(ToString::to_string).unwrap_or_default();
        say(ThemeRole::Text, &format!("{sign} {code}: {}{measured}", reason.text));
    }
    for change in &decision.change {
        say(ThemeRole::Text, &wording::would_change_it(change));
    }
    for text in decision.permissions.iter().flat_map(permission_use) {
        say(ThemeRole::Text, &format!("permissions: {text}"));
    }
    for then in &decision.then {
        say(ThemeRole::Muted, &format!("then: {then}"));
    }
    rows
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test says what it expects by failing")]
mod tests {
    use holdpoint_governance::behavior::ComponentName;
    use holdpoint_governance::decision::Dimension;
    use holdpoint_governance::finding::Finding;

    use super::*;
    use crate::look::{ColorDepth, Glyphs, Theme};

    /// The card said `✔ recovery ? compatible` before any drill had run.
    #[test]
    fn a_declared_outcome_is_no_measured_one() {
        let look = Look::new(Theme::builtin("mono").unwrap(), ColorDepth::Mono, Glyphs::Unicode);
        let text = |kappa: Option<f64>, measured: bool, outcome: DimensionOutcome| {
            let (of, interval, threshold) = (Dimension::Recovery, None, 0.85);
            let result = DimensionResult { dimension: of, outcome, kappa, interval, threshold, measured };
            dimension(&result, &look, 100).parts().map(|(text, _)| text).collect::<String>()
        };
        let declared = text(None, false, DimensionOutcome::Compatible);
        let expected = format!("? recovery    -   {}", wording::NOT_MEASURED_YET);
        assert!(declared.starts_with(&expected), "{declared}");
        assert!(text(None, false, DimensionOutcome::Incompatible).starts_with("✖ recovery    ?  "));
        assert!(text(Some(0.9), true, DimensionOutcome::Compatible).starts_with("✔ recovery  0.900 "));
        assert!(text(None, false, DimensionOutcome::NoData).starts_with("? recovery    ?  "));
    }

    /// An improvement stood between the reasons of a rejection, and nothing told it from them.
    #[test]
    fn a_reason_has_the_sign_of_its_weight() {
        let of = |dimension, finding| signed_reason(&Reason::new(dimension, finding));
        let better = Finding::ComponentBetter { component: ComponentName::Success };
        assert!(of(Dimension::Behavior, better).starts_with("+ behavior-improved: "));
        let higher = Finding::PermissionHigher { permission: "zone tray".to_owned() };
        assert!(of(Dimension::Policy, higher).starts_with("- policy-escalation: "));
    }

    /// An improvement of success was "worse by -0.357..-0.201".
    #[test]
    fn an_improvement_is_not_told_as_a_negative_worsening() {
        assert_eq!(change([-0.357, -0.201]), wording::better_by(0.201, 0.357));
        assert_eq!(change([-0.010, 0.030]), wording::better_to_worse(0.010, 0.030));
        assert_eq!(change([0.0, 0.030]), wording::worse_by(0.0, 0.030));
    }
}
