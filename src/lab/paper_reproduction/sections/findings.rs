//! The paper's four findings over all its experiments (its section 8.7), each with the numbers that support it.

use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::metrics::{Fate, Proportion};
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::stats::{SHOWN_LEVEL, bca};

use super::{Section, counted, deployment_tests};
use crate::paper_reproduction::figures::{
    RESAMPLE_SEED, RESAMPLES, SUCCESS, benign_refused, by_seed, is_faulty, last_round, variant_rows,
};
use crate::paper_reproduction::pool_screening::{ScreenRow, Variant};
use crate::paper_reproduction::report_table::ReportTable;
use crate::paper_reproduction::{Arm, RoundRow};
use crate::pipeline_experiments::ExperimentError;

const HELD: &str = "held";
const NOT_SHOWN: &str = "not shown";
const NOT_HELD: &str = "not held";

/// A finding, what shows it and the verdict.
type FindingRow = [String; 3];

/// The section; empty where neither rounds nor pools have what a finding rests on.
///
/// # Errors
/// If a number cannot be computed.
pub fn findings(rounds: &[RoundRow], pools: &[ScreenRow]) -> Result<Section, ExperimentError> {
    let mut all: Vec<FindingRow> = Vec::new();
    if has_arms(rounds, &[Arm::Naive, Arm::Governed]) {
        all.push(brittle(rounds)?);
    }
    if has_arms(rounds, &[Arm::Static, Arm::Governed]) {
        all.push(evolves(rounds)?);
    }
    if variant_rows(pools, ProfileName::Sim, Variant::Full).next().is_some() {
        all.push(many_checks(pools)?);
        all.push(provisional(pools)?);
    }
    if all.is_empty() {
        return Ok(Section::default());
    }
    let mut table = ReportTable::new(
        "The paper's findings over all experiments",
        &["finding", "here", "verdict"],
        "The first rests on a test of E2's family, the second on a 95 % BCa interval of its own, the others on counts with Wilson \
         intervals: held where the lower end is above zero.",
    );
    let held = all.iter().filter(|[_, _, verdict]| verdict == HELD).count();
    let line = format!("Of the paper's findings over all experiments {held} of {} are held here", all.len());
    for finding in all {
        table.row(finding);
    }
    Ok(Section {
        title: "Findings over all experiments".to_owned(),
        text: Vec::new(),
        tables: vec![table],
        plots: Vec::new(),
        lines: vec![line],
    })
}

fn has_arms(rounds: &[RoundRow], arms: &[Arm]) -> bool {
    arms.iter().all(|arm| rounds.iter().any(|row| row.arm == *arm))
}

/// Evolution without governance costs violations.
fn brittle(rounds: &[RoundRow]) -> Result<FindingRow, ExperimentError> {
    let tests = deployment_tests(rounds)?;
    let violations = tests.iter().find(|test| test.name.starts_with("violations"));
    let (mean, p) = violations.map_or((0.0, 1.0), |test| (test.mean, test.p_holm));
    let verdict = match (p < 0.05, mean < 0.0) {
        (true, true) => HELD,
        (true, false) => NOT_HELD,
        (false, _) => NOT_SHOWN,
    };
    Ok([
        "without governance evolution is brittle: it violates more".to_owned(),
        format!("governed - naive: {mean:+.1} points of sequences with a violation, p = {p:.3} (Holm)"),
        verdict.to_owned(),
    ])
}

