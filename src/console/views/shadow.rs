//! View 4: the twin against the live world: three distances, each against its limit; monitors; disagreements.
//!
//! ```text
//! place@1.1.0  14 sequences, all of them shown
//! ▸ Output ───────────── mean 0.112, at most 0.30 ─ │ ── Monitors ───
//!  0.30 ╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌╌ limit 0.30          │ place@1.0.0
//!       ⡠⠤⠒⠒⠤⣀⡠⠤⠒                                  │ success ███░░┃
//! ── Disagreements ─────────────────────────────────────────────
//!  9  live: place done; twin: place missed the tray
//! ```

use ratatui::layout::Rect;

use super::console_view::{ConsoleView, ORDER_OF_TIME, ViewDescription};
use super::{small_window, tabs};
use crate::action::{Action, Scope};
use crate::effect::{Effect, EngineQuery};
use crate::formatters::{reason_line, stage_place, stages_done};
use crate::look::{Glyph, ThemeRole};
use crate::model::{ConsoleModel, ItemKey, MONITORS_PANE, View};
use crate::update;
use crate::widgets::bar::against_limit;
use crate::widgets::chart::Chart;
use crate::widgets::list::{GUTTER, place};
use crate::widgets::pen::{Fit, Hit, Pen, below, cut};
use crate::widgets::row::{Row, wrap};
use holdpoint_governance::decision::{Dimension, Reason};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{Stage, State};
use holdpoint_protocol::monitor_chart::ChartView;
use holdpoint_protocol::snapshot::{CandidateView, Disagreement, MonitorView, ShadowView};
use holdpoint_record::rationale::remedy::is_in_favor;
use holdpoint_wording::console::shadow as wording;
use holdpoint_wording::counted;

const CHARTS: usize = 0;

/// The place of the governance signals among the three.
const GOVERNANCE: usize = 1;

const DISAGREEMENTS: usize = 1;

const MONITORS: usize = MONITORS_PANE;

/// The width from which a monitor's charts have their words and a bar.
const MONITOR_COLUMNS: u16 = 44;

/// The most lines for shadow's decisions.
const DECIDED_ROWS: usize = 2;

const NAMES: [&str; 3] = ["Output divergence", "Governance divergence", "Envelope divergence"];

/// View 4.
pub struct ShadowBehavior;

impl ConsoleView for ShadowBehavior {
    fn description(&self) -> &'static ViewDescription {
        &ViewDescription {
            title: "Shadow",
            brief_title: "Shadow",
            action: "shadow",
            keys: &["4"],
            help: wording::HELP,
            tour: wording::TOUR,
            panes: &["Charts", "Disagreements", "Monitors"],
            scopes: &[Scope::Version, Scope::Charts],
            fixed_order: Some(ORDER_OF_TIME),
            queries_by_pane: false,
            is_about_version: true,
        }
    }

    fn row_count(&self, model: &ConsoleModel) -> usize {
        match model.view_state.pane() {
            MONITORS => 0,
            _ => model.disagreement_rows().len(),
        }
    }

    fn item_key(&self, model: &ConsoleModel, row: usize) -> Option<ItemKey> {
        model.disagreement_rows().get(row).map(|row| ItemKey::Disagreement(row.index))
    }

    fn row_of(&self, model: &ConsoleModel, key: &ItemKey) -> Option<usize> {
        let ItemKey::Disagreement(index) = key else { return None };
        model.disagreement_rows().iter().position(|row| row.index == *index)
    }

    fn version_here(&self, model: &ConsoleModel) -> Option<CapabilityId> {
        model.subject()
    }

    fn row_texts(&self, model: &ConsoleModel) -> Vec<String> {
        model.disagreement_rows().iter().map(|row| row.text.clone()).collect()
    }

    fn hints(&self, _model: &ConsoleModel) -> &'static [Action] {
        &[
            Action::Freeze,
            Action::ZoomIn,
            Action::ZoomOut,
            Action::NextPane,
            Action::OpenRecording,
            Action::Resume,
            Action::Abort,
        ]
    }

    fn can_open(&self, _model: &ConsoleModel, _rows: usize, version: Option<&CapabilityId>) -> bool {
        version.is_some()
    }

    fn query(&self, model: &ConsoleModel) -> Option<EngineQuery> {
        model.subject().map(EngineQuery::Detail)
    }

    fn open(&self, model: &mut ConsoleModel) -> Vec<Effect> {
        update::show(model, View::Candidate)
    }

    fn draw(&self, model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
        draw(model, pen, area);
    }

    fn small_rows(&self, model: &ConsoleModel, _pen: &Pen<'_>, _width: usize) -> Vec<Row> {
        let line = |row: &&Disagreement| Row::of(ThemeRole::Text, &format!("{} {}", row.index, row.text));
        model.disagreement_rows().iter().map(line).collect()
    }

    fn draw_small(&self, model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
        match model.view_state.pane() {
            MONITORS => monitor_rows(model, pen, area),
            CHARTS => small_distances(model, pen, area),
            _ => {
                let rows = self.small_rows(model, pen, usize::from(area.width.saturating_sub(GUTTER)));
                small_window::draw_rows(model, &rows, pen, area);
            }
        }
    }
}

