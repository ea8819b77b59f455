//! The thresholds of the four kappas a tenth lower and a tenth higher.

use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::metrics::{Fate, Proportion};
use holdpoint_governance::profile::ProfileName;

use super::{Section, counted};
use crate::experiment::ExperimentError;
use crate::paper::figures::{is_faulty, way};
use crate::paper::printed::Printed;
use crate::paper::screen::{ScreenRow, Variant};
use crate::paper::table::Table;
use crate::pool::Class;

/// The section; empty where they were not moved.
///
/// # Errors
/// If no interval exists for a count.
pub fn sensitivity(rows: &[ScreenRow], printed: &Printed) -> Result<Section, ExperimentError> {
    if way(rows, ProfileName::Sim, Variant::Relaxed).next().is_none() {
        return Ok(Section::default());
    }
    let mut table = Table::new(
        "Thresholds moved by a tenth (profile sim)",
        &[
            "thresholds",
            "stopped by validation or sandbox",
            "stopped or taken off",
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
    let worked = |variant: Variant| way(rows, ProfileName::Sim, variant).next().is_some();
    let settings = settings.into_iter().filter(|(_, variant)| worked(*variant));
    // The paper prints one table; the second reading is of the same (readings 2.3).
    let papers = printed.t12.badr.iter().zip(&printed.t12.false_reject_rate).cycle();
    let mut changed = Vec::new();
    for ((name, variant), (badr, frr)) in settings.zip(papers) {
        let of = |test: fn(&ScreenRow) -> bool, found: fn(Fate) -> bool| {
            Proportion::of(
                way(rows, ProfileName::Sim, variant).filter(|row| test(row)).map(|row| found(row.end.fate)),
            )
        };
        let early = |fate| matches!(fate, Fate::Blocked { stage: Stage::Validation | Stage::Sandbox });
        let otherwise = Proportion::of(way(rows, ProfileName::Sim, variant).filter_map(|row| {
            let base = way(rows, ProfileName::Sim, Variant::Full)
                .find(|base| base.seed == row.seed && base.name == row.name)?;
            Some(base.end.fate != row.end.fate)
        }))?;
        changed.push(otherwise);
        table.row([
            name.to_owned(),
            counted(&of(|row| is_faulty(row.class), early)?),
            counted(&of(|row| is_faulty(row.class), |fate| fate != Fate::Kept)?),
            counted(&of(|row| row.class == Class::Benign, |fate| matches!(fate, Fate::Blocked { .. }))?),
            counted(&otherwise),
            format!("{badr:.1} %"),
            format!("{frr:.1} %"),
        ]);
    }
    let [lower, _, higher, ..] = changed.as_slice() else { return Ok(Section::default()) };
    let line = format!(
        "Sensitivity: with thresholds a tenth lower {} end otherwise, a tenth higher {}",
        counted(lower),
        counted(higher)
    );
    Ok(Section {
        title: "Sensitivity to the thresholds".to_owned(),
        text: Vec::new(),
        tables: vec![table],
        plots: Vec::new(),
        lines: vec![line],
    })
}
