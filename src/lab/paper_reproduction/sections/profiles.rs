//! E5: the same pool under three profiles, the behavior of the activated versions, and whether the decisions are
//! reproducible.

use std::collections::BTreeMap;

use holdpoint_governance::metrics::{Fate, Proportion};
use holdpoint_governance::profile::ProfileName;

use super::Section;
use crate::candidate_pool::Class;
use crate::paper_reproduction::figures::{is_faulty, variant_rows};
use crate::paper_reproduction::pool_screening::{ScreenRow, Variant};
use crate::paper_reproduction::published::PublishedNumbers;
use crate::paper_reproduction::report_table::ReportTable;
use crate::pipeline_experiments::candidate_run::PostRunCheck;
use crate::pipeline_experiments::{ExperimentError, drift};
use crate::wording::{counted, report as wording, report_tables as tables};

/// The profiles, from the least strict to the strictest: the paper's order.
const PROFILES: [ProfileName; 3] = [ProfileName::Sim, ProfileName::Real, ProfileName::Human];

/// A sum over the candidates of a profile's whole pipeline.
fn sum(rows: &[ScreenRow], profile: ProfileName, count: fn(&PostRunCheck) -> u64) -> u64 {
    variant_rows(rows, profile, Variant::Full).map(|row| count(&row.end.afterwards)).sum()
}

/// The record of the activated versions while they were in control.
fn in_control(rows: &[ScreenRow], printed: &PublishedNumbers) -> Result<ReportTable, ExperimentError> {
    let mut table = ReportTable::new(tables::IN_CONTROL);
    for (place, profile) in PROFILES.into_iter().enumerate() {
        let all = || variant_rows(rows, profile, Variant::Full);
        let activated = || all().filter(|row| !matches!(row.end.fate, Fate::Blocked { .. }));
        let live = sum(rows, profile, |after| after.live);
        let paper =
            |list: &[f64; 3]| list.get(place).map_or_else(String::new, |value| format!("{value:.1} %"));
        table.row([
            profile.to_string(),
            counted(&Proportion::of(all().map(|row| !matches!(row.end.fate, Fate::Blocked { .. })))?),
            counted(&Proportion::of(activated().map(|row| row.end.afterwards.unsafe_seen))?),
            counted(&drift::counted(sum(rows, profile, |after| after.done), live)?),
            counted(&drift::counted(sum(rows, profile, |after| after.violation), live)?),
            counted(&drift::counted(sum(rows, profile, |after| after.near), live)?),
            paper(&printed.t9.unsafe_activation),
            paper(&printed.t9.success),
            paper(&printed.t9.violation),
        ]);
    }
    Ok(table)
}

/// Whether the profiles agree about the activated versions, and if not, whether the stricter profile is the one that
/// rejects.
fn consistency(rows: &[ScreenRow]) -> Result<ReportTable, ExperimentError> {
    let mut table = ReportTable::new(tables::CONSISTENCY);
    let activated = |profile: ProfileName, benign: bool| -> BTreeMap<(u64, &str), bool> {
        variant_rows(rows, profile, Variant::Full)
            .filter(|row| (row.class == Class::Benign) == benign)
            .map(|row| ((row.seed, row.name.as_str()), !matches!(row.end.fate, Fate::Blocked { .. })))
            .collect()
    };
    for pair in PROFILES.windows(2) {
        let [less_strict, stricter] = [pair[0], pair[1]];
        for (name, benign) in [("benign", true), ("faulty", false)] {
            let (by_less_strict, by_stricter) = (activated(less_strict, benign), activated(stricter, benign));
            let both: Vec<(bool, bool)> = by_less_strict
                .iter()
                .filter_map(|(key, left)| Some((*left, *by_stricter.get(key)?)))
                .collect();
            let share = |wanted: (bool, bool)| Proportion::of(both.iter().map(|found| *found == wanted));
            table.row([
                format!("{less_strict}, {stricter}"),
                name.to_owned(),
                counted(&share((true, true))?),
                counted(&share((true, false))?),
                counted(&share((false, true))?),
                counted(&share((false, false))?),
            ]);
        }
    }
    Ok(table)
}

/// Decisions that are equal when they are made again from the records.
fn audited(rows: &[ScreenRow]) -> Result<ReportTable, ExperimentError> {
    let mut table = ReportTable::new(tables::AUDITED);
    for profile in PROFILES {
        let unequal = variant_rows(rows, profile, Variant::Full)
            .map(|row| row.end.afterwards.equal < row.end.afterwards.decisions);
        table.row([
            profile.to_string(),
            counted(&drift::counted(
                sum(rows, profile, |after| after.equal),
                sum(rows, profile, |after| after.decisions),
            )?),
            counted(&Proportion::of(unequal)?),
        ]);
    }
    Ok(table)
}

/// E5: the same pool under the three profiles.
///
/// # Errors
/// If no interval exists for a count.
pub fn profiles(rows: &[ScreenRow], printed: &PublishedNumbers) -> Result<Section, ExperimentError> {
    if PROFILES.iter().any(|profile| variant_rows(rows, *profile, Variant::Full).next().is_none()) {
        return Ok(Section::default());
    }
    let mut table = ReportTable::new(tables::PROFILES);
    let mut false_rejects = Vec::new();
    for (place, profile) in PROFILES.into_iter().enumerate() {
        let faulty = || variant_rows(rows, profile, Variant::Full).filter(|row| is_faulty(row.class));
        let benign = || variant_rows(rows, profile, Variant::Full).filter(|row| row.class == Class::Benign);
        let before = |row: &ScreenRow| matches!(row.end.fate, Fate::Blocked { .. });
        let frr = Proportion::of(benign().map(before))?;
        false_rejects.push(frr);
        let published =
            |list: &[f64; 3]| list.get(place).map_or_else(String::new, |value| format!("{value:.1} %"));
        table.row([
            profile.to_string(),
            counted(&Proportion::of(faulty().map(before))?),
            counted(&Proportion::of(faulty().map(|row| row.end.fate != Fate::Kept))?),
            counted(&frr),
            counted(&Proportion::of(benign().map(|row| row.end.fate != Fate::Kept))?),
            published(&printed.t9.badr),
            published(&printed.t9.false_reject_rate),
        ]);
    }
    let monotone = false_rejects.windows(2).all(|pair| pair[0].rate() <= pair[1].rate());
    let enough = false_rejects.iter().all(|rate| rate.total >= 150);
    let tables = vec![table, consistency(rows)?, in_control(rows, printed)?, audited(rows)?];
    let line = wording::profiles(monotone, enough, &false_rejects);
    Ok(Section {
        title: wording::PROFILES.to_owned(),
        text: vec![line.clone()],
        tables,
        lines: vec![line],
        ..Section::default()
    })
}