/// The three distances in words.
fn small_distances(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    let Some(version) = model.subject() else {
        pen.text(area, 0, ThemeRole::Muted, wording::NO_TWIN);
        return;
    };
    let mut rows = vec![Row::of(ThemeRole::Title, &version.to_string())];
    let candidate = model.candidate(&version);
    match candidate.and_then(|candidate| candidate.shadow.as_ref()) {
        None => rows.push(Row::of(ThemeRole::Muted, &absent_series(model))),
        Some(shadow) => {
            let means = [shadow.output, shadow.governance, shadow.envelope];
            for ((name, mean), limit) in NAMES.iter().zip(means).zip(shadow.limits) {
                let label = name.split(' ').next().unwrap_or(name);
                let limit = limit.map_or_else(String::new, |limit| format!(" of {limit:.2}"));
                rows.push(Row::of(ThemeRole::Text, &format!("{label:<11} {mean:.3}{limit}")));
            }
            rows.push(Row::of(ThemeRole::Muted, &counted(shadow.n, "sequence")));
        }
    }
    pen.rows(area, 0, &rows);
}

fn draw(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    let subject = model.subject();
    let candidates = model.charted().map_or(&[][..], |snapshot| &snapshot.candidates);
    let candidate = candidates.iter().find(|candidate| Some(&candidate.version) == subject.as_ref());
    let Some(subject) = &subject else {
        pen.text(area, 0, ThemeRole::Muted, wording::NO_TWIN);
        return;
    };
    let shadow = candidate.and_then(|candidate| candidate.shadow.as_ref());
    let mut head = Row::of(ThemeRole::Title, &subject.to_string());
    head.push(ThemeRole::Text, &extent(model, candidate, shadow));
    pen.row(area, 0, &head);
    let decided = decision_rows(candidate, pen, usize::from(area.width));
    let taken = pen.rows(below(area, 1), 0, &decided);
    let area = super::frozen(model, pen, below(area, 1 + taken));
    match pen.fit {
        Fit::Tiny | Fit::One => {
            tabs::draw_panes(model, Row::new(), pen, area);
            let area = below(area, 1);
            match model.view_state.pane() {
                CHARTS => charts(model, shadow, pen, area),
                MONITORS => monitor_rows(model, pen, area),
                _ => list(model, pen, area, true),
            }
        }
        Fit::Two | Fit::Full => {
            let pane = model.view_state.pane();
            let lower = if pane == DISAGREEMENTS { area.height / 2 } else { area.height / 4 };
            let (upper, lower) = cut(area, area.height - lower.max(4));
            let watches = !monitors(model).is_empty() || pane == MONITORS;
            if pen.fit == Fit::Full && watches {
                let right = (upper.width / 3).max(MONITOR_COLUMNS);
                let (left, right) = pen.split(upper, upper.width.saturating_sub(right));
                charts(model, shadow, pen, left);
                monitor_pane(model, pen, right);
            } else if pane == MONITORS {
                monitor_pane(model, pen, upper);
            } else {
                charts(model, shadow, pen, upper);
            }
            let rows = model.disagreement_rows().len();
            let focused = pane == DISAGREEMENTS;
            pen.hit(upper, Hit::Pane(CHARTS));
            pen.hit(lower, Hit::Pane(DISAGREEMENTS));
            let inside = pen.pane(
                lower,
                wording::DISAGREEMENTS,
                focused,
                &place(rows, if focused { model.row() } else { 0 }),
            );
            list(model, pen, inside, focused);
        }
    }
}

