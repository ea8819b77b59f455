//! The thresholds of the four kappas a tenth lower and a tenth higher.

use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::metrics::{Fate, Proportion};
use holdpoint_governance::profile::ProfileName;

use super::{Section, mean, seeds_in};
use crate::candidate_pool::Class;
use crate::paper_reproduction::figures::{
    LIVE_UNSAFE, RowMeasure, SUCCESS, VIOLATION, by_seed, is_faulty, last_round, unsafe_activations,
    variant_rows,
};
use crate::paper_reproduction::pool_screening::{ScreenRow, Variant};
use crate::paper_reproduction::published::PublishedNumbers;
use crate::paper_reproduction::report_table::ReportTable;
use crate::paper_reproduction::{Arm, RoundRow};
use crate::pipeline_experiments::ExperimentError;
use crate::wording::{counted, plus_minus, report as wording, report_tables as tables};

/// The section; empty where they were not moved. `of`: the seeds that the preset has.
///
/// # Errors
/// If no interval exists for a count.
pub fn sensitivity(
    rounds: &[RoundRow],
    rows: &[ScreenRow],
    printed: &PublishedNumbers,
    preset_seeds: u64,
) -> Result<Section, ExperimentError> {
    let (in_pools, in_rounds) = (of_pools(rows, printed)?, of_rounds(rounds, printed, preset_seeds)?);
    if in_pools.is_none() && in_rounds.is_none() {
        return Ok(Section::default());
    }
    let (tables, lines) = in_pools.into_iter().chain(in_rounds).unzip();
    Ok(Section { title: wording::SENSITIVITY.to_owned(), tables, lines, ..Section::default() })
}

/// The results of the whole pipeline over rounds of upgrades, and their lines.
fn of_rounds(
    rows: &[RoundRow],
    printed: &PublishedNumbers,
    preset_seeds: u64,
) -> Result<Option<(ReportTable, String)>, ExperimentError> {
    let arms = [Arm::Relaxed, Arm::Governed, Arm::Strict];
    if !arms.iter().all(|arm| rows.iter().any(|row| row.arm == *arm)) {
        return Ok(None);
    }
    let last = last_round(rows);
    let mut table = ReportTable::new(tables::SCALED_ROUNDS);
    table.seeds = Some((seeds_in(rows, |row| row.seed), preset_seeds));
    let t12 = &printed.t12;
    let papers = t12.success.iter().zip(&t12.unsafe_activation).zip(&t12.violation);
    let mut changed = Vec::new();
    for ((name, arm), ((success, unsafe_activation), violation)) in
        wording::THRESHOLDS.iter().zip(arms).zip(papers)
    {
        let ours = |measure: RowMeasure| mean(&by_seed(rows, arm, last, measure));
        let differing = Proportion::of(rows.iter().filter(|row| row.arm == arm).filter_map(|row| {
            let is_same =
                |base: &&RoundRow| (base.arm, base.seed, base.round) == (Arm::Governed, row.seed, row.round);
            Some(rows.iter().find(is_same)?.in_force != row.in_force)
        }))?;
        changed.push(differing.count);
        table.row([
            (*name).to_owned(),
            ours(SUCCESS),
            ours(LIVE_UNSAFE),
            ours(VIOLATION),
            counted(&unsafe_activations(rows, arm, None)?),
            wording::of_rounds(&differing),
            plus_minus(*success),
            plus_minus(*unsafe_activation),
            plus_minus(*violation),
        ]);
    }
    let [lower, _, higher] = changed[..] else { return Ok(None) };
    Ok(Some((table, wording::changed_rounds(lower, higher))))
}

