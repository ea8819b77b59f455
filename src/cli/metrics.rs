//! `holdpoint metrics`: the paper's metrics from telemetry and audit log, without ground truth.
//!
//! Prints the result of [`holdpoint_explain::store_metrics`]; an engine may have the store open meanwhile. Prints no rate
//! without a case.

use std::str::FromStr;

use clap::Args;

use super::data;
use super::output::TextTable;
use super::time_arg::{TimeArg, when_help};
use crate::cells::CELLS;
use crate::cli::context::CliContext;
use crate::cli::output::CommandOutput;
use crate::error::{CliError, Exit};
use holdpoint_engine::decide::store_identity;
use holdpoint_explain::health_series::PresentTime;
use holdpoint_explain::store_metrics::{self, Coverage, Since, StoreMetrics};
use holdpoint_governance::ids::Digest;
use holdpoint_governance::metrics::Proportion;
use holdpoint_governance::metrics::store_metrics::{MeanWithStdDev, ObservedMetrics, ReplayOutcome};
use holdpoint_protocol::health::HealthClock;
use holdpoint_registry::{TelemetryViews, Views};
use holdpoint_store::{Layout, TelemetryReader};
use holdpoint_trials::cell::Cell;
use holdpoint_wording::program::metrics as sentences;

/// The longest span, days.
const DAYS_MAX: u64 = 36_500;

/// The arguments of `metrics`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = concat!(
    when_help!(),
    "  a record: #120

Examples:
  holdpoint metrics
  holdpoint metrics --since monday
  holdpoint metrics --since 24h --json"
))]
pub struct MetricsArgs {
    /// Counts records since then [default: all].
    #[arg(long, value_name = "WHEN")]
    pub since: Option<SinceArg>,
}

/// The first moment that counts, as written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SinceArg {
    /// From this record on.
    Record(u64),
    /// Since a moment.
    Time(TimeArg),
}

impl FromStr for SinceArg {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if let Some(number) = text.strip_prefix('#') {
            let wrong = || format!("{text:?} is not a record; allowed: # and a number, such as #120");
            return number.parse().map(Self::Record).map_err(|_| wrong());
        }
        let time = text.parse::<TimeArg>();
        time.map(Self::Time).map_err(|error| format!("{error}, or a record (#120)"))
    }
}

impl SinceArg {
    /// The first moment that counts, in a store whose record ends at `end`.
    ///
    /// # Errors
    /// One sentence, if the store has no such moment.
    fn since(&self, end: PresentTime) -> Result<Since, String> {
        let time = match self {
            Self::Record(number) => return Ok(Since::Record(*number)),
            Self::Time(time) => time,
        };
        // A span counts on the store's own clock, which every store has.
        match time.clock().unwrap_or(HealthClock::Virtual) {
            HealthClock::Wall => time.on(HealthClock::Wall, end).map(Since::WallMs),
            HealthClock::Virtual => {
                let at_ms = time.on(HealthClock::Virtual, end)?;
                let end_ms = i64::try_from(end.at_ms).unwrap_or(i64::MAX);
                Ok(Since::BackMs(u64::try_from(end_ms.saturating_sub(at_ms)).unwrap_or(0)))
            }
        }
    }

    /// The first record that it leaves in; one after the last if it leaves none.
    ///
    /// # Errors
    /// If the store cannot be read, or has no such moment.
    pub(super) fn first_record(&self, views: &Views) -> Result<u64, CliError> {
        let (last, end) = end_of(views)?;
        if matches!(self, Self::Time(TimeArg::Virtual(at_ms)) if *at_ms > end.at_ms) {
            return Ok(last + 1);
        }
        self.since(end).map_err(CliError::usage)?.first(views).map_err(CliError::usage)
    }
}

/// The last record and its moment.
fn end_of(views: &Views) -> Result<(u64, PresentTime), CliError> {
    let head = views.head().map_err(CliError::usage)?;
    let stamp = views.stamp(head.seq).map_err(CliError::usage)?;
    Ok((head.seq, PresentTime { at_ms: head.at_ms, wall_ms: stamp.and_then(|stamp| stamp.wall_ms) }))
}