/// The visible part of the series, in words.
fn extent(model: &ConsoleModel, candidate: Option<&CandidateView>, shadow: Option<&ShadowView>) -> String {
    let Some(shadow) = shadow else { return String::new() };
    let shown = zoomed(&shadow.series, model.view_state.zoom).len();
    let range = if shown == shadow.series.len() {
        "all shown".to_owned()
    } else {
        wording::last_shown(shown, 1u64 << model.view_state.zoom.min(32))
    };
    let budget = candidate.and_then(|candidate| candidate.progress.as_ref()).map(|progress| progress.budget);
    let sequences = counted(shadow.n, "sequence");
    let sequences = budget.map_or(sequences, |budget| format!("{} of {budget} sequences", shadow.n));
    format!("  {sequences}, {range}")
}

/// The last part of a series: half of it with every step of zoom, and at least two values.
fn zoomed<T>(series: &[T], zoom: u8) -> &[T] {
    let shown = series.len().checked_shr(u32::from(zoom)).unwrap_or(0).max(2).min(series.len());
    series.get(series.len() - shown..).unwrap_or(series)
}

fn charts(model: &ConsoleModel, shadow: Option<&ShadowView>, pen: &mut Pen<'_>, area: Rect) {
    let Some(shadow) = shadow.filter(|shadow| !shadow.series.is_empty()) else {
        pen.text(area, 0, ThemeRole::Muted, &absent_series(model));
        return;
    };
    let means = [shadow.output, shadow.governance, shadow.envelope];
    let series = zoomed(&shadow.series, model.view_state.zoom);
    let mut rest = area;
    for (place, ((name, mean), limit)) in NAMES.iter().zip(means).zip(shadow.limits).enumerate() {
        let left = u16::try_from(NAMES.len() - place).unwrap_or(1);
        let (part, below_it) = cut(rest, rest.height / left);
        rest = below_it;
        let past = limit.is_some_and(|limit| mean > limit);
        let sign = if past { format!("{} ", pen.look.glyph(Glyph::Warning)) } else { String::new() };
        let right = format!("{sign}mean {mean:.3}, {}", distance_verdict(place, limit));
        let inside = pen.pane(part, name, place == 0 && model.view_state.pane() == CHARTS, &right);
        let values: Vec<f32> = series.iter().filter_map(|three| three.get(place).copied()).collect();
        Chart { values: &values, limit }.draw(pen, inside);
    }
}

/// Why the subject has no series: an engine keeps those of its own session alone.
fn absent_series(model: &ConsoleModel) -> String {
    let subject = model.subject();
    let candidates = model.charted().map_or(&[][..], |snapshot| &snapshot.candidates);
    let ours = candidates.iter().find(|candidate| Some(&candidate.version) == subject.as_ref());
    let Some(ours) = ours else {
        let state = subject.and_then(|version| model.version_state(&version));
        return match state {
            Some((State::Active, _)) => wording::ACTIVE_HAS_NO_TWIN.to_owned(),
            Some(_) | None => wording::NOT_IN_MEMORY.to_owned(),
        };
    };
    let done = stages_done(ours.state, ours.left, ours.ran, &ours.flags);
    if done > stage_place(Stage::Shadow) {
        let key = model.keymap.key(Action::OpenRecording);
        return wording::shadow_is_over(&key);
    }
    wording::NO_SEQUENCE_YET.to_owned()
}

