//! The report: one page of Markdown with its plots beside it, the same as one HTML page that needs nothing else, the raw
//! rows and every test as CSV.

use std::collections::BTreeSet;
use std::path::Path;

use holdpoint_plot::escaped;

use super::figures::{ArmComparison, last_round};
use super::pool_screening::{ScreenRow, Variant};
use super::published::PublishedNumbers;
use super::raw_rows::{RawRows, ReportProvenance};
use super::sections::{self, Section, seeds_in};
use crate::pipeline_experiments::{ExperimentError, write_atomically};
use crate::wording::report as wording;

/// How the page looks, and how its tables are sorted by a click.
const STYLE: &str = "body{font:15px/1.5 sans-serif;max-width:70rem;margin:2rem auto;padding:0 1rem;color:#111}\
table{border-collapse:collapse;font-size:13px;display:block;overflow-x:auto}th,td{border:1px solid #bbb;padding:3px 8px;\
text-align:left;vertical-align:top}th{background:#eee;cursor:pointer}.note{color:#444;font-size:13px}\
svg{display:block;max-width:46rem;width:100%;height:auto;border:1px solid #ddd;margin:.5rem 0}";
const SCRIPT: &str = "document.querySelectorAll('th').forEach(function(th){th.addEventListener('click',function(){\
var table=th.closest('table'),body=table.tBodies[0],at=Array.prototype.indexOf.call(th.parentNode.children,th),\
up=th.dataset.up!=='1';th.dataset.up=up?'1':'0';var value=function(row){var text=row.cells[at].textContent,\
n=parseFloat(text);return isNaN(n)?text:n};Array.prototype.slice.call(body.rows).sort(function(a,b){var x=value(a),\
y=value(b);return (x<y?-1:x>y?1:0)*(up?1:-1)}).forEach(function(row){body.appendChild(row)})})});\
document.documentElement.dataset.ready='1';";

/// Writes the report of a folder's raw rows: `report.md`, `report.html`, plots, `tests.csv`. Returns the
/// lines of the first page.
///
/// # Errors
/// If the rows cannot be read, a number cannot be computed, or a file cannot be written.
pub fn write(folder: &Path) -> Result<Vec<String>, ExperimentError> {
    let (about, rows) = RawRows::read(folder)?;
    let RawRows { rounds, pools, layers, drift } = &rows;
    let printed = PublishedNumbers::builtin()?;
    let ablated = of_ablated_seeds(pools);
    let of = about.preset.size().seeds;
    let [of_pools, of_ablated] = [pools, &ablated].map(|rows| seeds_in(rows, |row| row.seed));
    let of_rounds = seeds_in(rounds, |row| row.seed);
    let mut all = vec![
        sections::screening(pools, &printed)?.with_seeds(of_pools, of),
        sections::deployment(rounds, &printed)?.with_seeds(of_rounds, of),
        sections::shadow(&ablated, &printed)?.with_seeds(of_ablated, of),
    ];
    if let Some(drift) = drift {
        let runs = usize::try_from(drift.runs).unwrap_or(usize::MAX);
        all.push(sections::rollback(drift, &printed)?.with_seeds(runs, of));
    }
    all.push(sections::profiles(pools, &printed)?.with_seeds(of_pools, of));
    all.push(sections::sensitivity(rounds, &ablated, &printed, of)?.with_seeds(of_ablated, of));
    all.push(sections::ablation(rounds, &ablated, &printed, of)?.with_seeds(of_ablated, of));
    all.push(sections::meta_faults(&ablated, layers, of)?.with_seeds(of_ablated, of));
    all.push(sections::findings(rounds, pools)?);
    all.push(sections::positioning());
    all.retain(|section| !section.title.is_empty());
    let put = |name: &str, text: &str| write_atomically(&folder.join(name), text.as_bytes());
    if sections::compares_arms(rounds) {
        put("tests.csv", &tests(&sections::deployment_tests(rounds)?))?;
    }
    for (name, svg) in all.iter().flat_map(|section| &section.plots) {
        put(&format!("{name}.svg"), svg)?;
    }
    let first = first_page(&about, &rows, &all);
    put("report.md", &markdown(&first, &all))?;
    put("report.html", &html(&first, &all))?;
    let mut lines: Vec<String> = all.iter().flat_map(|section| section.lines.clone()).collect();
    lines.push(wording::written_to(folder));
    Ok(lines)
}

/// The rows of the seeds whose pools also ran with parts left out: a variant is compared over the same candidates.
fn of_ablated_seeds(pools: &[ScreenRow]) -> Vec<ScreenRow> {
    let left_out = pools.iter().filter(|row| row.variant != Variant::Full);
    let seeds: BTreeSet<u64> = left_out.map(|row| row.seed).collect();
    pools.iter().filter(|row| seeds.contains(&row.seed)).cloned().collect()
}

/// Writes one section as a page of its own. Gives back its lines.
///
/// # Errors
/// If the file cannot be written.
pub fn write_section_page(out: &Path, name: &str, section: Section) -> Result<Vec<String>, ExperimentError> {
    std::fs::create_dir_all(out).map_err(ExperimentError::file(out))?;
    let path = out.join(name);
    write_atomically(&path, body(&section).as_bytes())?;
    let mut lines = section.lines;
    lines.push(wording::written(&path));
    Ok(lines)
}