/// `90m` as milliseconds.
pub(super) fn span_ms(text: &str) -> Option<u64> {
    let unit = text.chars().last()?;
    let secs: u64 = match unit {
        's' => 1,
        'm' => 60,
        'h' => 3_600,
        'd' => 86_400,
        _ => return None,
    };
    let number: u64 = text.strip_suffix(unit)?.parse().ok()?;
    let all = number.checked_mul(secs)?;
    (all <= DAYS_MAX * 86_400).then(|| all * 1_000)
}

/// Reads and prints.
///
/// # Errors
/// If there is no store, or it cannot be read.
pub fn run(context: &CliContext, args: &MetricsArgs, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    let views = data::open_records(&context.data)?;
    let file = Layout::new(&context.data).telemetry();
    let telemetry =
        file.is_file().then(|| TelemetryViews::open(&file)).transpose().map_err(CliError::usage)?;
    let (_, environment) = cell_of(&views)?;
    let since = match &args.since {
        None => Since::Record(1),
        Some(since) => since.since(end_of(&views)?.1).map_err(CliError::usage)?,
    };
    let telemetry = telemetry.as_ref().map(|telemetry| -> &dyn TelemetryReader { telemetry });
    let found = store_metrics::observe(&views, telemetry, since, environment).map_err(CliError::usage)?;
    out.answer(&found, |out| show(&found, out))?;
    Ok(Exit::Confirmed)
}

/// The cell of a store's robot in this build, and its digest at the store's site. A robot without a description has no digest,
/// so its decisions belong to another build.
pub(super) fn cell_of(views: &Views) -> Result<(Cell, Digest), CliError> {
    let robot = store_identity::robot(views).map_err(CliError::usage)?;
    let cell = robot.and_then(|robot| robot.cell(&CELLS).ok()).map_or_else(|| Cell::of(&CELLS, None), Ok);
    let cell = cell.map_err(CliError::internal)?;
    let site = store_identity::site(views).map_err(CliError::usage)?;
    let digest = site.map_or(cell.digest(), |site| site.bound(cell.digest()));
    Ok((cell, digest))
}

fn show(found: &StoreMetrics, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    let StoreMetrics { coverage, metrics, unequal } = found;
    covered(coverage, out)?;
    let mut table = TextTable::new(&["metric", "count", "share", "95 % interval"]);
    for (name, rate) in rates(metrics) {
        let (share, interval) = match (rate.rate(), rate.interval) {
            (Some(share), Some(interval)) => {
                (format!("{share:.3}"), format!("{:.3} to {:.3}", interval.lower, interval.upper))
            }
            _ => ("no data".to_owned(), String::new()),
        };
        table.row([name.to_owned(), format!("{} of {}", rate.count, rate.total), share, interval]);
    }
    out.table(&table)?;
    out.line("")?;
    let mut table = TextTable::new(&["metric", "n", "mean", "SD"]);
    for (name, spread) in spreads(metrics) {
        let number = |value: Option<f64>| value.map_or_else(|| "no data".to_owned(), |v| format!("{v:.3}"));
        table.row([name.to_owned(), spread.n.to_string(), number(spread.mean), number(spread.deviation)]);
    }
    out.table(&table)?;
    for round in &metrics.uar_rounds_observed {
        out.paragraph("", &sentences::unsafe_round(round))?;
    }
    out.paragraph("", &sentences::acts_of_people(&metrics.interventions_observed))?;
    out.paragraph("", &sentences::screened(&metrics.screening_observed))?;
    replayed(found, out)?;
    if unequal.len() == store_metrics::UNEQUAL_MAX {
        out.line(&sentences::first_decisions_only(store_metrics::UNEQUAL_MAX))?;
    }
    out.paragraph("", sentences::NOT_SHOWN)
}

fn covered(coverage: &Coverage, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    let Coverage {
        from_record,
        to_record,
        live_tasks,
        other_tasks,
        invalid_tasks,
        stopped_tasks,
        removed_batches,
        late_batches,
        damaged_batches,
    } = coverage;
    let others = [*other_tasks, *invalid_tasks, *stopped_tasks];
    out.paragraph("", &sentences::covered(*from_record, *to_record, *live_tasks, others))?;
    let omitted = sentences::omitted_batches([*removed_batches, *late_batches, *damaged_batches]);
    omitted.iter().try_for_each(|text| out.paragraph("", text))
}