/// How a distance is judged: by its mean, or by the values that replace a single number.
fn distance_verdict(place: usize, limit: Option<f64>) -> String {
    match limit {
        Some(limit) => format!("at most {limit:.2}"),
        // These values, not the mean, can reject a version.
        None if place == GOVERNANCE => wording::JUDGED_IN_PAIRS.to_owned(),
        None => wording::NO_LIMIT.to_owned(),
    }
}

/// Shadow's decision against the version, the deciding reason first; empty before it.
fn decision_rows(candidate: Option<&CandidateView>, pen: &Pen<'_>, width: usize) -> Vec<Row> {
    let Some(candidate) = candidate.filter(|candidate| candidate.shadow.is_some()) else { return Vec::new() };
    let against = |reason: &&Reason| reason.dimension == Dimension::Shadow && !is_in_favor(reason.code);
    let Some(reason) = candidate.reasons.iter().find(against) else { return Vec::new() };
    let (role, mark) = match candidate.state {
        State::Rejected => (ThemeRole::Bad, Glyph::Bad),
        _ => (ThemeRole::Warning, Glyph::Warning),
    };
    let text = format!("{} {}", pen.look.glyph(mark), reason_line(reason));
    wrap(&text, width, DECIDED_ROWS).iter().map(|line| Row::of(role, line)).collect()
}

fn monitors(model: &ConsoleModel) -> &[MonitorView] {
    // They monitor active versions: they are never frozen.
    model.engine_data.snapshot.as_deref().map_or(&[][..], |snapshot| &snapshot.live.monitors)
}

fn monitor_pane(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    let inside = pen.pane(area, wording::MONITORS, model.view_state.pane() == MONITORS, "");
    monitor_rows(model, pen, inside);
}

/// Each monitor's charts: the used part of the way to the limit; of two numbers the first is the warning's.
fn monitor_rows(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect) {
    let look = pen.look;
    let width = usize::from(area.width);
    let mut rows = Vec::new();
    if monitors(model).is_empty() {
        let text = wording::NO_MONITOR_OPEN;
        pen.text(area, 0, ThemeRole::Muted, text);
        return;
    }
    for monitor in monitors(model) {
        let mut summary = if monitor.episodes <= monitor.needed {
            format!("{} of {} tasks", monitor.episodes, monitor.needed)
        } else {
            // The monitor continues after the provisional window.
            wording::window_over(monitor.episodes, monitor.needed)
        };
        if monitor.restricted {
            summary.push_str(", restricted");
        }
        if monitor.factor < 1.0 {
            summary.push_str(&format!(", limits x{:.2}", monitor.factor));
        }
        if monitor.coupled {
            summary.push_str(", rollback-coupled");
        }
        // Beside the name if there is room, else below it, so that nothing is cut.
        let name = Row::of(ThemeRole::Title, &monitor.version.to_string());
        if name.width() + 2 + summary.len() <= width {
            rows.push(name.with(ThemeRole::Muted, &format!("  {summary}")));
        } else {
            rows.push(name);
            let lines = wrap(&summary, width.saturating_sub(2), 2);
            rows.extend(lines.iter().map(|line| Row::of(ThemeRole::Muted, &format!("  {line}"))));
        }
        let charts = charts_of(monitor);
        let name_width = charts.iter().map(|chart| chart.name.chars().count()).max().unwrap_or(0);
        rows.extend(charts.iter().map(|chart| charted(chart, name_width.min(width / 2), look, width)));
    }
    pen.rows(area, 0, &rows);
}