/// The question, the subjects, and the results.
fn first_page(about: &ReportProvenance, rows: &RawRows, all: &[Section]) -> Vec<String> {
    let of = about.preset.size().seeds;
    let RawRows { rounds, pools, layers, drift } = rows;
    let mut parts = Vec::new();
    if let Some(row) = rounds.first() {
        let arms: BTreeSet<&str> = rounds.iter().map(|row| row.arm.name()).collect();
        let held_out = (last_round(rounds), row.score.sequences);
        let seeds = preset_seeds(of, rounds, |row| row.seed);
        parts.push(wording::rounds(&seeds, arms.len(), held_out, rounds.len()));
    }
    if !pools.is_empty() {
        let left_out: Vec<&ScreenRow> = pools.iter().filter(|row| row.variant != Variant::Full).collect();
        let left_out = seeds_in(&left_out, |row| row.seed);
        parts.push(wording::pools(&preset_seeds(of, pools, |row| row.seed), left_out, pools.len()));
    }
    parts.extend(drift.as_ref().map(|drift| wording::drifts(drift.runs, drift.seed)));
    if !layers.is_empty() {
        parts.push(wording::layers(layers.len()));
    }
    let mut lines = vec![wording::asked(about.preset, &parts)];
    lines.extend(all.iter().flat_map(|section| section.lines.clone()));
    let [computed_by, decided_by] =
        [&about.computed_by, &about.decided_by].map(|digest| digest.get(..16).unwrap_or(digest));
    lines.push(wording::provenance(&about.version, computed_by, decided_by));
    lines
}

/// The rows' seeds of those of the preset: their number, and the lowest and the highest.
fn preset_seeds<T>(of: u64, rows: &[T], seed: fn(&T) -> u64) -> String {
    let seeds: BTreeSet<u64> = rows.iter().map(seed).collect();
    wording::seeds(seeds.len(), of, seeds.first().copied().zip(seeds.last().copied()))
}

/// A section in Markdown.
fn body(section: &Section) -> String {
    let mut text = format!("\n## {}\n\n", section.title);
    for paragraph in &section.text {
        text.push_str(&format!("{paragraph}\n\n"));
    }
    for table in &section.tables {
        text.push_str(&table.markdown());
    }
    for (name, _) in &section.plots {
        text.push_str(&format!("![{name}]({name}.svg)\n\n"));
    }
    text
}

fn markdown(first: &[String], all: &[Section]) -> String {
    let mut text = format!("# {}\n\n", wording::TITLE);
    for line in first {
        text.push_str(&format!("- {line}\n"));
    }
    for section in all {
        text.push_str(&body(section));
    }
    text.push_str(&format!("\n## {}\n\n", wording::LIMITS));
    for [name, limit] in wording::VALIDITY {
        text.push_str(&format!("- **{name}.** {limit}\n"));
    }
    text
}

fn html(first: &[String], all: &[Section]) -> String {
    let mut text = format!(
        "<!doctype html>\n<html lang=\"en\">\n<head><meta charset=\"utf-8\">\n<title>{0}</title>\n<style>{STYLE}</style>\
         </head>\n<body>\n<h1>{0}</h1>\n<ul>\n",
        wording::TITLE
    );
    for line in first {
        text.push_str(&format!("<li>{}</li>\n", escaped(line)));
    }
    text.push_str("</ul>\n");
    for section in all {
        text.push_str(&format!("<h2>{}</h2>\n", escaped(&section.title)));
        for paragraph in &section.text {
            text.push_str(&format!("<p>{}</p>\n", escaped(paragraph)));
        }
        for table in &section.tables {
            text.push_str(&table.html());
        }
        for (_, svg) in &section.plots {
            text.push_str(svg);
        }
    }
    text.push_str(&format!("<h2>{}</h2>\n<ul>\n", wording::LIMITS));
    for [name, limit] in wording::VALIDITY {
        text.push_str(&format!("<li><b>{name}.</b> {}</li>\n", escaped(limit)));
    }
    text.push_str(&format!("</ul>\n<script>{SCRIPT}</script>\n</body>\n</html>\n"));
    text
}

/// Every test with the differences it is computed from, so that it can be computed again elsewhere.
fn tests(tests: &[ArmComparison]) -> String {
    let mut text = "comparison,n,zeros,w,p,p_holm,mean,lower,upper,differences\n".to_owned();
    for one in tests {
        let number = |value: Option<f64>| value.map_or_else(String::new, |value| format!("{value:.12}"));
        let (n, zeros) = one.test.as_ref().map_or((0, one.differences.len()), |test| (test.n, test.zeros));
        let differences: Vec<String> = one.differences.iter().map(|value| format!("{value:.12}")).collect();
        let cells = [
            wording::comparison(one),
            n.to_string(),
            zeros.to_string(),
            number(one.test.as_ref().map(|test| test.w)),
            number(one.test.as_ref().map(|test| test.p_two_sided)),
            number(Some(one.p_holm)),
            number(Some(one.mean)),
            number(one.interval.map(|ends| ends.lower)),
            number(one.interval.map(|ends| ends.upper)),
            differences.join(";"),
        ];
        text.push_str(&cells.join(","));
        text.push('\n');
    }
    text
}
