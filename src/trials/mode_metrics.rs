//! What the episodes of one mode came to: the metrics with their intervals, and the tails beside the means.
//!
//! A mean hides the rare bad episode; what a version does at its worst stands beside it. Reported, never
//! gating: the rules read raw pairs. Source: paper section 6.4 (`m_succ` to `m_recover`); design rule 5.3.

use serde::{Deserialize, Serialize};

use holdpoint_governance::behavior::signature;
use holdpoint_governance::closed_set::ClosedSetError;
use holdpoint_governance::evidence::{EpisodeValues, SandboxMode, Signature};
use holdpoint_governance::stats::{self, Interval, SHOWN_LEVEL};
use holdpoint_runtime::task::TaskRecord;

/// The share of episodes that [`UpperTail::worst_mean`] is taken over.
const WORST_SHARE: f64 = 0.05;

/// One metric over the episodes of a mode.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Metric {
    /// `success`, `violation`, `anomaly`, `recovery` (shares of episodes) or `retry` (mean per episode).
    pub name: String,
    /// The share or mean.
    pub value: f64,
    /// At 95 %: Wilson for shares, Student for the mean; absent if the episodes cannot bound it.
    pub interval: Option<Interval>,
}

/// The upper end of one measured quantity.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct UpperTail {
    /// What: its unit is in the name.
    pub name: String,
    /// Half of the episodes lie at or below it.
    pub median: f64,
    /// Nineteen of twenty episodes lie at or below it.
    pub p95: f64,
    /// Mean of the worst twentieth (at least one episode): the expected shortfall.
    pub worst_mean: f64,
    pub largest: f64,
}

/// Which of the two versions that are compared.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ComparedVersion {
    Candidate,
    Active,
}

/// A mode of the sandbox as one of the two versions worked it; written `perturbation` or
/// `perturbation, active version`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct VersionMode {
    pub mode: SandboxMode,
    pub party: ComparedVersion,
}

/// What is written after the mode for the version compared with.
const ACTIVE_SUFFIX: &str = ", active version";

impl TryFrom<String> for VersionMode {
    type Error = ClosedSetError;
    fn try_from(text: String) -> Result<Self, ClosedSetError> {
        let (mode, party) = match text.strip_suffix(ACTIVE_SUFFIX) {
            Some(mode) => (mode, ComparedVersion::Active),
            None => (text.as_str(), ComparedVersion::Candidate),
        };
        Ok(Self { mode: mode.parse()?, party })
    }
}

impl From<VersionMode> for String {
    fn from(VersionMode { mode, party }: VersionMode) -> Self {
        match party {
            ComparedVersion::Candidate => mode.name().to_owned(),
            ComparedVersion::Active => format!("{mode}{ACTIVE_SUFFIX}"),
        }
    }
}

/// What one mode of the sandbox gave for one version.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ModeMetrics {
    pub mode: VersionMode,
    pub episodes: u32,
    pub means: Signature,
    /// `success`, `violation`, `anomaly`, `retry` and `recovery`.
    pub metrics: Vec<Metric>,
    /// Duration, contact force, tool speed, retries and unsafe continuation at their worst.
    pub tails: Vec<UpperTail>,
}

impl ModeMetrics {
    /// The metrics of the valid episodes among `records`; absent if there is none.
    #[must_use]
    pub fn of<'a>(
        mode: SandboxMode,
        party: ComparedVersion,
        records: impl IntoIterator<Item = &'a TaskRecord>,
    ) -> Option<Self> {
        let records: Vec<&TaskRecord> = records.into_iter().filter(|record| !record.invalid).collect();
        let values: Vec<EpisodeValues> = records.iter().filter_map(|record| record.values()).collect();
        let means = signature(values.iter())?;
        let share = |name: &str, flag: fn(&EpisodeValues) -> bool| {
            let count = values.iter().filter(|value| flag(value)).count() as u64;
            let total = values.len() as u64;
            Metric {
                name: name.to_owned(),
                value: count as f64 / total as f64,
                interval: stats::wilson(count, total, SHOWN_LEVEL).ok(),
            }
        };
        let retries: Vec<f64> = values.iter().map(|value| f64::from(value.retries)).collect();
        let bound = stats::student_pairs(&retries, (1.0 - SHOWN_LEVEL) / 2.0).ok();
        let metrics = vec![
            share("success", |value| value.success),
            share("violation", |value| value.violation),
            share("anomaly", |value| value.anomaly),
            Metric {
                name: "retry".to_owned(),
                value: means.retry,
                interval: bound.map(|bound| Interval {
                    lower: bound.lower.max(0.0),
                    upper: bound.upper,
                    level: SHOWN_LEVEL,
                }),
            },
            share("recovery", |value| value.recovery),
        ];
        let column = |read: fn(&TaskRecord) -> f64| records.iter().map(|record| read(record)).collect();
        let tails = [
            ("time_s", column(|record| record.time_secs)),
            ("contact_force_n", column(|record| record.peak_force_n)),
            ("tool_speed_m_s", column(|record| record.peak_speed_m_s)),
            ("retries", column(|record| f64::from(record.retries))),
            ("unsafe_continuation_ms", column(|record| record.unsafe_continuation_ms as f64)),
        ];
        Some(Self {
            mode: VersionMode { mode, party },
            episodes: u32::try_from(values.len()).unwrap_or(u32::MAX),
            means,
            metrics,
            tails: tails.into_iter().filter_map(|(name, values)| tail(name, values)).collect(),
        })
    }
}

