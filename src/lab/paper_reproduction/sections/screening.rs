//! E1: which faults are stopped at which stage, which benign candidates are lost, and by what kappas.

use holdpoint_governance::decision::Dimension;
use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::metrics::{Fate, Proportion};
use holdpoint_governance::profile::ProfileName;

use super::Section;
use crate::candidate_pool::Class;
use crate::paper_reproduction::figures::{is_faulty, variant_rows};
use crate::paper_reproduction::pool_screening::{DIMENSIONS, ScreenRow, Variant};
use crate::paper_reproduction::published::PublishedNumbers;
use crate::paper_reproduction::report_table::ReportTable;
use crate::pipeline_experiments::ExperimentError;
use crate::pipeline_experiments::drift::Quantiles;
use crate::wording::{counted, number, report as wording, report_tables as tables};

/// E1: which faults are stopped, at which stage, and which benign candidates are lost.
///
/// # Errors
/// If no interval exists for a count.
pub fn screening(rows: &[ScreenRow], printed: &PublishedNumbers) -> Result<Section, ExperimentError> {
    let all: Vec<&ScreenRow> = variant_rows(rows, ProfileName::Sim, Variant::Full).collect();
    if all.is_empty() {
        return Ok(Section::default());
    }
    let t6 = &printed.t6;
    let blocked = |row: &ScreenRow, stage: Stage| row.end.fate == Fate::Blocked { stage };
    let mut table = ReportTable::new(tables::SCREENING);
    let of_dimension = |dimension: Dimension| {
        move |row: &&&ScreenRow| row.class == Class::Faulty && row.dimension == Some(dimension)
    };
    let mut row = |name: &str, candidates: Vec<&&ScreenRow>, paper: String| {
        let count =
            |test: &dyn Fn(&ScreenRow) -> bool| candidates.iter().filter(|row| test(row)).count().to_string();
        let mut cells = vec![name.to_owned(), candidates.len().to_string()];
        for stage in [Stage::Validation, Stage::Sandbox, Stage::Shadow, Stage::Activation] {
            cells.push(count(&|row| blocked(row, stage)));
        }
        cells.push(count(&|row| row.end.fate == Fate::Contained));
        cells.push(count(&|row| row.end.fate == Fate::Kept));
        cells.push(paper);
        table.row(cells);
    };
    for (name, dimension, published) in [
        ("interface", Dimension::Interface, wording::blocked(t6.interface)),
        ("policy", Dimension::Policy, wording::blocked(t6.policy)),
        ("behavior", Dimension::Behavior, wording::blocked(t6.behavior)),
        ("recovery", Dimension::Recovery, wording::NOT_IN_POOL.to_owned()),
    ] {
        row(name, all.iter().filter(of_dimension(dimension)).collect(), published);
    }
    row(
        "marginal",
        all.iter().filter(|row| row.class == Class::Marginal).collect(),
        wording::blocked(t6.marginal),
    );
    let benign = || all.iter().filter(|row| row.class == Class::Benign);
    row("benign", benign().collect(), wording::BENIGN_REJECTED.to_owned());
    let (of_kappas, of_marginal) = (kappas(&all, printed), marginal(&all, printed));
    let mut rates = ReportTable::new(tables::SCREENING_RATES);
    let faulty = || all.iter().filter(|row| is_faulty(row.class));
    // The paper's eight kinds: without overt faults of recovery.
    let paper8 =
        || faulty().filter(|row| !(row.class == Class::Faulty && row.dimension == Some(Dimension::Recovery)));
    let screened = |row: &&&ScreenRow| blocked(row, Stage::Validation);
    let measured = |row: &&&ScreenRow| blocked(row, Stage::Validation) || blocked(row, Stage::Sandbox);
    let before = |row: &&&ScreenRow| matches!(row.end.fate, Fate::Blocked { .. });
    let lifecycle = |row: &&&ScreenRow| row.end.fate != Fate::Kept;
    let overt = Proportion::of(all.iter().filter(|row| row.class == Class::Faulty).map(|row| before(&row)))?;
    let frr = Proportion::of(benign().map(|row| before(&row)))?;
    let found = [
        Proportion::of(paper8().map(|row| screened(&row)))?,
        Proportion::of(paper8().map(|row| measured(&row)))?,
        Proportion::of(faulty().map(|row| before(&row)))?,
        Proportion::of(faulty().map(|row| lifecycle(&row)))?,
        overt,
        frr,
        Proportion::of(benign().map(|row| lifecycle(&row)))?,
    ];
    for ((name, published), rate) in wording::screening_rates(t6).into_iter().zip(found) {
        rates.row([name.to_owned(), counted(&rate), published]);
    }
    Ok(Section {
        title: wording::SCREENING.to_owned(),
        text: vec![wording::candidates(all.len())],
        tables: vec![table, rates, of_kappas, of_marginal],
        lines: vec![wording::screening(&overt, &frr)],
        ..Section::default()
    })
}

