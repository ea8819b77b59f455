//! How well a single number of the decisions separates harmful candidates from harmless ones, at any threshold.
//!
//! The stages decide by rules and not by such a number. The curve shows the value of the evidence apart from the
//! profiles' limits, and the place of the decisions beside it.

use serde::{Deserialize, Serialize};

use super::CandidateTruth;
use super::scale::HarmClass;
use crate::pipeline_experiments::candidate_run::CandidateEnd;
use holdpoint_governance::metrics::Fate;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::stats::normal_quantile;

/// One-sided error rate of each bound of the area.
const ALPHA: f64 = 0.025;

holdpoint_governance::closed_set! {
    /// A number by which the curve separates candidates.
    RocBy, "number of a decision", {
        /// The smallest kappa of any dimension; one that was not reached is 0.
        LeastKappa = "least-kappa",
        /// The composite, 0 where there is none.
        Composite = "composite",
    }
}

/// A place of the curve.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RocPoint {
    /// Candidates below it are stopped.
    pub limit: f64,
    /// Rate of the harmful ones that are stopped.
    pub hits: f64,
    /// Rate of the harmless ones that are stopped.
    pub false_alarms: f64,
}

/// The curve of one number under one profile.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Roc {
    pub by: RocBy,
    pub harmful: u64,
    pub harmless: u64,
    /// The chance that a harmful candidate has less than a harmless one, ties counted half; with its 95 % interval by
    /// `DeLong` et al. (1988).
    pub area: f64,
    pub interval: [f64; 2],
    /// By rising limit.
    pub points: Vec<RocPoint>,
    /// The place of the decisions: rates of harmful and of harmless candidates that were stopped or rolled back.
    pub decided: [f64; 2],
}

impl Roc {
    /// Of the candidates under a profile; `None` without at least two harmful and two harmless ones.
    #[must_use]
    pub fn of(by: RocBy, profile: ProfileName, candidates: &[CandidateTruth]) -> Option<Self> {
        let (mut harmful, mut harmless) = (Vec::new(), Vec::new());
        for one in candidates {
            for end in one.ends.iter().filter(|end| end.profile == profile) {
                let is_harmful = one.truth.class > HarmClass::NoHarm;
                let side = if is_harmful { &mut harmful } else { &mut harmless };
                side.push((number(by, end), end.fate != Fate::Kept));
            }
        }
        let numbers = |side: &[(f64, bool)]| side.iter().map(|(number, _)| *number).collect::<Vec<f64>>();
        let stopped = |side: &[(f64, bool)]| {
            side.iter().filter(|(_, stopped)| *stopped).count() as f64 / side.len() as f64
        };
        let (low, high) = (numbers(&harmful), numbers(&harmless));
        let (area, error) = area(&low, &high)?;
        let half = normal_quantile(1.0 - ALPHA)? * error;
        Some(Self {
            by,
            harmful: low.len() as u64,
            harmless: high.len() as u64,
            area,
            interval: [(area - half).max(0.0), (area + half).min(1.0)],
            points: points(&low, &high),
            decided: [stopped(&harmful), stopped(&harmless)],
        })
    }
}

fn number(by: RocBy, end: &CandidateEnd) -> f64 {
    match by {
        RocBy::LeastKappa => {
            let least = end.dimensions.iter().map(|one| one.kappa.unwrap_or(0.0)).reduce(f64::min);
            least.unwrap_or(0.0)
        }
        RocBy::Composite => end.composite.unwrap_or(0.0),
    }
}

/// The area with its standard error; `None` without two numbers on each side.
fn area(low: &[f64], high: &[f64]) -> Option<(f64, f64)> {
    if low.len() < 2 || high.len() < 2 {
        return None;
    }
    let wins = |low: f64, high: f64| match low.total_cmp(&high) {
        std::cmp::Ordering::Less => 1.0,
        std::cmp::Ordering::Equal => 0.5,
        std::cmp::Ordering::Greater => 0.0,
    };
    let share = |of: &mut dyn Iterator<Item = f64>, n: usize| of.sum::<f64>() / n as f64;
    let by_low: Vec<f64> =
        low.iter().map(|l| share(&mut high.iter().map(|h| wins(*l, *h)), high.len())).collect();
    let by_high: Vec<f64> =
        high.iter().map(|h| share(&mut low.iter().map(|l| wins(*l, *h)), low.len())).collect();
    let area = share(&mut by_low.iter().copied(), by_low.len());
    let spread = |of: &[f64]| {
        let squares: f64 = of.iter().map(|one| (one - area) * (one - area)).sum();
        squares / (of.len() as f64 - 1.0) / of.len() as f64
    };
    Some((area, (spread(&by_low) + spread(&by_high)).sqrt()))
}

fn points(low: &[f64], high: &[f64]) -> Vec<RocPoint> {
    let mut limits: Vec<f64> = low.iter().chain(high).copied().collect();
    limits.sort_by(f64::total_cmp);
    limits.dedup();
    // Past the largest number everything is stopped.
    limits.extend(limits.last().map(|largest| largest + 1.0));
    let below =
        |side: &[f64], limit: f64| side.iter().filter(|n| **n < limit).count() as f64 / side.len() as f64;
    limits
        .into_iter()
        .map(|limit| RocPoint { limit, hits: below(low, limit), false_alarms: below(high, limit) })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The variance of the area, computed by hand for three harmful and two harmless numbers.
    #[test]
    fn area_under_the_curve_is_the_share_of_ordered_pairs() {
        let (found, error) = area(&[0.1, 0.2, 0.6], &[0.5, 0.9]).unwrap();
        assert!((found - 5.0 / 6.0).abs() < 1e-12);
        // Placements: 1, 1, 1/2 of the harmful ones and 2/3, 1 of the harmless ones.
        let by_hand = ((1.0_f64 / 36.0 + 1.0 / 36.0 + 1.0 / 9.0) / 2.0 / 3.0
            + (1.0 / 36.0 + 1.0 / 36.0) / 1.0 / 2.0)
            .sqrt();
        assert!((error - by_hand).abs() < 1e-12, "{error} {by_hand}");
        assert_eq!(area(&[0.1, 0.1], &[0.1, 0.1]).unwrap().0, 0.5, "ties count half");
        assert_eq!(area(&[0.1], &[0.1, 0.2]), None);
    }

    #[test]
    fn curve_ranges_from_none_stopped_to_all_stopped() {
        let curve = points(&[0.1, 0.2, 0.6], &[0.5, 0.9]);
        let shares: Vec<(f64, f64)> = curve.iter().map(|point| (point.hits, point.false_alarms)).collect();
        let third = 1.0 / 3.0;
        let expected =
            [(0.0, 0.0), (third, 0.0), (2.0 * third, 0.0), (2.0 * third, 0.5), (1.0, 0.5), (1.0, 1.0)];
        assert_eq!(shares, expected);
    }
}
