//! E1: which faults are stopped at which stage, which benign candidates are lost, and by what kappas.

use holdpoint_governance::decision::Dimension;
use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::metrics::{Fate, Proportion};
use holdpoint_governance::profile::ProfileName;

use super::{Section, counted};
use crate::candidate_pool::Class;
use crate::paper_reproduction::figures::{is_faulty, variant_rows};
use crate::paper_reproduction::pool_screening::{DIMENSIONS, ScreenRow, Variant};
use crate::paper_reproduction::published::PublishedNumbers;
use crate::paper_reproduction::report_table::ReportTable;
use crate::pipeline_experiments::ExperimentError;
use crate::pipeline_experiments::drift::Quantiles;

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
    let mut table = ReportTable::new(
        "Screening by class of fault (profile sim)",
        &[
            "class",
            "candidates",
            "stopped by validation",
            "by the sandbox",
            "by shadow",
            "by the gate",
            "rolled back",
            "kept",
            "paper (table 6)",
        ],
        "The paper's 75 % is its validation alone, with an estimated kappa_B; here behavior is measured in the sandbox. \
         Its eight faulty kinds have no overt fault of recovery; ours have two a family besides (readings X19).",
    );
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
    let blocked_text = |counts: [u32; 2]| format!("{} of {} blocked", counts[0], counts[1]);
    for (name, dimension, published) in [
        ("interface", Dimension::Interface, blocked_text(t6.interface)),
        ("policy", Dimension::Policy, blocked_text(t6.policy)),
        ("behavior", Dimension::Behavior, blocked_text(t6.behavior)),
        ("recovery", Dimension::Recovery, "not in the paper's pool".to_owned()),
    ] {
        row(name, all.iter().filter(of_dimension(dimension)).collect(), published);
    }
    row(
        "marginal",
        all.iter().filter(|row| row.class == Class::Marginal).collect(),
        blocked_text(t6.marginal),
    );
    row(
        "benign",
        all.iter().filter(|row| row.class == Class::Benign).collect(),
        "0 of 18 rejected".to_owned(),
    );
    let (of_kappas, of_marginal) = (kappas(&all, printed), marginal(&all, printed));
    let mut rates = ReportTable::new("Rates", &["rate", "here", "paper"], "95 % Wilson intervals.");
    let faulty = || all.iter().filter(|row| is_faulty(row.class));
    // The paper's eight kinds: without overt faults of recovery.
    let paper8 =
        || faulty().filter(|row| !(row.class == Class::Faulty && row.dimension == Some(Dimension::Recovery)));
    let screened = |row: &&&ScreenRow| blocked(row, Stage::Validation);
    let measured = |row: &&&ScreenRow| blocked(row, Stage::Validation) || blocked(row, Stage::Sandbox);
    let before = |row: &&&ScreenRow| matches!(row.end.fate, Fate::Blocked { .. });
    let lifecycle = |row: &&&ScreenRow| row.end.fate != Fate::Kept;
    let badr = format!("{:.1} %", t6.badr);
    let downstream = "\"caught downstream\"".to_owned();
    let overt = Proportion::of(all.iter().filter(|row| row.class == Class::Faulty).map(|row| before(&row)))?;
    let frr = Proportion::of(all.iter().filter(|row| row.class == Class::Benign).map(|row| before(&row)))?;
    let lost =
        Proportion::of(all.iter().filter(|row| row.class == Class::Benign).map(|row| lifecycle(&row)))?;
    for (name, rate, published) in [
        (
            "badr_screen, the paper's eight kinds",
            Proportion::of(paper8().map(|row| screened(&row)))?,
            badr.clone(),
        ),
        (
            "validation and sandbox, the paper's eight",
            Proportion::of(paper8().map(|row| measured(&row)))?,
            badr,
        ),
        (
            "badr_preactivation, all kinds",
            Proportion::of(faulty().map(|row| before(&row)))?,
            downstream.clone(),
        ),
        ("badr_lifecycle, all kinds", Proportion::of(faulty().map(|row| lifecycle(&row)))?, downstream),
        ("overt faults stopped before activation", overt, "18 of 18".to_owned()),
        ("false_reject_rate", frr, format!("{:.1} %", t6.false_reject_rate)),
        ("benign not active in the end", lost, "not told".to_owned()),
    ] {
        rates.row([name.to_owned(), counted(&rate), published]);
    }
    let lines = vec![format!(
        "E1: overt faults stopped before activation {}; benign rejected {} (paper: 0 at screening, 54 % in its own \
         full pipeline)",
        counted(&overt),
        counted(&frr)
    )];
    Ok(Section {
        title: "E1: screening".to_owned(),
        text: vec![format!("{} candidates, each against the first version of its family.", all.len())],
        tables: vec![table, rates, of_kappas, of_marginal],
        plots: Vec::new(),
        lines,
    })
}

/// The kappa of an overt fault in its dimension, at its end.
fn kappas(rows: &[&ScreenRow], printed: &PublishedNumbers) -> ReportTable {
    let mut table = ReportTable::new(
        "Kappa of overt faults, in the dimension that they are in (profile sim)",
        &["class", "candidates with one", "lowest", "median", "highest", "paper (table 11)"],
        "A candidate that an earlier stage stopped has none of a later one's.",
    );
    let t11 = &printed.t11;
    let range_text = |range: &[f64; 2]| {
        let [low, high] = range;
        if low < high { format!("{low:.2} to {high:.2}") } else { format!("{low:.2}") }
    };
    for (name, dimension, published) in [
        ("interface", Dimension::Interface, range_text(&t11.interface)),
        ("policy", Dimension::Policy, range_text(&t11.policy)),
        ("behavior", Dimension::Behavior, range_text(&t11.behavior)),
        ("recovery", Dimension::Recovery, "no such fault".to_owned()),
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

fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"))
}

/// The end of a candidate, in words, and whether a fate is that.
type FateLabel = (&'static str, fn(Fate) -> bool);

/// The marginal faults, which the paper's screening passes: their distance to the thresholds, by their end.
fn marginal(rows: &[&ScreenRow], printed: &PublishedNumbers) -> ReportTable {
    let mut table = ReportTable::new(
        "Marginal faults, by where they end (profile sim)",
        &[
            "fault",
            "ends",
            "candidates",
            "kappa of its dimension: lowest",
            "median",
            "highest",
            "composite, median",
            "paper (section 8.3)",
        ],
        "The paper has one of each, with a composite of .961 and .963, and lets shadow or the monitor find both. A candidate has \
         no kappa of what it did not come to.",
    );
    let published = &printed.marginal;
    let [before, after] = published.recovery;
    for (name, dimension, paper_text) in [
        (
            "behavior",
            Dimension::Behavior,
            format!("anomalies {:+.2}, found by shadow or monitor", published.anomaly_rise),
        ),
        (
            "recovery",
            Dimension::Recovery,
            format!("rho {before:.2} to {after:.2}, found by shadow or monitor"),
        ),
    ] {
        let ends: [FateLabel; 5] = [
            ("stopped by validation", |fate| fate == Fate::Blocked { stage: Stage::Validation }),
            ("stopped by the sandbox", |fate| fate == Fate::Blocked { stage: Stage::Sandbox }),
            ("stopped by shadow or gate", |fate| {
                matches!(fate, Fate::Blocked { stage: Stage::Shadow | Stage::Activation })
            }),
            ("rolled back", |fate| fate == Fate::Contained),
            ("kept", |fate| fate == Fate::Kept),
        ];
        for (end, is_there) in ends {
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
