//! The paper's four findings over all its experiments (its section 8.7), each with the numbers that support it.

use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::metrics::{Fate, Proportion};
use holdpoint_governance::profile::ProfileName;

use super::{DirectionVerdict, Section, deployment_tests};
use crate::paper_reproduction::figures::{
    ComparedMeasure, SUCCESS, benign_refused, differences, interval_of_mean, is_faulty, last_round, mean_of,
    variant_rows,
};
use crate::paper_reproduction::pool_screening::{ScreenRow, Variant};
use crate::paper_reproduction::report_table::ReportTable;
use crate::paper_reproduction::{Arm, RoundRow};
use crate::pipeline_experiments::ExperimentError;
use crate::wording::{report as wording, report_tables as tables};

/// A finding, the numbers that it rests on, and the verdict.
type FindingRow = (&'static str, String, DirectionVerdict);

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
    let mut table = ReportTable::new(tables::FINDINGS);
    let held = all.iter().filter(|(.., verdict)| *verdict == DirectionVerdict::Held).count();
    let lines = vec![wording::findings(held, all.len())];
    for (finding, because, verdict) in all {
        table.row([finding, because.as_str(), wording::verdict(verdict)]);
    }
    Ok(Section { title: wording::FINDINGS.to_owned(), tables: vec![table], lines, ..Section::default() })
}

fn has_arms(rounds: &[RoundRow], arms: &[Arm]) -> bool {
    arms.iter().all(|arm| rounds.iter().any(|row| row.arm == *arm))
}

/// Evolution without governance costs violations.
fn brittle(rounds: &[RoundRow]) -> Result<FindingRow, ExperimentError> {
    let tests = deployment_tests(rounds)?;
    let violations = tests.iter().find(|test| test.measure == ComparedMeasure::Violations);
    let verdict = violations.map_or(DirectionVerdict::NotShown, |test| DirectionVerdict::of_test(test, -1.0));
    let (mean, p) = violations.map_or((0.0, 1.0), |test| (test.mean, test.p_holm));
    Ok((wording::BRITTLE, wording::brittle(mean, p), verdict))
}

/// Governance activates good versions, and performance grows by them.
fn evolves(rounds: &[RoundRow]) -> Result<FindingRow, ExperimentError> {
    let points = differences(rounds, [Arm::Governed, Arm::Static], SUCCESS);
    let interval = interval_of_mean(&points).ok();
    let verdict = interval
        .map_or(DirectionVerdict::NotShown, |ends| DirectionVerdict::above_zero(ends.lower, ends.upper));
    let refused = benign_refused(rounds, Arm::Governed)?;
    let because = wording::evolves(last_round(rounds), mean_of(&points), interval, &refused);
    Ok((wording::EVOLVES, because, verdict))
}

/// Whether one of the rates is shown to be above zero.
fn is_shown(rate: &Proportion) -> bool {
    rate.interval.is_some_and(|ends| ends.lower > 0.0)
}

const fn held_if(shown: bool) -> DirectionVerdict {
    if shown { DirectionVerdict::Held } else { DirectionVerdict::NotShown }
}

/// No single stage is enough: each stops faults that none before it did.
fn many_checks(pools: &[ScreenRow]) -> Result<FindingRow, ExperimentError> {
    let mut shares = Vec::new();
    for stage in [Stage::Validation, Stage::Sandbox, Stage::Shadow] {
        let faulty = variant_rows(pools, ProfileName::Sim, Variant::Full).filter(|row| is_faulty(row.class));
        let stopped = faulty.map(|row| row.end.fate == Fate::Blocked { stage });
        shares.push((stage.name(), Proportion::of(stopped)?));
    }
    let each = shares.iter().all(|(_, share)| is_shown(share));
    Ok((wording::MANY_CHECKS, wording::stopped_first(&shares), held_if(each)))
}

/// Some faults show only after activation.
fn provisional(pools: &[ScreenRow]) -> Result<FindingRow, ExperimentError> {
    let mut rates = Vec::new();
    for profile in ProfileName::ALL {
        let rows = variant_rows(pools, profile, Variant::Full).filter(|row| is_faulty(row.class));
        let faulty = Proportion::of(rows.map(|row| row.end.fate == Fate::Contained))?;
        if faulty.total > 0 {
            rates.push((profile.name(), faulty));
        }
    }
    let shown = rates.iter().any(|(_, rate)| is_shown(rate));
    Ok((wording::PROVISIONAL, wording::rolled_back_after(&rates), held_if(shown)))
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
        let [held, not_shown] = [DirectionVerdict::Held, DirectionVerdict::NotShown].map(wording::verdict);
        assert_eq!(verdicts(&pools), [not_shown, held]);
        pools.push(blocked("d", Stage::Shadow));
        assert_eq!(verdicts(&pools), [held, held]);
        assert_eq!(findings(&[], &[]).unwrap(), Section::default());
    }
}