/// The ends of the pools' candidates, and their lines.
fn of_pools(
    rows: &[ScreenRow],
    printed: &PublishedNumbers,
) -> Result<Option<(ReportTable, String)>, ExperimentError> {
    if variant_rows(rows, ProfileName::Sim, Variant::Relaxed).next().is_none() {
        return Ok(None);
    }
    let mut table = ReportTable::new(tables::SCALED_POOLS);
    let settings = [
        Variant::Relaxed,
        Variant::Full,
        Variant::Strict,
        Variant::B88Relaxed,
        Variant::B88,
        Variant::B88Strict,
    ];
    let settings = wording::THRESHOLDS.into_iter().chain(wording::THRESHOLDS_B88).zip(settings);
    let was_run = |variant: Variant| variant_rows(rows, ProfileName::Sim, variant).next().is_some();
    let settings = settings.filter(|(_, variant)| was_run(*variant));
    // The paper prints one table; the second reading is of the same (readings 2.3).
    let papers = printed.t12.badr.iter().zip(&printed.t12.false_reject_rate).cycle();
    let mut changed = Vec::new();
    for ((name, variant), (badr, frr)) in settings.zip(papers) {
        let share = |test: fn(&ScreenRow) -> bool, found: fn(Fate) -> bool| {
            Proportion::of(
                variant_rows(rows, ProfileName::Sim, variant)
                    .filter(|row| test(row))
                    .map(|row| found(row.end.fate)),
            )
        };
        let early = |fate| matches!(fate, Fate::Blocked { stage: Stage::Validation | Stage::Sandbox });
        let differing = Proportion::of(variant_rows(rows, ProfileName::Sim, variant).filter_map(|row| {
            let base = variant_rows(rows, ProfileName::Sim, Variant::Full)
                .find(|base| base.seed == row.seed && base.name == row.name)?;
            Some(base.end.fate != row.end.fate)
        }))?;
        changed.push(differing);
        table.row([
            name.to_owned(),
            counted(&share(|row| is_faulty(row.class), early)?),
            counted(&share(|row| is_faulty(row.class), |fate| fate != Fate::Kept)?),
            counted(&share(|row| row.class == Class::Benign, |fate| matches!(fate, Fate::Blocked { .. }))?),
            counted(&differing),
            format!("{badr:.1} %"),
            format!("{frr:.1} %"),
        ]);
    }
    let [lower, _, higher, ..] = changed.as_slice() else { return Ok(None) };
    Ok(Some((table, wording::changed_candidates(lower, higher))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::paper_reproduction::rounds::HeldOutScore;
    use holdpoint_governance::ids::Digest;

    fn row(arm: Arm, seed: u64, in_force: &str, done: u64) -> RoundRow {
        RoundRow {
            seed,
            round: 1,
            arm,
            offered: None,
            in_force: Digest::of_parts(in_force, &[]),
            faulty_in_force: false,
            harmful_in_force: Some(false),
            score: HeldOutScore { sequences: 50, done, ..HeldOutScore::default() },
        }
    }

    #[test]
    fn rounds_under_scaled_thresholds_are_compared_with_the_unscaled_ones() {
        let printed = PublishedNumbers::builtin().unwrap();
        let mut rows = vec![
            row(Arm::Governed, 40, "a", 30),
            row(Arm::Governed, 41, "a", 40),
            row(Arm::Relaxed, 40, "b", 20),
            row(Arm::Relaxed, 41, "a", 40),
        ];
        assert_eq!(
            sensitivity(&rows, &[], &printed, 5).unwrap(),
            Section::default(),
            "one setting is missing"
        );
        rows.extend([row(Arm::Strict, 40, "a", 30), row(Arm::Strict, 41, "a", 40)]);
        let section = sensitivity(&rows, &[], &printed, 5).unwrap();
        let [table] = section.tables.as_slice() else { panic!("{section:?}") };
        assert_eq!(table.seeds, Some((2, 5)));
        let row_of = |name: &str| table.rows.iter().find(|row| row[0] == name).unwrap().clone();
        assert_eq!(
            [row_of("a tenth lower")[1].as_str(), &row_of("a tenth lower")[5]],
            ["60.0 ± 28.3", "1 of 2 rounds"]
        );
        assert_eq!(
            [row_of("as they are")[1].as_str(), &row_of("as they are")[5]],
            ["70.0 ± 14.1", "0 of 2 rounds"]
        );
        assert_eq!(row_of("a tenth higher")[6..], ["69.7 ± 8.2", "0.0 ± 0.0", "9.2 ± 4.6"]);
        let line = &section.lines[0];
        assert!(line.contains("in 1 ") && line.contains("in 0 "), "{line}");
    }
}