/// The rates, in printing order.
fn rates(metrics: &ObservedMetrics) -> Vec<(&'static str, Proportion)> {
    vec![
        ("uar_observed", metrics.uar_observed),
        ("uar_live_observed", metrics.uar_live_observed),
        (sentences::HARD_VIOLATIONS, metrics.pvr_observed.hard),
        (sentences::HARD_OR_NEAR_VIOLATIONS, metrics.pvr_observed.near),
        ("srdr_observed", metrics.srdr_observed),
        ("shadow_only_share_observed", metrics.shadow_only_share_observed),
        ("rsr_observed", metrics.rsr_observed),
        ("unsafe_continuation_observed", metrics.unsafe_continuation_observed),
        ("safe_continuation_observed", metrics.safe_continuation_observed),
        ("unsafe_after_trigger_observed", metrics.unsafe_after_trigger_observed),
        ("success_observed", metrics.success_observed),
        ("anomaly_observed", metrics.anomaly_observed),
        ("recovery_observed", metrics.recovery_observed),
        ("timeout_observed", metrics.timeout_observed),
        ("intervention_observed", metrics.intervention_observed),
        ("auditability_observed", metrics.auditability_observed),
        ("replayed_equal_observed", metrics.replayed_equal_observed),
    ]
}

const fn spreads(metrics: &ObservedMetrics) -> [(&'static str, MeanWithStdDev); 4] {
    [
        ("time_s_observed", metrics.time_s_observed),
        ("retries_observed", metrics.retries_observed),
        ("time_to_safe_ms_observed", metrics.time_to_safe_ms_observed),
        ("time_to_restored_ms_observed", metrics.time_to_restored_ms_observed),
    ]
}

fn replayed(found: &StoreMetrics, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    out.paragraph("", &sentences::replayed(&found.metrics.replays))?;
    for one in &found.unequal {
        let detail = match &one.replay {
            ReplayOutcome::Equal => continue,
            ReplayOutcome::Differs { what } => what.clone(),
            ReplayOutcome::NotReplayed { why } => sentences::not_replayed(*why),
        };
        out.paragraph("  ", &format!("record {}, {}: {detail}", one.record, one.version))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn since_argument_is_parsed() {
        // Sun 22 Nov 2026, 10:30.
        let end = PresentTime { at_ms: 800_000_000, wall_ms: Some(1_795_343_400_000) };
        for (text, expected) in [
            ("30s", Some(Since::BackMs(30_000))),
            ("90m", Some(Since::BackMs(5_400_000))),
            ("7d", Some(Since::BackMs(604_800_000))),
            ("@700000", Some(Since::BackMs(100_000_000))),
            ("monday", Some(Since::WallMs(1_794_787_200_000))),
            ("yesterday", Some(Since::WallMs(1_795_219_200_000))),
            ("today", Some(Since::WallMs(1_795_305_600_000))),
            ("#120", Some(Since::Record(120))),
            ("1970-01-02", Some(Since::WallMs(86_400_000))),
            ("2026-11-22T10:30", Some(Since::WallMs(1_795_343_400_000))),
            ("2024-02-29 23:59:59", Some(Since::WallMs(1_709_251_199_000))),
            ("2000-03-01T00:00:01Z", Some(Since::WallMs(951_868_801_000))),
            ("2026-02-29", None),
            ("2026-13-01", None),
            ("2026-1-1", None),
            ("2026-11-22T24:00", None),
            ("-5m", None),
            ("99999999d", None),
            ("18446744073709551615d", None),
            ("#", None),
            ("someday", None),
            ("", None),
        ] {
            let found = text.parse::<SinceArg>();
            let since = found.clone().ok().and_then(|since| since.since(end).ok());
            assert_eq!(since, expected, "{text:?}: {found:?}");
        }
        let scripted = PresentTime { at_ms: 7, wall_ms: None };
        assert!("monday".parse::<SinceArg>().unwrap().since(scripted).is_err());
    }
}
