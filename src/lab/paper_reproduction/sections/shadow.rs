//! E3: the findings of shadow that the sandbox does not have, by class of fault and by the paper's categories, and the
//! harm it avoids.

use std::collections::{BTreeMap, BTreeSet};

use holdpoint_governance::decision::Dimension;
use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::metrics::{Fate, Proportion};
use holdpoint_governance::profile::ProfileName;

use super::Section;
use crate::candidate_pool::Class;
use crate::paper_reproduction::figures::{is_faulty, variant_rows};
use crate::paper_reproduction::pool_screening::{ScreenRow, Variant};
use crate::paper_reproduction::published::PublishedNumbers;
use crate::paper_reproduction::regression::Regression;
use crate::paper_reproduction::report_table::ReportTable;
use crate::pipeline_experiments::{ExperimentError, drift};
use crate::wording::{counted, or_dash, report as wording, report_tables as tables};

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
    let mut table = ReportTable::new(tables::BY_CATEGORY);
    let (mut sandbox_all, mut shadow_all) = (0, 0);
    for category in Regression::ALL {
        let [sandbox, shadow] = counts.get(&category).copied().unwrap_or_default();
        sandbox_all += sandbox;
        shadow_all += shadow;
        let published = |list: &[u32; 5]| or_dash(list.get(category as usize).map(u32::to_string));
        table.row([
            category.to_string(),
            sandbox.to_string(),
            shadow.to_string(),
            published(&printed.f5.sandbox_by),
            published(&printed.f5.shadow_only_by),
        ]);
    }
    let share = drift::counted(shadow_all, sandbox_all + shadow_all)?;
    Ok((table, wording::detections(&share, printed.f5.shadow_only_percent())))
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
    let rate = Proportion::of(activated.iter().filter(regressed).map(shown))?;
    let quiet = Proportion::of(activated.iter().filter(|row| !regressed(row)).map(shown))?;
    let mut table = ReportTable::new(tables::COUNTERFACTUAL);
    let [regressed, unseen] = wording::AFTER_ACTIVATION;
    table.row([regressed.to_owned(), counted(&rate)]);
    table.row([unseen.to_owned(), counted(&quiet)]);
    Ok((table, wording::true_srdr(&rate)))
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
    let mut table = ReportTable::new(tables::SHADOW_BY_CLASS);
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
    let paper = printed.f5.shadow_only_percent();
    let (categories, detections) = by_category(&whole, &alone, printed)?;
    let (counterfactual, discovered) = avoided_regressions(rows, &whole)?;
    Ok(Section {
        title: wording::SHADOW.to_owned(),
        text: vec![wording::shadow_alone(&share, paper)],
        tables: vec![table, categories, counterfactual],
        lines: vec![wording::shadow(&share, &detections, &discovered)],
        ..Section::default()
    })
}
