//! `holdpoint health`: whether the live cell is better or worse than before, from the store alone.
//!
//! Prints the result of [`holdpoint_explain::health_series`]; an engine may have the store open meanwhile. Judges
//! nothing, and prints no rate without a count.

use std::fs::OpenOptions;
use std::io::Write as _;
use std::os::unix::fs::OpenOptionsExt as _;
use std::path::{Path, PathBuf};

use clap::Args;
use serde::Serialize;

use super::data;
use super::metrics::span_ms;
use super::output::TextTable;
use super::time_arg::{TimeArg, when_help};
use crate::cli::context::CliContext;
use crate::cli::output::CommandOutput;
use crate::error::{CliError, Exit};
use holdpoint_explain::health_series::{HealthError, HealthReader, PresentTime, csv, svg};
use holdpoint_governance::ids::Family;
use holdpoint_protocol::clock::clock_time;
use holdpoint_protocol::health::{
    BUCKET_MS_MAX, BUCKET_MS_MIN, BUCKET_WIDTHS_MS, BUCKETS_MAX, HealthClock, HealthQuery, HealthSeries,
    HealthVerdict, together,
};
use holdpoint_registry::SqliteReader;
use holdpoint_store::{Layout, ReadableStore};
use holdpoint_wording::health::{confounding_versions, health_verdict, mark_kind, omissions};
use holdpoint_wording::program::health as sentences;

/// The default span, ms: a day.
const SPAN_MS: i64 = 86_400_000;

/// The number of buckets on each side of the moment without --bucket, approximately.
const BUCKETS_AIM: i64 = 24;

/// The most marks that are printed; files and JSON have all.
const MARKS_PRINTED: usize = 30;

/// Eighths of a line's height.
const LEVELS: [char; 8] = ['▁', '▂', '▃', '▄', '▅', '▆', '▇', '█'];

/// The arguments of `health`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = concat!(
    "The verdict compares the time since WHEN with an equal time before it.\n\n",
    when_help!(),
    "
Examples:
  holdpoint health
  holdpoint health --since tuesday --family grasp
  holdpoint health --since 2026-11-17T08:00 --bucket 1h --csv week.csv --svg week.svg"
))]
pub struct HealthArgs {
    /// Only this family.
    #[arg(long, value_name = "NAME")]
    pub family: Option<String>,
    /// The moment that separates before and since [default: 24h, or the middle of a shorter history].
    #[arg(long, value_name = "WHEN")]
    pub since: Option<TimeArg>,
    /// The end of the span [default: the end of the history].
    #[arg(long, value_name = "WHEN")]
    pub until: Option<TimeArg>,
    /// Width of a bucket, a minute to a day: 5m, 1h, 1d [default: about 24 buckets on each side].
    #[arg(long, value_name = "SPAN")]
    pub bucket: Option<String>,
    /// Reads every task of a long span, instead of a sample.
    #[arg(long)]
    pub every_task: bool,
    /// Writes the series into a new file as CSV.
    #[arg(long, value_name = "FILE")]
    pub csv: Option<PathBuf>,
    /// Writes a chart of one family into a new file as SVG; with several families, each file name gets the family's
    /// name.
    #[arg(long, value_name = "FILE")]
    pub svg: Option<PathBuf>,
}

/// The JSON document.
#[derive(Serialize)]
struct HealthAnswer<'a> {
    #[serde(flatten)]
    series: &'a HealthSeries,
    /// One for each family.
    verdicts: &'a [HealthVerdict],
    /// The verdicts in words.
    sentences: Vec<String>,
}

