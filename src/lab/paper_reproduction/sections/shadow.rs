//! E3: the findings of shadow that the sandbox does not have, by class of fault and by the paper's categories, and the
//! harm it avoids.

use std::collections::{BTreeMap, BTreeSet};

use holdpoint_governance::decision::Dimension;
use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::metrics::{Fate, srdr};
use holdpoint_governance::profile::ProfileName;

use super::{Section, counted};
use crate::candidate_pool::Class;
use crate::paper_reproduction::figures::{is_faulty, variant_rows};
use crate::paper_reproduction::pool_screening::{ScreenRow, Variant};
use crate::paper_reproduction::published::PublishedNumbers;
use crate::paper_reproduction::regression::Regression;
use crate::paper_reproduction::report_table::ReportTable;
use crate::pipeline_experiments::{ExperimentError, drift};

type FullPipelineRows<'a> = BTreeMap<(u64, &'a str), &'a ScreenRow>;

/// By category, as the paper counts: one detection is a candidate and a category.
fn by_category(
    whole: &FullPipelineRows<'_>,
    alone: &[&ScreenRow],
    printed: &PublishedNumbers,
) -> Result<(ReportTable, String), ExperimentError> {
    let mut counts: BTreeMap<Regression, [u64; 2]> = BTreeMap::new();
    for row in alone.iter().filter(|row| is_faulty(row.class)) {
        let Some(full) = whole.get(&(row.seed, row.name.as_str())) else { continue };
        let sandbox = if full.end.fate == (Fate::Blocked { stage: Stage::Sandbox }) {
            full.end.found.clone()
        } else {
            BTreeSet::new()
        };
        let shadow = &row.end.found;
        for category in sandbox.union(shadow) {
            let [by_sandbox, by_shadow_only] = counts.entry(*category).or_default();
            *if sandbox.contains(category) { by_sandbox } else { by_shadow_only } += 1;
        }
    }
    let mut table = ReportTable::new(
        "Detections by category of regression",
        &["category", "sandbox", "shadow only", "paper: sandbox", "shadow only"],
        "A detection is a faulty candidate and a category that the reasons of the stage that stopped it name; shadow only: \
         named by shadow alone and not by the sandbox. The last row is not among the paper's categories.",
    );
    let (mut sandbox_all, mut shadow_all) = (0, 0);
    for category in Regression::ALL {
        let [sandbox, shadow] = counts.get(&category).copied().unwrap_or_default();
        sandbox_all += sandbox;
        shadow_all += shadow;
        let published =
            |list: &[u32; 5]| list.get(category as usize).map_or_else(|| "-".to_owned(), u32::to_string);
        table.row([
            category.to_string(),
            sandbox.to_string(),
            shadow.to_string(),
            published(&printed.f5.sandbox_by),
            published(&printed.f5.shadow_only_by),
        ]);
    }
    let share = drift::counted(shadow_all, sandbox_all + shadow_all)?;
    let f5 = &printed.f5;
    let paper = 100.0 * f64::from(f5.shadow_only) / f64::from(f5.shadow_only + f5.sandbox);
    Ok((
        table,
        format!(
            "of detections (candidate and category) shadow alone makes {} (paper: {paper:.0} %)",
            counted(&share)
        ),
    ))
}

/// Equation 19 with the counterfactual really run: of the regressions that show once a version is activated without a
/// shadow, the proportion that shadow shows before.
fn avoided_regressions(
    rows: &[ScreenRow],
    whole: &FullPipelineRows<'_>,
) -> Result<(ReportTable, String), ExperimentError> {
    let without = variant_rows(rows, ProfileName::Sim, Variant::NoShadow);
    let activated: Vec<&ScreenRow> =
        without.filter(|row| !matches!(row.end.fate, Fate::Blocked { .. })).collect();
    let regressed = |row: &&&ScreenRow| row.end.fate == Fate::Contained || row.end.afterwards.unsafe_seen;
    let shown = |row: &&ScreenRow| {
        let full = whole.get(&(row.seed, row.name.as_str()));
        full.is_some_and(|full| full.end.fate == Fate::Blocked { stage: Stage::Shadow })
    };
    let rate = srdr(activated.iter().filter(regressed).map(shown))?;
    let quiet = srdr(activated.iter().filter(|row| !regressed(row)).map(shown))?;
    let mut table = ReportTable::new(
        "Activated without a shadow (the counterfactual of equation 19)",
        &["then", "shadow had shown it before"],
        "Regressed: rolled back, or seen unsafe while in control. What shadow stops and nothing is seen of later is either \
         spared for another day or stopped for nothing.",
    );
    table.row(["regressed while in control".to_owned(), counted(&rate)]);
    table.row(["showed nothing until confirmed".to_owned(), counted(&quiet)]);
    Ok((table, format!("true SRDR {}", counted(&rate))))
}

