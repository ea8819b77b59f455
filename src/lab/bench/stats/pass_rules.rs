//! Pass rules ("at least K of N"): curtailment and the finite-population rule, at every look.

use std::collections::HashMap;

use super::Study;
use super::figure::{StatedBound, StudyFigure, StudyMeasure, rate, unjudged};
use super::sampling::SampleStream;
use holdpoint::bench::BenchError;
use holdpoint_governance::stats::StatsError;
use holdpoint_governance::stats::population::RunBudget;

/// Runs and passes needed: the published example, and a kind of drills at the floor of `real`.
const RULES: [(u64, u64); 2] = [(150, 135), (40, 30)];

/// Error rates of the finite-population rule: triage, a profile's early level, activation.
const ALPHAS: [f64; 3] = [0.05, 0.01, 0.001];

/// True rates of a run's success.
const RATES: [f64; 6] = [0.5, 0.7, 0.85, 0.9, 0.95, 1.0];

pub(super) fn study(study: &Study) -> Result<Vec<StudyFigure>, BenchError> {
    let mut findings = Vec::new();
    for (runs, needed) in RULES {
        let population = RunBudget::new(runs)?;
        let mut looks = CachedVerdicts { runs, needed, population, known: HashMap::new() };
        for rate in RATES {
            let under = format!("{needed} of {runs}, success {rate}");
            let mut draw = SampleStream::new(&under);
            findings
                .extend(one(study, &mut looks, &under, |_| (0..runs).map(|_| draw.chance(rate)).collect())?);
        }
        // The boundary: populations one success short of the rule, and just within it, in random order.
        for total in [needed - 1, needed] {
            let under = format!("{needed} of {runs}, exactly {total} succeed");
            let mut draw = SampleStream::new(&under);
            findings.extend(one(study, &mut looks, &under, |_| {
                let mut outcomes: Vec<bool> = (0..runs).map(|index| index < total).collect();
                draw.shuffle(&mut outcomes);
                outcomes
            })?);
        }
    }
    Ok(findings)
}

/// Whether the full run would pass; `None` while that is open. Each verdict of the finite population is computed once.
struct CachedVerdicts {
    runs: u64,
    needed: u64,
    population: RunBudget,
    known: HashMap<(u64, u64, u64), Option<bool>>,
}

impl CachedVerdicts {
    /// Whatever the remaining runs are.
    fn exact(&self, successes: u64, seen: u64) -> Option<bool> {
        self.within(successes, successes + (self.runs - seen))
    }

    fn within(&self, least: u64, most: u64) -> Option<bool> {
        (least >= self.needed || most < self.needed).then_some(least >= self.needed)
    }

    fn verdict(&mut self, successes: u64, seen: u64, alpha: f64) -> Result<Option<bool>, StatsError> {
        let key = (successes, seen, alpha.to_bits());
        if let Some(verdict) = self.known.get(&key) {
            return Ok(*verdict);
        }
        let (least, most) = self.population.passes(successes, seen, alpha)?;
        let verdict = self.within(least, most);
        self.known.insert(key, verdict);
        Ok(verdict)
    }

    /// Where the rule first decides, looked at after every run, and what.
    fn end(
        &mut self,
        outcomes: &[bool],
        mut decide: impl FnMut(&mut Self, u64, u64) -> Result<Option<bool>, StatsError>,
    ) -> Result<(u64, Option<bool>), StatsError> {
        let (mut successes, mut seen) = (0, 0);
        for outcome in outcomes {
            successes += u64::from(*outcome);
            seen += 1;
            let verdict = decide(self, successes, seen)?;
            if verdict.is_some() {
                return Ok((seen, verdict));
            }
        }
        Ok((seen, None))
    }
}

fn one(
    study: &Study,
    looks: &mut CachedVerdicts,
    under: &str,
    mut outcomes: impl FnMut(u32) -> Vec<bool>,
) -> Result<Vec<StudyFigure>, BenchError> {
    let all = u64::from(study.runs);
    let (mut wrong, mut used) = ([0u64; ALPHAS.len()], [0u64; ALPHAS.len()]);
    let (mut differing, mut curtailed) = (0, 0);
    for run in 0..study.runs {
        let outcomes = outcomes(run);
        let total = outcomes.iter().filter(|success| **success).count() as u64;
        let full = Some(total >= looks.needed);
        let (seen, verdict) = looks.end(&outcomes, |looks, k, t| Ok(looks.exact(k, t)))?;
        curtailed += seen;
        differing += u64::from(verdict != full);
        for (index, alpha) in ALPHAS.into_iter().enumerate() {
            let (seen, verdict) = looks.end(&outcomes, |looks, k, t| looks.verdict(k, t, alpha))?;
            used[index] += seen;
            wrong[index] += u64::from(verdict != full);
        }
    }
    let mut findings = vec![
        rate(
            "exact curtailment",
            StudyMeasure::DiffersFromFullRun,
            under.to_owned(),
            (differing, all),
            Some(StatedBound::AtMost(0.0)),
        )?,
        unjudged(
            "exact curtailment",
            StudyMeasure::RunsUsed,
            under.to_owned(),
            all,
            curtailed as f64 / all as f64,
            "runs",
        ),
    ];
    for (index, alpha) in ALPHAS.into_iter().enumerate() {
        let under = format!("{under}, alpha {alpha}");
        let rule = "finite population, pass rule";
        findings.push(rate(
            rule,
            StudyMeasure::DiffersFromFullRun,
            under.clone(),
            (wrong[index], all),
            Some(StatedBound::AtMost(alpha)),
        )?);
        findings.push(unjudged(
            rule,
            StudyMeasure::RunsUsed,
            under,
            all,
            used[index] as f64 / all as f64,
            "runs",
        ));
    }
    Ok(findings)
}