/// Reads and prints.
///
/// # Errors
/// If there is no store, it cannot be read, or the options contradict each other.
pub fn run(context: &CliContext, args: &HealthArgs, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    let views = data::open_checked(&context.data)?;
    let store = SqliteReader::new(Layout::new(&context.data));
    let reader = HealthReader::new(Box::new(views), store.telemetry().map_err(CliError::usage)?);
    let end = reader.end().map_err(CliError::usage)?;
    let (query, at_ms) = health_query(args, end)?;
    let read = if args.every_task {
        reader.read_every_task(&query, Some(end))
    } else {
        reader.read(&query, Some(end))
    };
    let mut series = read.map_err(|error| match error {
        HealthError::Store(error) => CliError::usage(error),
        HealthError::InvalidQuery(text) => CliError::usage(text),
    })?;
    let families = chosen(&mut series, args)?;
    let split = series.bucket_of(at_ms).unwrap_or(series.buckets / 2);
    let verdicts: Vec<HealthVerdict> = families.iter().map(|family| series.verdict(family, split)).collect();
    let mut written = Vec::new();
    if let Some(path) = &args.csv {
        write_new(path, &csv(&series))?;
        written.push(path.clone());
    }
    if let Some(path) = &args.svg {
        for (family, verdict) in families.iter().zip(&verdicts) {
            let path = if families.len() == 1 { path.clone() } else { named(path, family) };
            let mut notes = vec![health_verdict(verdict)];
            notes.extend(confounding_versions(verdict));
            notes.extend(omissions(&series.coverage));
            write_new(&path, &svg(&series, family, &notes))?;
            written.push(path);
        }
    }
    let sentences = verdicts.iter().map(health_verdict).collect();
    let answer = HealthAnswer { series: &series, verdicts: &verdicts, sentences };
    out.answer(&answer, |out| show(&series, &families, &verdicts, split, out))?;
    if !out.is_json() {
        for path in written {
            out.line(&format!("written: {}", path.display()))?;
        }
    }
    Ok(Exit::Confirmed)
}

/// The query, and the moment of the verdict on its clock, ms.
fn health_query(args: &HealthArgs, end: PresentTime) -> Result<(HealthQuery, i64), CliError> {
    let requested = [&args.since, &args.until].into_iter().flatten().find_map(TimeArg::clock);
    let default = if end.wall_ms.is_some() { HealthClock::Wall } else { HealthClock::Virtual };
    let clock = requested.unwrap_or(default);
    let place = |time: &TimeArg| time.on(clock, end).map_err(CliError::usage);
    let until_ms = place(args.until.as_ref().unwrap_or(&TimeArg::Back(0)))?;
    // A history shorter than the default span is divided in the middle.
    let shorter = if clock == HealthClock::Virtual { until_ms / 2 } else { SPAN_MS };
    let at_ms = match &args.since {
        Some(since) => place(since)?,
        None => until_ms.saturating_sub(SPAN_MS.min(shorter.max(60_000))),
    };
    let length_ms = until_ms.saturating_sub(at_ms);
    if length_ms <= 0 {
        let text = "the span from --since to --until is empty";
        return Err(
            CliError::usage(text).with_hint("--since comes before --until, and before the end of the record")
        );
    }
    let bucket_ms = match &args.bucket {
        Some(text) => {
            let ms = span_ms(text).filter(|ms| (BUCKET_MS_MIN..=BUCKET_MS_MAX).contains(ms));
            ms.ok_or_else(|| {
                CliError::usage(format!(
                    "{text:?} is not a width of a bucket; allowed: 1m to 1d, such as 5m, 1h"
                ))
            })?
        }
        None => {
            let aim = u64::try_from(length_ms / BUCKETS_AIM).unwrap_or(BUCKET_MS_MIN);
            BUCKET_WIDTHS_MS.into_iter().find(|width| *width >= aim).unwrap_or(BUCKET_MS_MAX)
        }
    };
    // A bucket edge lies at the moment, so no task counts on both sides.
    let width = i64::try_from(bucket_ms).unwrap_or(i64::MAX);
    let each = length_ms.div_euclid(width) + i64::from(length_ms.rem_euclid(width) > 0);
    let buckets = u16::try_from(each.saturating_mul(2)).ok().filter(|buckets| *buckets <= BUCKETS_MAX);
    let buckets = buckets.ok_or_else(|| {
        CliError::usage(format!("the span has more than {BUCKETS_MAX} buckets"))
            .with_hint("name a wider --bucket, or a later --since")
    })?;
    let until_ms = at_ms.saturating_add(each.saturating_mul(width));
    Ok((
        HealthQuery { clock: Some(clock), until_ms: Some(until_ms), only_alarms: false, bucket_ms, buckets },
        at_ms,
    ))
}

