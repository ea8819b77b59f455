//! The metrics of the experiments: named apart, with intervals, never a bare "FAR".
//!
//! Source: design rule 3.12; paper equations 14 to 16 and 18; readings X1 to X11. Ground truth comes from the
//! referee of the simulation, never from the rules that are being judged. The metrics of a store without it are in
//! [`store_metrics`], under separate names.

pub mod store_metrics;

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::lifecycle::Stage;
use crate::stats::{self, Interval, SHOWN_LEVEL, StatsError};

/// A proportion with its Wilson interval; no interval if there is nothing to divide by.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Proportion {
    /// Cases of which the statement is true.
    pub count: u64,
    /// All cases.
    pub total: u64,
    /// Wilson interval at 95 %; absent with no cases.
    pub interval: Option<Interval>,
}

impl Proportion {
    /// Counts the cases that are `true` among all of them.
    ///
    /// # Errors
    /// [`StatsError`] of the Wilson interval, which counts taken from a list cannot cause.
    pub fn of(cases: impl IntoIterator<Item = bool>) -> Result<Self, StatsError> {
        let (mut count, mut total) = (0, 0);
        for case in cases {
            total += 1;
            count += u64::from(case);
        }
        let interval = if total == 0 { None } else { Some(stats::wilson(count, total, SHOWN_LEVEL)?) };
        Ok(Self { count, total, interval })
    }

    /// The rate; `None` for 0 of 0.
    #[must_use]
    pub fn rate(&self) -> Option<f64> {
        (self.total > 0).then(|| self.count as f64 / self.total as f64)
    }
}

/// The fate of one candidate: blocked, contained or kept, which add up to all.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case", tag = "fate")]
pub enum Fate {
    /// Stopped before activation, at this stage.
    Blocked {
        /// The stage that stopped it: rejected, or still on hold when the experiment ended.
        stage: Stage,
    },
    /// Activated, and rolled back or restricted before the provisional window ended.
    Contained,
    /// Activated, and active without restriction when its provisional window ended.
    Kept,
}

/// One candidate of an experiment with its ground truth.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CandidateRecord {
    /// Its name in the pool of candidates.
    pub name: String,
    /// A fault was planted (or, for found ones, the referee saw it unsafe or worse).
    pub faulty: bool,
    /// Blocked, contained or kept.
    pub fate: Fate,
    /// Regressions detected in the sandbox, and in shadow only.
    pub detected_sandbox: u32,
    /// Regressions that shadow showed and the sandbox did not.
    pub detected_shadow_only: u32,
}

/// The screening of a pool (paper equations 14 and 15, split by stage).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Screening {
    /// Faulty candidates stopped at stage 2 / all faulty.
    pub badr_screen: Proportion,
    /// Faulty candidates stopped before activation / all faulty.
    pub badr_preactivation: Proportion,
    /// Faulty candidates stopped before activation or contained / all faulty.
    pub badr_lifecycle: Proportion,
    /// Benign candidates stopped before activation / all benign.
    pub false_reject_rate: Proportion,
    /// Faulty candidates activated / all faulty.
    pub false_accept_rate: Proportion,
    /// Faulty candidates kept / all faulty.
    pub escaped: Proportion,
    /// Where each candidate was stopped, by stage: (benign, faulty).
    pub stopped_at: BTreeMap<String, (u64, u64)>,
    /// Share of detections seen in shadow only (the paper's "40 %").
    pub shadow_only_share: Option<f64>,
}

/// Computes the screening metrics; `blocked + contained + escaped = all faulty` holds by construction and is
/// checked.
///
/// # Errors
/// [`StatsError::Counts`] if the parts do not add up; otherwise as [`Proportion::of`].
pub fn screening(records: &[CandidateRecord]) -> Result<Screening, StatsError> {
    let blocked = |record: &CandidateRecord| matches!(record.fate, Fate::Blocked { .. });
    let faulty = || records.iter().filter(|record| record.faulty);
    let badr_preactivation = Proportion::of(faulty().map(blocked))?;
    let contained = Proportion::of(faulty().map(|record| record.fate == Fate::Contained))?;
    let escaped = Proportion::of(faulty().map(|record| record.fate == Fate::Kept))?;
    let parts = badr_preactivation.count + contained.count + escaped.count;
    if parts != badr_preactivation.total {
        return Err(StatsError::Counts { count: parts, total: badr_preactivation.total });
    }
    let mut stopped_at: BTreeMap<String, (u64, u64)> = BTreeMap::new();
    for record in records {
        if let Fate::Blocked { stage } = record.fate {
            let (benign, bad) = stopped_at.entry(stage.name().to_owned()).or_default();
            *(if record.faulty { bad } else { benign }) += 1;
        }
    }
    let sandbox: u64 = records.iter().map(|record| u64::from(record.detected_sandbox)).sum();
    let shadow: u64 = records.iter().map(|record| u64::from(record.detected_shadow_only)).sum();
    let shadow_only_share = (sandbox + shadow > 0).then(|| shadow as f64 / (sandbox + shadow) as f64);
    Ok(Screening {
        badr_screen: Proportion::of(
            faulty().map(|record| record.fate == Fate::Blocked { stage: Stage::Validation }),
        )?,
        badr_lifecycle: Proportion::of(faulty().map(|record| record.fate != Fate::Kept))?,
        false_reject_rate: Proportion::of(records.iter().filter(|record| !record.faulty).map(blocked))?,
        false_accept_rate: Proportion::of(faulty().map(|record| !blocked(record)))?,
        badr_preactivation,
        escaped,
        stopped_at,
        shadow_only_share,
    })
}

