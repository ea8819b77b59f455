//! A version in control that a monitor watches: its window, where it was admitted below a limit, its conditions, and how near each of the
//! monitor's limits is.
//!
//! ```text
//! ████░░░░ 38 of 100 tasks, then it is confirmed
//! ⚠ admitted below its limit: recovery 0.50 of 0.80
//! under: at most 0.25 m/s and 20 N, tighter than it declares
//! of their limits: violation 85 %, time 26 %; a trip rolls it back to align@1.0.0
//! ```

use crate::look::{Glyph, Look, ThemeRole};
use crate::widgets::bar::progress;
use crate::widgets::row::{Row, wrap};
use holdpoint_protocol::event::DimensionResult;
use holdpoint_protocol::snapshot::{CandidateView, MonitorView, Snapshot};
use holdpoint_wording::console::watched as wording;

/// The most lines of the conditions, and of the limits.
const LINES_MAX: usize = 2;

/// The lines below the version's name.
#[must_use]
pub fn rows(now: &Snapshot, candidate: &CandidateView, look: &Look, width: usize) -> Vec<Row> {
    let family = now.families.iter().find(|family| family.active.as_ref() == Some(&candidate.version));
    let mut rows = Vec::new();
    if let Some((worked, needed)) = family.and_then(|family| family.provisional) {
        let bar = (width / 4).clamp(6, 24);
        let then = if worked < needed { wording::THEN_CONFIRMED } else { "" };
        let count = wording::tasks_watched(worked, needed, then);
        let row = progress(look, u64::from(worked), u64::from(needed), bar).with(ThemeRole::Text, &count);
        rows.push(row);
    }
    let wrapped = |role: ThemeRole, text: &str| {
        wrap(text, width, LINES_MAX).into_iter().map(move |line| Row::of(role, &line)).collect::<Vec<Row>>()
    };
    let monitor = now.live.monitors.iter().find(|monitor| monitor.version == candidate.version);
    if let Some(monitor) = monitor {
        let back = family.and_then(|family| family.pinned.as_ref());
        let back = back.map_or_else(|| wording::DEACTIVATES_IT.to_owned(), wording::rolls_it_back_to);
        let then = if monitor.coupled { wording::first_warning(&back) } else { format!("a trip {back}") };
        let near = nearest(monitor);
        if !near.is_empty() {
            let is_past = near.iter().any(|(_, share)| *share >= 1.0);
            let role = if is_past { ThemeRole::Past } else { ThemeRole::Text };
            rows.extend(wrapped(role, &wording::of_their_limits(&shares(&near), &then)));
        }
    }
    let below = below_limit(&candidate.dimensions);
    if !below.is_empty() {
        let glyph = look.glyph(Glyph::Warning);
        let text = wording::admitted_below(glyph, &below.join(", "));
        rows.extend(wrapped(ThemeRole::Warning, &text));
    }
    let conditions: Vec<String> =
        candidate.conditions.iter().map(holdpoint_wording::condition_of_use).collect();
    if !conditions.is_empty() {
        rows.extend(wrapped(ThemeRole::Muted, &format!("under: {}", conditions.join("; "))));
    }
    rows
}

/// The checks below their limits, with value and limit.
#[must_use]
pub fn below_limit(dimensions: &[DimensionResult]) -> Vec<String> {
    dimensions
        .iter()
        .filter_map(|one| Some((one, one.kappa.filter(|kappa| *kappa < one.threshold)?)))
        .map(|(one, kappa)| format!("{} {kappa:.2} of {:.2}", one.dimension.name(), one.threshold))
        .collect()
}

/// Each rate of a monitor as a share of its nearest limit, the nearest first.
fn nearest(monitor: &MonitorView) -> Vec<(String, f64)> {
    let mut near: Vec<(String, f64)> = Vec::new();
    for chart in monitor.charts.iter().filter(|chart| chart.limit > 0.0) {
        let (name, share) = (chart.rate.to_string(), chart.value / chart.limit);
        match near.iter_mut().find(|(known, _)| *known == name) {
            Some((_, nearest)) => *nearest = nearest.max(share),
            None => near.push((name, share)),
        }
    }
    near.sort_by(|(_, one), (_, other)| other.total_cmp(one));
    near
}

/// The shares above 0 %, so that what a trip does has room behind them.
fn shares(near: &[(String, f64)]) -> String {
    let percents = near.iter().map(|(name, share)| (name, (share * 100.0).round()));
    let above: Vec<String> = percents
        .filter(|(_, percent)| *percent > 0.0)
        .map(|(name, percent)| format!("{name} {percent:.0} %"))
        .collect();
    if above.is_empty() { wording::EACH_AT_ZERO.to_owned() } else { above.join(", ") }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ten rates at 0 % left no room for what a trip does.
    #[test]
    fn rates_at_zero_stand_together() {
        let of = |near: &[(&str, f64)]| {
            let near: Vec<(String, f64)> =
                near.iter().map(|(name, share)| ((*name).to_owned(), *share)).collect();
            shares(&near)
        };
        assert_eq!(of(&[("violation", 0.85), ("time", 0.26), ("retry", 0.0)]), "violation 85 %, time 26 %");
        assert_eq!(of(&[("retry", 0.0), ("time", 0.001)]), wording::EACH_AT_ZERO);
    }
}
