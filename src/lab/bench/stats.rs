//! A simulation study: are the rules' error rates those that the profiles state?
//!
//! Owns the study and its report. Every figure goes through the rules' own functions, on outcomes sampled from recorded
//! pairs of real episodes ([`tables`]) or from Bernoulli draws with an exact rate. The same seed and number of runs
//! give the same report. Must not tune anything: a person writes its numbers into the profiles, as the reason.

mod behavior;
mod drift;
mod early;
mod figure;
mod pass_rules;
mod power;
mod sampling;
mod shadow;
pub mod tables;

use serde::Serialize;

pub use figure::{StatedBound, StudyFigure, StudyMeasure};

use holdpoint::bench::BenchError;
use holdpoint_governance::profile::{Profile, ProfileName};

/// Runs of each figure by default.
pub const RUNS: u32 = 10_000;

/// Fewest runs: with fewer, no stated rate can be refuted.
pub const RUNS_MIN: u32 = 100;

/// Most runs of each figure.
pub const RUNS_MAX: u32 = 1_000_000;

/// The results of the study.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StudyReport {
    /// Version of the program.
    pub version: &'static str,
    /// Runs of each figure.
    pub runs: u32,
    /// Names of the recorded tables.
    pub tables: Vec<String>,
    pub findings: Vec<StudyFigure>,
}

impl StudyReport {
    /// Whether every stated rate is borne out.
    #[must_use]
    pub fn holds(&self) -> bool {
        self.findings.iter().all(|finding| finding.holds)
    }
}

/// The recorded tables by where their episodes were run.
pub(super) struct TablesByOrigin {
    sandbox: Vec<tables::RecordedTable>,
    live: Vec<tables::RecordedTable>,
    /// In the sandbox, with every measure of harm.
    harm: Vec<tables::RecordedTable>,
}

impl TablesByOrigin {
    fn read() -> Result<Self, tables::TableError> {
        let sandbox = [
            ("align-improved", include_str!("data/align-improved-sandbox.txt")),
            ("align-robust", include_str!("data/align-robust-sandbox.txt")),
            ("place-robust", include_str!("data/place-robust-sandbox.txt")),
        ];
        let live = [
            ("align-improved", include_str!("data/align-improved-live.txt")),
            ("align-robust", include_str!("data/align-robust-live.txt")),
            ("place-robust", include_str!("data/place-robust-live.txt")),
        ];
        let harm = [
            ("grasp-improved", include_str!("data/grasp-improved-harm.txt")),
            ("align-robust", include_str!("data/align-robust-harm.txt")),
            ("place-robust", include_str!("data/place-robust-harm.txt")),
        ];
        let read = |list: [(&'static str, &str); 3]| {
            list.into_iter().map(|(name, text)| tables::read(name, text)).collect::<Result<Vec<_>, _>>()
        };
        Ok(Self { sandbox: read(sandbox)?, live: read(live)?, harm: read(harm)? })
    }
}

/// The inputs of a part of the study.
pub(super) struct Study {
    runs: u32,
    recorded: TablesByOrigin,
    profiles: Vec<Profile>,
}

/// Runs the study with `runs` runs of each figure, [`RUNS_MIN`] to [`RUNS_MAX`].
///
/// # Errors
/// [`BenchError`] if an embedded text does not parse or a rule refuses its input.
pub fn run(runs: u32) -> Result<StudyReport, BenchError> {
    if !(RUNS_MIN..=RUNS_MAX).contains(&runs) {
        return Err(BenchError::Unexpected {
            what: "runs",
            found: runs.to_string(),
            expected: "100 to 1000000 runs",
        });
    }
    let profiles = ProfileName::ALL.into_iter().map(Profile::builtin).collect::<Result<Vec<_>, _>>()?;
    let study = Study { runs, recorded: TablesByOrigin::read().map_err(unreadable)?, profiles };
    let mut findings = pass_rules::study(&study)?;
    findings.extend(early::study(&study)?);
    findings.extend(behavior::study(&study)?);
    findings.extend(power::study(&study)?);
    findings.extend(shadow::study(&study)?);
    findings.extend(drift::study(&study)?);
    let recorded = &study.recorded;
    let tables = recorded.sandbox.iter().chain(&recorded.live).chain(&recorded.harm);
    Ok(StudyReport {
        version: env!("CARGO_PKG_VERSION"),
        runs,
        tables: tables.map(|table| table.provenance.clone()).collect(),
        findings,
    })
}

fn unreadable(error: tables::TableError) -> BenchError {
    BenchError::Unexpected { what: "a recorded table", found: error.to_string(), expected: "a list of pairs" }
}

fn missing(what: &'static str) -> BenchError {
    BenchError::Unexpected { what, found: "nothing".to_owned(), expected: "a value" }
}