/// The kappa of an overt fault in its dimension, at its end.
fn kappas(rows: &[&ScreenRow], printed: &PublishedNumbers) -> ReportTable {
    let mut table = ReportTable::new(tables::KAPPAS);
    let t11 = &printed.t11;
    for (name, dimension, published) in [
        ("interface", Dimension::Interface, wording::from_to(t11.interface)),
        ("policy", Dimension::Policy, wording::from_to(t11.policy)),
        ("behavior", Dimension::Behavior, wording::from_to(t11.behavior)),
        ("recovery", Dimension::Recovery, wording::NO_SUCH_FAULT.to_owned()),
    ] {
        let overt = rows.iter().filter(|row| row.class == Class::Faulty && row.dimension == Some(dimension));
        let values: Vec<f64> = overt.filter_map(|row| kappa_of(row, dimension)).collect();
        table.row([
            name.to_owned(),
            values.len().to_string(),
            number(values.iter().copied().reduce(f64::min), 2),
            number(Quantiles::of(values.iter().copied()).map(|quantiles| quantiles.median), 2),
            number(values.iter().copied().reduce(f64::max), 2),
            published,
        ]);
    }
    table
}

fn kappa_of(row: &ScreenRow, dimension: Dimension) -> Option<f64> {
    let place = DIMENSIONS.iter().position(|known| *known == dimension)?;
    *row.end.kappas.get(place)?
}

/// Whether a fate is one of the ends that are listed.
type IsEnd = fn(Fate) -> bool;

/// The marginal faults, which the paper's screening passes: their distance to the thresholds, by their end.
fn marginal(rows: &[&ScreenRow], printed: &PublishedNumbers) -> ReportTable {
    let mut table = ReportTable::new(tables::MARGINAL);
    let ends: [IsEnd; 5] = [
        |fate| fate == Fate::Blocked { stage: Stage::Validation },
        |fate| fate == Fate::Blocked { stage: Stage::Sandbox },
        |fate| matches!(fate, Fate::Blocked { stage: Stage::Shadow | Stage::Activation }),
        |fate| fate == Fate::Contained,
        |fate| fate == Fate::Kept,
    ];
    let published = wording::marginal(&printed.marginal);
    for ((name, paper_text), dimension) in
        published.into_iter().zip([Dimension::Behavior, Dimension::Recovery])
    {
        for (end, is_there) in wording::MARGINAL_ENDS.into_iter().zip(ends) {
            let here: Vec<&&ScreenRow> = rows
                .iter()
                .filter(|row| row.class == Class::Marginal && row.dimension == Some(dimension))
                .filter(|row| is_there(row.end.fate))
                .collect();
            if here.is_empty() {
                continue;
            }
            let values: Vec<f64> = here.iter().filter_map(|row| kappa_of(row, dimension)).collect();
            let median = |values: &mut dyn Iterator<Item = f64>| {
                Quantiles::of(values).map(|quantiles| quantiles.median)
            };
            table.row([
                name.to_owned(),
                end.to_owned(),
                here.len().to_string(),
                number(values.iter().copied().reduce(f64::min), 3),
                number(median(&mut values.iter().copied()), 3),
                number(values.iter().copied().reduce(f64::max), 3),
                number(median(&mut here.iter().filter_map(|row| row.end.composite)), 3),
                paper_text.clone(),
            ]);
        }
    }
    table
}