/// E3: the findings of shadow that the sandbox does not have.
///
/// # Errors
/// If no interval exists for a count.
pub fn shadow(rows: &[ScreenRow], printed: &PublishedNumbers) -> Result<Section, ExperimentError> {
    let whole: FullPipelineRows<'_> = variant_rows(rows, ProfileName::Sim, Variant::Full)
        .map(|row| ((row.seed, row.name.as_str()), row))
        .collect();
    let alone: Vec<&ScreenRow> = variant_rows(rows, ProfileName::Sim, Variant::ShadowAlone).collect();
    if whole.is_empty() || alone.is_empty() {
        return Ok(Section::default());
    }
    let mut table = ReportTable::new(
        "Faults that measuring finds, by class",
        &["class", "candidates", "sandbox", "shadow alone", "both", "shadow only", "neither"],
        "Sandbox: rejected or held there in the whole way. Shadow alone: rejected or held at shadow or the gate where \
         validation and sandbox are left out, so that every candidate reaches it. Faults that validation stops are not \
         counted: they never reach the sandbox.",
    );
    let mut total = [0_u64; 4];
    for (name, class, dimension) in [
        ("behavior", Class::Faulty, Some(Dimension::Behavior)),
        ("recovery", Class::Faulty, Some(Dimension::Recovery)),
        ("marginal", Class::Marginal, None),
        ("benign", Class::Benign, None),
    ] {
        let candidates = alone.iter().filter(|row| {
            row.class == class && dimension.is_none_or(|dimension| row.dimension == Some(dimension))
        });
        let mut counts = [0_u64; 4];
        for row in candidates {
            let Some(full) = whole.get(&(row.seed, row.name.as_str())) else { continue };
            let sandbox = full.end.fate == Fate::Blocked { stage: Stage::Sandbox };
            let shadow = matches!(row.end.fate, Fate::Blocked { .. });
            counts[usize::from(sandbox) + 2 * usize::from(shadow)] += 1;
        }
        let [neither, sandbox, shadow_only, both] = counts;
        if class != Class::Benign {
            for (sum, count) in total.iter_mut().zip(counts) {
                *sum += count;
            }
        }
        let cells = [
            sandbox + both + shadow_only + neither,
            sandbox + both,
            shadow_only + both,
            both,
            shadow_only,
            neither,
        ];
        table.row(std::iter::once(name.to_owned()).chain(cells.map(|count| count.to_string())));
    }
    let [_, sandbox, shadow_only, both] = total;
    let share = drift::counted(shadow_only, sandbox + shadow_only + both)?;
    let f5 = &printed.f5;
    let paper = 100.0 * f64::from(f5.shadow_only) / f64::from(f5.shadow_only + f5.sandbox);
    let (categories, detections) = by_category(&whole, &alone, printed)?;
    let (counterfactual, discovered) = avoided_regressions(rows, &whole)?;
    let line =
        format!("E3: found by shadow and not by the sandbox {}; {detections}; {discovered}", counted(&share));
    Ok(Section {
        title: "E3: shadow".to_owned(),
        text: vec![format!(
            "Of the faults that either finds, shadow alone finds {}. The paper counts {paper:.0} %, by a unit \
                     of its own (candidate and category; readings X10, X34).",
            counted(&share)
        )],
        tables: vec![table, categories, counterfactual],
        plots: Vec::new(),
        lines: vec![line],
    })
}
