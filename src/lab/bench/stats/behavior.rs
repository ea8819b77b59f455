//! The decision on `kappa_B` at the profiles' budgets: equally good candidates, worse ones, and trades of safety
//! for success.

use std::collections::BTreeSet;

use super::Study;
use super::figure::{StatedBound, StudyFigure, StudyMeasure, rate};
use super::sampling::{SampleStream, binding};
use super::tables::RecordedTable;
use holdpoint::bench::BenchError;
use holdpoint_governance::behavior::{self, BehaviorAssessment, BehaviorComponent, ComponentName};
use holdpoint_governance::evidence::{Pair, PairedEvidence};
use holdpoint_governance::outcome::BehaviorOutcome;
use holdpoint_governance::profile::Profile;

const RULE: &str = "kappa_B";

/// Further budgets that the report shows, to tell the effect of fewer pairs.
const OTHER_BUDGETS: [u32; 2] = [120, 200];

/// More episodes with an anomaly, of a candidate that has to be rejected.
const WORSE: f64 = 0.13;

pub(super) fn study(study: &Study) -> Result<Vec<StudyFigure>, BenchError> {
    let mut findings = Vec::new();
    let mut done = BTreeSet::new();
    for profile in &study.profiles {
        let budget = profile.evaluation.sandbox_pairs;
        if done.insert(budget) {
            findings.extend(budgeted(study, profile, true)?);
        }
    }
    for budget in OTHER_BUDGETS {
        if let Some(profile) = study.profiles.first().filter(|_| done.insert(budget)) {
            let mut other = profile.clone();
            other.evaluation.sandbox_pairs = budget;
            findings.extend(budgeted(study, &other, false)?);
        }
    }
    Ok(findings)
}

fn budgeted(study: &Study, profile: &Profile, stated: bool) -> Result<Vec<StudyFigure>, BenchError> {
    let budget = profile.evaluation.sandbox_pairs;
    let least = |rate: f64| stated.then_some(StatedBound::AtLeast(rate));
    let mut findings = Vec::new();
    for table in &study.recorded.sandbox {
        let under = format!("{}, {budget} pairs", table.name);
        let count = |what: &str,
                     worsen: &dyn Fn(&mut SampleStream, &mut Pair),
                     is: &dyn Fn(&BehaviorAssessment) -> bool| {
            let mut draw = SampleStream::new(&format!("{what} {under}"));
            let runs = 0..study.runs;
            let found = runs.filter(|_| is(&assess(&mut draw, table, profile, worsen))).count();
            (found as u64, u64::from(study.runs))
        };
        let outcome = |wanted| move |found: &BehaviorAssessment| found.assessment.outcome == wanted;
        let equal = count("equal", &|_, _| (), &outcome(BehaviorOutcome::Compatible));
        findings.push(rate(RULE, StudyMeasure::EqualCompatible, under.clone(), equal, least(0.97))?);
        let worse = count("worse", &anomalies, &outcome(BehaviorOutcome::Incompatible));
        findings.push(rate(RULE, StudyMeasure::AnomaliesIncompatible, under.clone(), worse, least(0.99))?);
        if stated {
            let traded = count("traded", &trade, &|found| {
                is_traded(found) && outcome(BehaviorOutcome::Compatible)(found)
            });
            let stated = Some(StatedBound::AtMost(0.0));
            findings.push(rate(RULE, StudyMeasure::TradeCompatible, under, traded, stated)?);
        }
    }
    Ok(findings)
}

fn assess(
    draw: &mut SampleStream,
    table: &RecordedTable,
    profile: &Profile,
    worsen: &dyn Fn(&mut SampleStream, &mut Pair),
) -> BehaviorAssessment {
    let mut pairs = draw.equal_pairs(table, profile.evaluation.sandbox_pairs);
    for pair in &mut pairs {
        worsen(draw, pair);
    }
    let evidence = PairedEvidence { binding: binding(), pairs, hard_stops: Vec::new() };
    behavior::assess(&evidence, &binding(), profile)
}

fn anomalies(draw: &mut SampleStream, pair: &mut Pair) {
    pair.candidate.anomaly |= draw.chance(WORSE);
}

/// A candidate that fails less often and violates a limit more often: within the violations' margin on average, so that
/// the rule on trades decides and not the sum.
fn trade(draw: &mut SampleStream, pair: &mut Pair) {
    if draw.chance(0.15) {
        pair.active.success = false;
    }
    pair.candidate.violation |= draw.chance(0.04);
}

fn is_traded(found: &BehaviorAssessment) -> bool {
    let of = |wanted: fn(&BehaviorComponent) -> bool| found.components.iter().any(wanted);
    of(|c| c.name == ComponentName::Success && c.worsening < 0.0)
        && of(|c| c.name.is_safety() && c.is_established())
}