/// The tail of a sample; absent for an empty one and if a value is no number.
fn tail(name: &str, mut values: Vec<f64>) -> Option<UpperTail> {
    if values.iter().any(|value| !value.is_finite()) {
        return None;
    }
    values.sort_by(f64::total_cmp);
    let n = values.len();
    // The smallest value with at least this share of the sample at or below it.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a share of a count")]
    let rank = |share: f64| (share * n as f64).ceil() as usize;
    let at = |share: f64| values.get(rank(share).max(1) - 1).copied();
    let worst = &values[n - rank(WORST_SHARE).clamp(usize::from(n > 0), n)..];
    Some(UpperTail {
        name: name.to_owned(),
        median: at(0.5)?,
        p95: at(0.95)?,
        worst_mean: worst.iter().sum::<f64>() / worst.len() as f64,
        largest: values.last().copied()?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_body::TaskKind;

    fn record(seed: u32) -> TaskRecord {
        let value = f64::from(seed);
        TaskRecord {
            invalid: false,
            success: seed.is_multiple_of(2),
            time_secs: value,
            peak_force_n: value,
            retries: seed % 3,
            ..TaskRecord::invalid(TaskKind::Grasp, u64::from(seed))
        }
    }

    #[test]
    fn metrics_and_tails_of_a_known_sample() {
        let mut records: Vec<TaskRecord> = (1..=40).rev().map(record).collect();
        records.push(TaskRecord::invalid(TaskKind::Grasp, 99));
        let mode = ModeMetrics::of(SandboxMode::Canonical, ComparedVersion::Candidate, &records).unwrap();
        assert_eq!(mode.episodes, 40);
        let success = &mode.metrics[0];
        assert!((success.value - 0.5).abs() < 1e-12);
        let interval = success.interval.unwrap();
        assert!(interval.contains(0.5) && interval.width() < 0.32, "{interval:?}");
        let time = &mode.tails[0];
        assert_eq!((time.median, time.p95, time.largest), (20.0, 38.0, 40.0));
        assert!((time.worst_mean - 39.5).abs() < 1e-12, "the worst two of forty");
        let retry = mode.metrics.iter().find(|metric| metric.name == "retry").unwrap();
        assert!(retry.interval.unwrap().contains(retry.value));
    }

    #[test]
    fn version_mode_round_trips_through_its_text() {
        for mode in SandboxMode::ALL {
            for (party, text) in [
                (ComparedVersion::Candidate, format!("{mode}")),
                (ComparedVersion::Active, format!("{mode}, active version")),
            ] {
                let worked = VersionMode { mode, party };
                assert_eq!(String::from(worked), text);
                assert_eq!(VersionMode::try_from(text), Ok(worked));
            }
        }
        assert!(VersionMode::try_from("nominal".to_owned()).is_err());
    }

    #[test]
    fn mode_without_valid_episodes_has_no_metrics() {
        assert!(ModeMetrics::of(SandboxMode::Canonical, ComparedVersion::Candidate, &[]).is_none());
        assert!(
            ModeMetrics::of(
                SandboxMode::Canonical,
                ComparedVersion::Candidate,
                &[TaskRecord::invalid(TaskKind::Place, 1)]
            )
            .is_none()
        );
        assert!(tail("x", vec![f64::NAN]).is_none());
        let one = tail("x", vec![3.0]).unwrap();
        assert_eq!((one.median, one.p95, one.worst_mean, one.largest), (3.0, 3.0, 3.0, 3.0));
    }
}