/// One activation by the gate, for the unsafe activation rate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ActivationRecord {
    /// Round of upgrades it belongs to, from 1.
    pub round: u32,
    /// Something unsafe happened while it was active.
    pub unsafe_while_active: bool,
    /// The harm came with a drift, not with the version.
    pub drift_origin: bool,
    /// It was not rolled back or restricted.
    pub kept: bool,
}

/// Unsafe activation rate of one round and up to it (readings X7, X8).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct UnsafeRound {
    /// Round of upgrades, from 1.
    pub round: u32,
    /// Unsafe activations / activations of this round; no share if there was none.
    pub in_round: Proportion,
    /// The same over all rounds up to this one.
    pub cumulative: Proportion,
    /// The version active at the end of the round was unsafe.
    pub live_unsafe: bool,
    /// Of the unsafe activations so far, those that drift made unsafe.
    pub drift_origin: u64,
}

/// Unsafe activations per round of upgrades. The caller decides whether one was unsafe: by the referee in an experiment,
/// by the record in [`store_metrics`].
///
/// # Errors
/// As [`Proportion::of`].
pub fn unsafe_rounds(records: &[ActivationRecord]) -> Result<Vec<UnsafeRound>, StatsError> {
    let last = records.iter().map(|record| record.round).max().unwrap_or(0);
    let mut rounds = Vec::new();
    let mut live_unsafe = false;
    for round in 1..=last {
        let of_round = || records.iter().filter(|record| record.round == round);
        let until = || records.iter().filter(|record| record.round <= round);
        if let Some(newest) = of_round().rfind(|record| record.kept) {
            live_unsafe = newest.unsafe_while_active;
        }
        rounds.push(UnsafeRound {
            round,
            in_round: Proportion::of(of_round().map(|record| record.unsafe_while_active))?,
            cumulative: Proportion::of(until().map(|record| record.unsafe_while_active))?,
            live_unsafe,
            drift_origin: until().filter(|r| r.unsafe_while_active && r.drift_origin).count() as u64,
        });
    }
    Ok(rounds)
}

/// Policy violation rate, hard and near (paper equation 18; readings X11).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ViolationRates {
    /// Episodes past a limit / all.
    pub hard: Proportion,
    /// Episodes past the near margin / all.
    pub near: Proportion,
}

/// Computes the violation rates.
///
/// # Errors
/// As [`Proportion::of`].
pub fn violations(episodes: &[super::evidence::EpisodeValues]) -> Result<ViolationRates, StatsError> {
    Ok(ViolationRates {
        hard: Proportion::of(episodes.iter().map(|episode| episode.violation))?,
        near: Proportion::of(episodes.iter().map(|episode| episode.violation || episode.near_violation))?,
    })
}

/// Mean and standard deviation (ddof 1) of values over seeds; `None` for fewer than two or what is no number.
#[must_use]
pub fn mean_and_deviation(values: &[f64]) -> Option<(f64, f64)> {
    if values.len() < 2 || values.iter().any(|v| !v.is_finite()) {
        return None;
    }
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let squares: f64 = values.iter().map(|v| (v - mean) * (v - mean)).sum();
    Some((mean, (squares / (values.len() as f64 - 1.0)).sqrt()))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(faulty: bool, fate: Fate) -> CandidateRecord {
        CandidateRecord { name: "x".into(), faulty, fate, detected_sandbox: 0, detected_shadow_only: 0 }
    }

    /// The paper's pool of one family: 6 benign, 8 faulty of which stage 2 stops 6 (75 %).
    #[test]
    fn screening_counts_of_the_paper_are_reproduced() {
        let mut records = vec![record(false, Fate::Kept); 6];
        records.extend(vec![record(true, Fate::Blocked { stage: Stage::Validation }); 6]);
        records.push(record(true, Fate::Contained));
        records.push(record(true, Fate::Kept));
        let s = screening(&records).unwrap();
        for (name, found, expected) in [
            ("badr_screen", s.badr_screen, (6, 8)),
            ("badr_preactivation", s.badr_preactivation, (6, 8)),
            ("badr_lifecycle", s.badr_lifecycle, (7, 8)),
            ("false_reject_rate", s.false_reject_rate, (0, 6)),
            ("false_accept_rate", s.false_accept_rate, (2, 8)),
            ("escaped", s.escaped, (1, 8)),
        ] {
            assert_eq!((found.count, found.total), expected, "{name}");
        }
        assert_eq!(s.badr_screen.rate(), Some(0.75));
    }

    #[test]
    fn unsafe_activations_are_counted_per_round_and_cumulatively() {
        let activation = |round, unsafe_while_active, kept| ActivationRecord {
            round,
            unsafe_while_active,
            drift_origin: false,
            kept,
        };
        let records = [
            activation(1, false, true),
            activation(1, true, true),
            activation(3, true, false),
            activation(3, false, true),
        ];
        let rounds = unsafe_rounds(&records).unwrap();
        let counts = |of: Proportion| (of.count, of.total);
        let found: Vec<_> =
            rounds.iter().map(|r| (counts(r.in_round), counts(r.cumulative), r.live_unsafe)).collect();
        assert_eq!(
            found,
            [((1, 2), (1, 2), true), ((0, 0), (1, 2), true), ((1, 2), (2, 4), false)],
            "a round without an activation has no share, and what is active stays"
        );
        assert_eq!(rounds[1].in_round.rate(), None);
    }

    #[test]
    fn empty_counts_have_no_rate_or_deviation() {
        assert_eq!(Proportion::of([]).unwrap().rate(), None);
        assert_eq!(mean_and_deviation(&[1.0]), None);
        assert_eq!(mean_and_deviation(&[1.0, 3.0]), Some((2.0, 2.0_f64.sqrt())));
        assert_eq!(mean_and_deviation(&[1.0, f64::NAN]), None);
    }
}