/// The families to report; the series drops the others.
fn chosen(series: &mut HealthSeries, args: &HealthArgs) -> Result<Vec<Family>, CliError> {
    let all = series.families();
    let Some(name) = &args.family else { return Ok(all) };
    let family = Family::new(name.as_str()).map_err(|error| CliError::usage(error.to_string()))?;
    series.points.retain(|point| point.version.family == family);
    series.marks.retain(|mark| mark.family.as_ref().is_none_or(|of| *of == family));
    Ok(vec![family])
}

/// `week.svg` of a family as `week-grasp.svg`.
fn named(path: &Path, family: &Family) -> PathBuf {
    let stem = path.file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into_owned());
    let ending =
        path.extension().map_or_else(|| "svg".to_owned(), |ending| ending.to_string_lossy().into_owned());
    path.with_file_name(format!("{stem}-{family}.{ending}"))
}

/// Creates the file; never overwrites one.
fn write_new(path: &Path, text: &str) -> Result<(), CliError> {
    let file = OpenOptions::new().write(true).create_new(true).mode(0o600).open(path);
    file.and_then(|mut file| file.write_all(text.as_bytes())).map_err(|error| {
        CliError::usage(format!("cannot write {path:?}: {error}"))
            .with_hint("name a new file")
            .with_unwritable(path, &error)
    })
}

fn show(
    series: &HealthSeries,
    families: &[Family],
    verdicts: &[HealthVerdict],
    split: u32,
    out: &mut CommandOutput<'_>,
) -> Result<(), CliError> {
    out.paragraph(
        "",
        &sentences::span(
            &series.time_text(series.from_ms),
            &series.time_text(series.until_ms()),
            series.clock,
            series.bucket_ms / 60_000,
            &session_ends(series),
        ),
    )?;
    if families.is_empty() {
        out.paragraph("", sentences::NO_TASKS)?;
    }
    let mut table = TextTable::new(&[
        "family", "version", "tasks", "success", "95 %", "violated", "near", "time s", "p95", "force N",
        "p95",
    ]);
    for family in families {
        for row in by_version(series, family) {
            table.row(row);
        }
    }
    if !table.is_empty() {
        out.table(&table)?;
    }
    for (family, verdict) in families.iter().zip(verdicts) {
        out.line("")?;
        chart(series, family, split, out)?;
        out.paragraph("", &health_verdict(verdict))?;
        if let Some(text) = confounding_versions(verdict) {
            out.paragraph("  ", &text)?;
        }
    }
    marks(series, out)?;
    for text in omissions(&series.coverage) {
        out.paragraph("", &text)?;
    }
    Ok(())
}

fn session_ends(series: &HealthSeries) -> String {
    let engine = clock_time(series.last_at_ms);
    match (series.clock, series.last_wall_ms) {
        (HealthClock::Wall, Some(wall_ms)) => {
            format!("{} (engine {engine})", series.time_text(wall_ms - wall_ms.rem_euclid(1_000)))
        }
        _ => engine,
    }
}