/// One quantity of a monitor: how far it is on the way to its warning and to its trip.
struct MonitoredQuantity {
    name: String,
    /// Value and limit of each, in their order.
    readings: Vec<(f64, f64)>,
}

impl MonitoredQuantity {
    /// The larger used part of a way.
    fn worst_ratio(&self) -> f64 {
        let share = |(value, limit): &(f64, f64)| if *limit > 0.0 { value / limit } else { 0.0 };
        self.readings.iter().map(share).fold(0.0, f64::max)
    }
}

/// A monitor's charts, warning and trip of a quantity together, the nearest to a limit first.
fn charts_of(monitor: &MonitorView) -> Vec<MonitoredQuantity> {
    let mut charts: Vec<MonitoredQuantity> = Vec::new();
    for ChartView { rate, value, limit, .. } in &monitor.charts {
        let name = rate.to_string();
        match charts.iter_mut().find(|chart| chart.name == name) {
            Some(chart) => chart.readings.push((*value, *limit)),
            None => charts.push(MonitoredQuantity { name, readings: vec![(*value, *limit)] }),
        }
    }
    charts.sort_by(|one, other| other.worst_ratio().total_cmp(&one.worst_ratio()));
    charts
}

fn charted(chart: &MonitoredQuantity, name_width: usize, look: &crate::look::Look, width: usize) -> Row {
    let past = chart.readings.iter().any(|(value, limit)| value >= limit);
    let role = if past { ThemeRole::Past } else { ThemeRole::Text };
    let sign = if past { look.glyph(Glyph::Warning) } else { " " };
    let numbers = match chart.readings.as_slice() {
        [(value, limit)] => format!(" {value:.2} of {limit:.2}"),
        readings => {
            let parts: Vec<String> =
                readings.iter().map(|(value, limit)| format!("{value:.1}/{limit:.1}")).collect();
            format!(" {}", parts.join("  "))
        }
    };
    let row = Row::of(role, sign).with(role, " ").cell(role, &chart.name, name_width).with(role, " ");
    let bar = width.saturating_sub(row.width() + numbers.len()).min(20);
    // The limit is at four fifths of the bar, so that a value past it is visible.
    row.and(toward(look, chart.worst_ratio() * 0.8, bar, past)).with(role, &numbers)
}

fn toward(look: &crate::look::Look, share: f64, width: usize, past: bool) -> Row {
    let bar = against_limit(look, Some(share), 0.8, width);
    // Reaching the limit is bad here: the roles are swapped.
    let mut row = Row::new();
    for (text, role) in bar.parts() {
        let role = match role {
            ThemeRole::Value | ThemeRole::Past => {
                if past {
                    ThemeRole::Past
                } else {
                    ThemeRole::Value
                }
            }
            other => other,
        };
        row.push(role, text);
    }
    row
}

fn list(model: &ConsoleModel, pen: &mut Pen<'_>, area: Rect, focused: bool) {
    let rows = model.disagreement_rows();
    if rows.is_empty() {
        let subject = model.subject();
        let candidates = model.charted().map_or(&[][..], |snapshot| &snapshot.candidates);
        let ours = candidates.iter().find(|candidate| Some(&candidate.version) == subject.as_ref());
        let sequences = ours.and_then(|candidate| candidate.shadow.as_ref()).map_or(0, |shadow| shadow.n);
        let text = match sequences {
            0 => absent_series(model),
            1 => wording::ONE_SEQUENCE_ALIKE.to_owned(),
            n => wording::all_sequences_alike(n),
        };
        pen.text(area, 0, ThemeRole::Muted, &text);
        return;
    }
    pen.list(area, rows.len(), focused.then(|| model.row()), |index, _| {
        rows.get(index).map_or_else(Row::new, |row| {
            Row::of(ThemeRole::Muted, &format!("sequence {} seed {}  ", row.index, row.seed))
                .with(ThemeRole::Value, &format!("{:.2}  ", row.output))
                .with(ThemeRole::Text, &row.text)
        })
    });
}
