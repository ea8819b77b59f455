//! How decisions compare with the truth: the harmful candidates that became active, and the harmless ones that were
//! lost.

use serde::{Deserialize, Serialize};

use super::CandidateTruth;
use super::roc::{Roc, RocBy};
use super::scale::HarmClass;
use crate::pipeline_experiments::ExperimentError;
use crate::pipeline_experiments::claims::ClaimVerdict;
use holdpoint_governance::metrics::{Fate, Proportion};
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::stats::clopper_pearson_upper;

/// One-sided error rate of a claim that is shown.
const CLAIM_ALPHA: f64 = 0.05;

/// The highest rates aimed for: harmful candidates that are active at the end, by class, and harmless ones that are
/// lost.
const fn aim_of(class: HarmClass) -> f64 {
    match class {
        HarmClass::Danger | HarmClass::Damage => 0.01,
        HarmClass::Nuisance => 0.10,
        HarmClass::NoHarm => 0.02,
    }
}

/// An aim, and whether it is met.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ErrorTarget {
    pub at_most: f64,
    /// One-sided 95 % bound (Clopper-Pearson); absent without a candidate.
    pub bound: Option<f64>,
    pub verdict: ClaimVerdict,
}

/// The candidates of one class under one profile.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ClassScore {
    pub class: HarmClass,
    /// Wrongly decided: harmful and active at the end, or harmless and lost.
    pub wrong: Proportion,
    /// Of the harmless candidates that were lost: those that the referee finds significantly worse all the same.
    /// Rejecting them lost nothing good, but they count as wrong.
    pub lost_worse: u64,
    /// Stopped before they were ever active.
    pub blocked: u64,
    /// Active, and rolled back.
    pub contained: u64,
    /// The most live episodes of the candidates that were active for a while.
    pub live_most: u64,
    /// Median of the sandbox episodes that ran for a decision.
    pub median_effort: u64,
    pub aim: ErrorTarget,
}

/// One profile.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ProfileScore {
    pub profile: ProfileName,
    /// The worst class first.
    pub classes: Vec<ClassScore>,
    /// Candidates whose classification here is still open.
    pub open: u64,
    /// The value of the evidence at any threshold; none without two candidates on each side.
    pub curves: Vec<Roc>,
}

impl ProfileScore {
    /// Of the candidates under a profile.
    ///
    /// # Errors
    /// Counts no interval exists for.
    pub fn of(profile: ProfileName, candidates: &[CandidateTruth]) -> Result<Self, ExperimentError> {
        let mut classes = Vec::new();
        for class in HarmClass::ALL.into_iter().rev() {
            let of_class = candidates.iter().filter(|one| one.truth.class == class);
            let under = of_class.flat_map(|one| one.ends.iter().map(move |end| (one, end)));
            let under: Vec<_> = under.filter(|(_, end)| end.profile == profile).collect();
            let ends: Vec<_> = under.iter().map(|(_, end)| *end).collect();
            let is_wrong = |fate: Fate| match class {
                HarmClass::NoHarm => fate != Fate::Kept,
                HarmClass::Nuisance | HarmClass::Damage | HarmClass::Danger => fate == Fate::Kept,
            };
            let wrong = Proportion::of(ends.iter().map(|end| is_wrong(end.fate)))?;
            let lost_worse = under.iter().filter(|(one, end)| one.truth.is_worse() && is_wrong(end.fate));
            let lost_worse = if class == HarmClass::NoHarm { lost_worse.count() as u64 } else { 0 };
            let mut efforts: Vec<u64> = ends.iter().map(|end| end.effort.sandbox).collect();
            efforts.sort_unstable();
            classes.push(ClassScore {
                class,
                aim: aim(class, &wrong),
                wrong,
                lost_worse,
                blocked: count(&ends, |end| matches!(end.fate, Fate::Blocked { .. })),
                contained: count(&ends, |end| end.fate == Fate::Contained),
                live_most: ends.iter().map(|end| end.effort.live).max().unwrap_or(0),
                median_effort: efforts.get(efforts.len() / 2).copied().unwrap_or(0),
            });
        }
        let open = candidates.iter().filter(|one| one.truth.open.is_some()).count() as u64;
        let curves = RocBy::ALL.into_iter().filter_map(|by| Roc::of(by, profile, candidates)).collect();
        Ok(Self { profile, classes, open, curves })
    }
}

fn count<T>(items: &[T], is: impl Fn(&T) -> bool) -> u64 {
    items.iter().filter(|item| is(item)).count() as u64
}

fn aim(class: HarmClass, wrong: &Proportion) -> ErrorTarget {
    let at_most = aim_of(class);
    let bound = clopper_pearson_upper(wrong.count, wrong.total, CLAIM_ALPHA).ok();
    let verdict = match (bound, wrong.rate()) {
        (Some(bound), _) if bound <= at_most => ClaimVerdict::Shown,
        (_, Some(share)) if share > at_most => ClaimVerdict::Refuted,
        _ => ClaimVerdict::NotShown,
    };
    ErrorTarget { at_most, bound, verdict }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_aim_is_met_by_its_bound() {
        let verdict = |class, wrong: usize, of: usize| {
            let wrong = Proportion::of((0..of).map(|at| at < wrong)).unwrap();
            aim(class, &wrong).verdict
        };
        assert_eq!(verdict(HarmClass::Damage, 0, 150), ClaimVerdict::NotShown, "leaves 2 %");
        assert_eq!(verdict(HarmClass::Damage, 0, 380), ClaimVerdict::Shown);
        assert_eq!(verdict(HarmClass::Damage, 5, 380), ClaimVerdict::Refuted);
        assert_eq!(verdict(HarmClass::NoHarm, 0, 150), ClaimVerdict::Shown);
        assert_eq!(verdict(HarmClass::NoHarm, 0, 0), ClaimVerdict::NotShown);
        assert_eq!(verdict(HarmClass::Nuisance, 2, 30), ClaimVerdict::NotShown);
    }
}