/// Governance activates good versions, and performance grows by them.
fn evolves(rounds: &[RoundRow]) -> Result<FindingRow, ExperimentError> {
    let last = last_round(rounds);
    let [with, without] = [Arm::Governed, Arm::Static].map(|arm| by_seed(rounds, arm, last, SUCCESS));
    let differences: Vec<f64> = with.iter().zip(&without).map(|(with, without)| with - without).collect();
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
    let interval = bca(&differences, mean, SHOWN_LEVEL, RESAMPLES, RESAMPLE_SEED).ok();
    let refused = benign_refused(rounds, Arm::Governed)?;
    let (verdict, ends) = match interval {
        Some(ends) if ends.lower > 0.0 => (HELD, format!("[{:.1}, {:.1}]", ends.lower, ends.upper)),
        Some(ends) if ends.upper < 0.0 => (NOT_HELD, format!("[{:.1}, {:.1}]", ends.lower, ends.upper)),
        Some(ends) => (NOT_SHOWN, format!("[{:.1}, {:.1}]", ends.lower, ends.upper)),
        None => (NOT_SHOWN, "no variation".to_owned()),
    };
    Ok([
        "governance admits beneficial upgrades and performance grows".to_owned(),
        format!(
            "governed - static after {last} rounds: {:+.1} points of success {ends}; benign refused {}",
            mean(&differences),
            counted(&refused)
        ),
        verdict.to_owned(),
    ])
}

/// No single stage is enough: each stops faults that none before it did.
fn many_checks(pools: &[ScreenRow]) -> Result<FindingRow, ExperimentError> {
    let faulty = || {
        variant_rows(pools, ProfileName::Sim, Variant::Full)
            .filter(|row| is_faulty(row.class))
            .map(|row| row.end.fate)
    };
    let mut shares = Vec::new();
    for (name, stage) in
        [("validation", Stage::Validation), ("sandbox", Stage::Sandbox), ("shadow", Stage::Shadow)]
    {
        shares.push((name, Proportion::of(faulty().map(|fate| fate == Fate::Blocked { stage }))?));
    }
    let each = shares.iter().all(|(_, share)| share.interval.is_some_and(|ends| ends.lower > 0.0));
    let counts: Vec<String> =
        shares.iter().map(|(name, share)| format!("{name} {}", counted(share))).collect();
    Ok([
        "no single check is enough: each stops faults that none before it did".to_owned(),
        format!("stopped first by {}", counts.join(", by ")),
        if each { HELD } else { NOT_SHOWN }.to_owned(),
    ])
}

/// Some faults show only after activation.
fn provisional(pools: &[ScreenRow]) -> Result<FindingRow, ExperimentError> {
    let mut counts = Vec::new();
    let mut shown = false;
    for profile in ProfileName::ALL {
        let rows = variant_rows(pools, profile, Variant::Full).filter(|row| is_faulty(row.class));
        let faulty = Proportion::of(rows.map(|row| row.end.fate == Fate::Contained))?;
        if faulty.total > 0 {
            shown |= faulty.interval.is_some_and(|ends| ends.lower > 0.0);
            counts.push(format!("{profile} {}", counted(&faulty)));
        }
    }
    Ok([
        "activation is provisional: some faults show only after it, or under one profile".to_owned(),
        format!("of the faulty ones rolled back after activation: {}", counts.join(", ")),
        if shown { HELD } else { NOT_SHOWN }.to_owned(),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::candidate_pool::Class;
    use crate::paper_reproduction::pool_screening::screened;

    #[test]
    fn stage_that_stops_no_fault_first_leaves_its_finding_unshown() {
        let blocked =
            |name: &str, stage| screened(name, Class::Faulty, Variant::Full, Fate::Blocked { stage });
        let mut pools = vec![
            blocked("a", Stage::Validation),
            blocked("b", Stage::Sandbox),
            screened("c", Class::Marginal, Variant::Full, Fate::Contained),
        ];
        let verdicts = |pools: &[ScreenRow]| -> Vec<String> {
            let section = findings(&[], pools).unwrap();
            let rows = section.tables.into_iter().flat_map(|table| table.rows);
            rows.filter_map(|row| row.last().cloned()).collect()
        };
        assert_eq!(verdicts(&pools), [NOT_SHOWN, HELD]);
        pools.push(blocked("d", Stage::Shadow));
        assert_eq!(verdicts(&pools), [HELD, HELD]);
        assert_eq!(findings(&[], &[]).unwrap(), Section::default());
    }
}
