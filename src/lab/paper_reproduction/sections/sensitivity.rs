//! The thresholds of the four kappas a tenth lower and a tenth higher.

use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::metrics::{Fate, Proportion};
use holdpoint_governance::profile::ProfileName;

use super::{Section, counted, mean, seeds_in};
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
    Ok(Section {
        title: "Sensitivity to the thresholds".to_owned(),
        text: Vec::new(),
        tables,
        plots: Vec::new(),
        lines,
    })
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
    let mut table = ReportTable::new(
        "Rounds with the thresholds moved by a tenth, last round, percent",
        &[
            "thresholds",
            "success",
            "unsafe version in force",
            "violations",
            "unsafe / activated, all rounds",
            "another version in force than as they are",
            "paper: success",
            "unsafe",
            "violations",
        ],
        "Governed in each row, on the same candidates and held-out sequences. The paper's numbers are of five seeds and six rounds.",
    );
    table.seeds = Some((seeds_in(rows, |row| row.seed), preset_seeds));
    let t12 = &printed.t12;
    let papers = t12.success.iter().zip(&t12.unsafe_activation).zip(&t12.violation);
    let names = ["a tenth lower", "as they are", "a tenth higher"];
    let mut changed = Vec::new();
    for ((name, arm), ((success, unsafe_activation), violation)) in names.iter().zip(arms).zip(papers) {
        let ours = |measure: RowMeasure| mean(&by_seed(rows, arm, last, measure));
        let published = |[mean, deviation]: &[f64; 2]| format!("{mean:.1} ± {deviation:.1}");
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
            format!("{} of {} rounds", differing.count, differing.total),
            published(success),
            published(unsafe_activation),
            published(violation),
        ]);
    }
    let line = format!(
        "Sensitivity in rounds: other versions are in force in {} rounds with thresholds a tenth lower, in {} a tenth higher",
        changed.first().copied().unwrap_or(0),
        changed.last().copied().unwrap_or(0)
    );
    Ok(Some((table, line)))
}

/// The ends of the pools' candidates, and their lines.
fn of_pools(
    rows: &[ScreenRow],
    printed: &PublishedNumbers,
) -> Result<Option<(ReportTable, String)>, ExperimentError> {
    if variant_rows(rows, ProfileName::Sim, Variant::Relaxed).next().is_none() {
        return Ok(None);
    }
    let mut table = ReportTable::new(
        "Thresholds moved by a tenth (profile sim)",
        &[
            "thresholds",
            "stopped by validation or sandbox",
            "stopped or rolled back",
            "benign rejected",
            "otherwise decided than as they are",
            "paper: BADR",
            "false reject rate",
        ],
        "Every setting is run. A threshold above 1 is read as 1: the paper's kappa_I of 1.045 would reject everything (readings X24).",
    );
    let settings = [
        ("a tenth lower", Variant::Relaxed),
        ("as they are", Variant::Full),
        ("a tenth higher", Variant::Strict),
        ("kappa_B .88, a tenth lower", Variant::B88Relaxed),
        ("kappa_B .88", Variant::B88),
        ("kappa_B .88, a tenth higher", Variant::B88Strict),
    ];
    let was_run = |variant: Variant| variant_rows(rows, ProfileName::Sim, variant).next().is_some();
    let settings = settings.into_iter().filter(|(_, variant)| was_run(*variant));
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
    let line = format!(
        "Sensitivity: with thresholds a tenth lower {} end otherwise, a tenth higher {}",
        counted(lower),
        counted(higher)
    );
    Ok(Some((table, line)))
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