/// One row for each version over the whole span. Medians of buckets cannot be combined, so their range is shown.
fn by_version(series: &HealthSeries, family: &Family) -> Vec<Vec<String>> {
    let mut versions: Vec<_> = series
        .points
        .iter()
        .filter(|point| point.version.family == *family)
        .map(|point| &point.version)
        .collect();
    versions.sort();
    versions.dedup();
    let of = |version| series.points.iter().filter(move |point| &point.version == version);
    let extent = |values: Vec<f64>| {
        let low = values.iter().copied().fold(f64::INFINITY, f64::min);
        let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let (low, high) = (format!("{low:.1}"), format!("{high:.1}"));
        if low == high { low } else { format!("{low} to {high}") }
    };
    versions
        .into_iter()
        .filter_map(|version| {
            let (tasks, done, [low, high]) = together(of(version))?;
            let count = |what: fn(&holdpoint_protocol::health::HealthPoint) -> u64| {
                of(version).map(what).sum::<u64>()
            };
            Some(vec![
                family.to_string(),
                version.to_string(),
                tasks.to_string(),
                format!("{:.1} %", 100.0 * done as f64 / tasks as f64),
                format!("{:.1} to {:.1}", 100.0 * low, 100.0 * high),
                count(|point| point.violated).to_string(),
                count(|point| point.near).to_string(),
                extent(of(version).map(|point| point.time_s[0]).collect()),
                extent(of(version).map(|point| point.time_s[1]).collect()),
                extent(of(version).map(|point| point.force_n[0]).collect()),
                extent(of(version).map(|point| point.force_n[1]).collect()),
            ])
        })
        .collect()
}

/// Success as a line of blocks, with the moment and the marks below it. A blank is a bucket without a task.
fn chart(
    series: &HealthSeries,
    family: &Family,
    split: u32,
    out: &mut CommandOutput<'_>,
) -> Result<(), CliError> {
    let shares: Vec<Option<f64>> = (0..series.buckets)
        .map(|bucket| together(series.at(family, bucket)).map(|(tasks, done, _)| done as f64 / tasks as f64))
        .collect();
    let low = shares.iter().flatten().copied().fold(0.9, f64::min);
    let low = (low * 10.0).floor() / 10.0;
    let level = |share: f64| {
        #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "between 0 and 7")]
        let at = ((share - low) / (1.0 - low).max(1e-9) * 7.0).round().clamp(0.0, 7.0) as usize;
        LEVELS.get(at).copied().unwrap_or(' ')
    };
    let line: String = shares.iter().map(|share| share.map_or(' ', level)).collect();
    let mut below: Vec<char> = vec![' '; shares.len()];
    if let Some(place) = usize::try_from(split).ok().and_then(|at| below.get_mut(at)) {
        *place = '^';
    }
    let mut weight = vec![u8::MAX; below.len()];
    for mark in series.marks.iter().filter(|mark| mark.family.as_ref().is_none_or(|of| of == family)) {
        let Some(at) = series.bucket_of(mark.on_clock_ms).and_then(|at| usize::try_from(at).ok()) else {
            continue;
        };
        if let (Some(place), Some(known)) = (below.get_mut(at), weight.get_mut(at))
            && mark.kind.weight() < *known
        {
            (*place, *known) = (mark.kind.letter(), mark.kind.weight());
        }
    }
    // A line of blocks has a limited width; the rest follows below.
    let (line, below): (Vec<char>, Vec<char>) = (line.chars().collect(), below);
    out.line(&sentences::chart_heading(family, 100.0 * low))?;
    for (blocks, signs) in line.chunks(96).zip(below.chunks(96)) {
        let text = |signs: &[char]| signs.iter().collect::<String>();
        out.line(&format!("|{}|", text(blocks)))?;
        out.line(format!(" {}", text(signs)).trim_end())?;
    }
    Ok(())
}

fn marks(series: &HealthSeries, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    if series.marks.is_empty() {
        return Ok(());
    }
    out.line("")?;
    let left = series.marks.len().saturating_sub(MARKS_PRINTED);
    if left > 0 {
        out.line(&sentences::earlier_marks(left))?;
    }
    for mark in series.marks.iter().skip(left) {
        let when = match series.clock {
            HealthClock::Wall => series.time_text(mark.on_clock_ms - mark.on_clock_ms.rem_euclid(1_000)),
            HealthClock::Virtual => series.time_text(mark.on_clock_ms),
        };
        let (letter, what) = (mark.kind.letter(), mark_kind(mark.kind));
        out.paragraph("", &format!("{letter} {when}  {what}: {}", mark.text))?;
    }
    Ok(())
}
