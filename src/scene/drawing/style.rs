//! Style of the charts: name, color and width, written once for each line.

use rerun::archetypes::SeriesLines;
use rerun::components::InterpolationMode;

use holdpoint_wording::scene as names;

use super::theme;
use crate::rows::PendingRows;

/// A line of a chart: path beneath `plots/`, name, color, whether it is a limit.
type ChartLine = (&'static str, &'static str, [u8; 3], bool);

const BLUE: [u8; 3] = [70, 140, 255];
const ORANGE: [u8; 3] = [255, 150, 40];
const GREEN: [u8; 3] = [88, 214, 120];
const VIOLET: [u8; 3] = [190, 130, 255];
const RED: [u8; 3] = [226, 80, 80];

const LINES: [ChartLine; 26] = [
    ("tool/speed", "speed, m/s", BLUE, false),
    ("tool/speed/limit", "limit", RED, true),
    ("tool/force", names::FORCE_AT_PADS, GREEN, false),
    ("tool/force/limit", names::FINGER_LIMIT, RED, true),
    ("tool/contact", names::FORCE_ON_SURROUNDINGS, ORANGE, false),
    ("tool/contact/limit", names::SURROUNDINGS_LIMIT, VIOLET, true),
    ("pairs/success/active", "success, active", BLUE, false),
    ("pairs/success/candidate", "success, candidate", ORANGE, false),
    ("pairs/violations/active", "violations, active", BLUE, false),
    ("pairs/violations/candidate", "violations, candidate", ORANGE, false),
    ("pairs/anomalies/active", "anomalies, active", BLUE, false),
    ("pairs/anomalies/candidate", "anomalies, candidate", ORANGE, false),
    ("shadow/output", "output", BLUE, false),
    ("shadow/output/limit", names::OUTPUT_LIMIT, BLUE, true),
    ("shadow/governance", "governance", ORANGE, false),
    ("shadow/governance/limit", names::GOVERNANCE_LIMIT, ORANGE, true),
    ("shadow/envelope", "envelope", GREEN, false),
    ("shadow/envelope/limit", names::ENVELOPE_LIMIT, GREEN, true),
    ("kappa/I", "interface", BLUE, false),
    ("kappa/I/limit", names::INTERFACE_LIMIT, BLUE, true),
    ("kappa/P", "policy", VIOLET, false),
    ("kappa/P/limit", names::POLICY_LIMIT, VIOLET, true),
    ("kappa/B", "behavior", ORANGE, false),
    ("kappa/B/limit", names::BEHAVIOR_LIMIT, ORANGE, true),
    ("kappa/R", "recovery", GREEN, false),
    ("kappa/R/limit", names::RECOVERY_LIMIT, GREEN, true),
];

/// Writes the style of each chart's lines.
pub(super) fn draw(rows: &mut PendingRows) {
    for (path, name, rgb, limit) in LINES {
        rows.always(&format!("plots/{path}"), &line(name, rgb, limit));
    }
}

/// Writes the style of one line.
pub(super) fn line(name: &str, [red, green, blue]: [u8; 3], limit: bool) -> SeriesLines {
    let (alpha, width) = if limit { (150, 1.0) } else { (255, 2.0) };
    let look = SeriesLines::new()
        .with_names([name])
        .with_colors([theme::ghost([red, green, blue], alpha)])
        .with_widths([width]);
    if limit { look.with_interpolation_mode(InterpolationMode::StepAfter) } else { look }
}

/// Colors of a monitor's charts, in turn.
pub(super) const fn monitor_color(index: usize) -> [u8; 3] {
    match index % 5 {
        0 => BLUE,
        1 => ORANGE,
        2 => GREEN,
        3 => VIOLET,
        _ => RED,
    }
}

/// The tool's charts beneath `plots/` that have a value in every frame.
#[must_use]
pub const fn tool_charts() -> [&'static str; 3] {
    ["tool/speed", "tool/force", "tool/contact"]
}
