//! The raw rows of a report as they are read back, and their provenance.
//!
//! A report is written from these files and from nothing else, so that any reader can write a published one again from
//! its rows and compare. Must not compute a figure.

use std::fmt::Display;
use std::path::Path;
use std::str::FromStr;

use holdpoint_engine::build_digest::decided_by;
use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::metrics::Fate;
use holdpoint_governance::text_error::parse_toml;
use holdpoint_text::file::read_text;
use holdpoint_trials::cell::computed_by;
use serde::de::value::{Error as WordError, StrDeserializer};
use serde::de::{DeserializeOwned, IntoDeserializer};
use serde::{Deserialize, Serialize};

use super::arm::ArmAction;
use super::csv::{self, fields};
use super::pool_screening::ScreenEnd;
use super::rounds::{HeldOutScore, OfferedCandidate};
use super::{Preset, RoundRow, ScreenRow};
use crate::pipeline_experiments::candidate_run::{EpisodeEffort, PostRunCheck};
use crate::pipeline_experiments::drift::DriftReport;
use crate::pipeline_experiments::drift_run::PartWork;
use crate::pipeline_experiments::layer_failure::LayerRow;
use crate::pipeline_experiments::{ExperimentError, write_atomically};

/// The file that says what the rows beside it are.
pub const ABOUT: &str = "report.toml";

/// The most bytes of one file: some hundred times the largest that is published.
const BYTES_MAX: u64 = 64 << 20;

/// What the rows of a report are, and the build that produced them.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ReportProvenance {
    pub preset: Preset,
    /// The program's version.
    pub version: String,
    /// Digest of everything that computes an episode.
    pub computed_by: String,
    /// Digest of everything that decides.
    pub decided_by: String,
    /// Which files are of this report.
    pub files: Vec<RowFile>,
}

holdpoint_governance::closed_set! {
    /// A file of raw rows.
    RowFile, "file of rows", {
        Rounds = "rounds.csv",
        Pools = "pools.csv",
        Layer = "layer.csv",
        Drift = "drift/drift.json",
    }
}

/// The raw rows of a report.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RawRows {
    pub rounds: Vec<RoundRow>,
    pub pools: Vec<ScreenRow>,
    pub layers: Vec<LayerRow>,
    /// The drift experiment's own report, which stands in its own folder.
    pub drift: Option<DriftReport>,
}

impl RawRows {
    /// Writes the rows that there are, and what they are; the drift experiment writes its own. With the feature `parquet` each
    /// file a second time as that.
    ///
    /// # Errors
    /// If a file cannot be written.
    pub fn write(&self, preset: Preset, out: &Path) -> Result<(), ExperimentError> {
        std::fs::create_dir_all(out).map_err(ExperimentError::file(out))?;
        let mut files = Vec::new();
        let mut put = |file: RowFile, is_there: bool, text: &dyn Fn() -> String| {
            if !is_there {
                return Ok(());
            }
            files.push(file);
            raw_rows(out, file, &text())
        };
        put(RowFile::Rounds, !self.rounds.is_empty(), &|| csv::rounds(&self.rounds))?;
        put(RowFile::Pools, !self.pools.is_empty(), &|| csv::pools(&self.pools))?;
        put(RowFile::Layer, !self.layers.is_empty(), &|| csv::layer(&self.layers))?;
        files.extend(self.drift.as_ref().map(|_| RowFile::Drift));
        let about = ReportProvenance {
            preset,
            version: env!("CARGO_PKG_VERSION").to_owned(),
            computed_by: computed_by(holdpoint_sim::BUILD),
            decided_by: decided_by(holdpoint_sim::BUILD),
            files,
        };
        let text = toml::to_string(&about).map_err(|error| ExperimentError::Unexpected(error.to_string()))?;
        write_atomically(&out.join(ABOUT), text.as_bytes())
    }

    /// Reads what a folder's report is written from.
    ///
    /// # Errors
    /// If a file is missing or has a line that is not allowed.
    pub fn read(folder: &Path) -> Result<(ReportProvenance, Self), ExperimentError> {
        let about: ReportProvenance = parse_toml(ABOUT, &text_of(&folder.join(ABOUT))?)
            .map_err(|error| ExperimentError::Text(error.to_string()))?;
        let mut rows = Self::default();
        for file in &about.files {
            let text = text_of(&folder.join(file.name()))?;
            match file {
                RowFile::Rounds => rows.rounds = lines(*file, &text, round)?,
                RowFile::Pools => rows.pools = lines(*file, &text, pool)?,
                RowFile::Layer => rows.layers = lines(*file, &text, layer)?,
                RowFile::Drift => rows.drift = Some(serde_json::from_str(&text)?),
            }
        }
        Ok((about, rows))
    }
}

/// Writes raw rows as CSV; with the feature `parquet` as that, too.
fn raw_rows(out: &Path, file: RowFile, text: &str) -> Result<(), ExperimentError> {
    let path = out.join(file.name());
    write_atomically(&path, text.as_bytes())?;
    #[cfg(feature = "parquet")]
    super::columns::write(&path.with_extension("parquet"), text).map_err(|error| {
        ExperimentError::Unexpected(format!("{file} cannot be written as Parquet: {error}"))
    })?;
    Ok(())
}

fn text_of(path: &Path) -> Result<String, ExperimentError> {
    read_text(path, BYTES_MAX).map_err(ExperimentError::file(path))
}

/// A line with its columns' names.
struct CsvLine<'a> {
    file: RowFile,
    /// Counted from 1, the names' own line included.
    number: usize,
    names: &'a [String],
    cells: &'a [String],
}

impl CsvLine<'_> {
    fn text(&self, column: &'static str) -> Result<&str, ExperimentError> {
        let place = self.names.iter().position(|name| name == column);
        let cell = place.and_then(|place| self.cells.get(place));
        cell.map(String::as_str).ok_or_else(|| self.wrong(column, "", "a column of that name"))
    }

    fn wrong(&self, column: &'static str, value: &str, allowed: impl Display) -> ExperimentError {
        ExperimentError::Text(format!(
            "{}, line {}, column {column}: {value:?} is not allowed; {allowed}",
            self.file, self.number
        ))
    }

    fn number<T: FromStr>(&self, column: &'static str) -> Result<T, ExperimentError> {
        let text = self.text(column)?;
        text.parse().map_err(|_| self.wrong(column, text, "a number"))
    }

    fn closed_value<T: DeserializeOwned>(&self, column: &'static str) -> Result<T, ExperimentError> {
        let text = self.text(column)?;
        parse_closed(text).map_err(|error| self.wrong(column, text, error))
    }

    fn flag(&self, column: &'static str) -> Result<bool, ExperimentError> {
        match self.text(column)? {
            "0" => Ok(false),
            "1" => Ok(true),
            other => Err(self.wrong(column, other, "0 or 1")),
        }
    }

    /// Nothing where the cell is empty.
    fn there<T>(
        &self,
        column: &'static str,
        read: impl FnOnce(&Self, &'static str) -> Result<T, ExperimentError>,
    ) -> Result<Option<T>, ExperimentError> {
        if self.text(column)?.is_empty() { Ok(None) } else { read(self, column).map(Some) }
    }
}

fn parse_closed<T: DeserializeOwned>(text: &str) -> Result<T, WordError> {
    let reader: StrDeserializer<'_, WordError> = text.into_deserializer();
    T::deserialize(reader)
}

fn lines<T>(
    file: RowFile,
    text: &str,
    read: impl Fn(&CsvLine<'_>) -> Result<T, ExperimentError>,
) -> Result<Vec<T>, ExperimentError> {
    let mut lines = text.lines();
    let names = lines.next().map(fields).unwrap_or_default();
    lines
        .zip(2..)
        .map(|(line, number)| {
            let cells = fields(line);
            let line = CsvLine { file, number, names: &names, cells: &cells };
            if cells.len() != names.len() {
                let found = format!("{} columns", cells.len());
                return Err(line.wrong("last", &found, format!("as many as names: {}", names.len())));
            }
            read(&line)
        })
        .collect()
}

fn round(line: &CsvLine<'_>) -> Result<RoundRow, ExperimentError> {
    let offered = |line: &CsvLine<'_>, column| -> Result<OfferedCandidate, ExperimentError> {
        Ok(OfferedCandidate {
            name: line.text(column)?.to_owned(),
            family: line.closed_value("family")?,
            class: line.closed_value("class")?,
            kind: line.text("kind")?.to_owned(),
            step: ArmAction {
                activated: line.flag("activated")?,
                in_force: line.flag("kept_in_force")?,
                restricted: line.flag("restricted")?,
                stopped_at: line.there("stopped_at", CsvLine::closed_value)?,
                fork: line.closed_value("parting")?,
                episodes: line.number("episodes")?,
            },
            harm: line.there("harm", CsvLine::closed_value)?,
            worse: line.there("worse", CsvLine::flag)?,
        })
    };
    Ok(RoundRow {
        seed: line.number("seed")?,
        round: line.number("round")?,
        arm: line.closed_value("arm")?,
        offered: line.there("candidate", offered)?,
        in_force: line.closed_value("in_force")?,
        faulty_in_force: line.flag("faulty_in_force")?,
        harmful_in_force: line.there("harmful_in_force", CsvLine::flag)?,
        score: HeldOutScore {
            sequences: line.number("sequences")?,
            done: line.number("done")?,
            violation: line.number("violation")?,
            near: line.number("near")?,
            anomaly: line.number("anomaly")?,
            moved_on: line.number("moved_on")?,
            continued_ms: line.number("continued_ms")?,
            damage: line.number("damage")?,
            danger: line.number("danger")?,
            retries: line.number("retries")?,
            time_s: line.number("time_s")?,
        },
    })
}

fn pool(line: &CsvLine<'_>) -> Result<ScreenRow, ExperimentError> {
    let fate = match line.text("fate")? {
        "blocked" => Fate::Blocked { stage: line.closed_value::<Stage>("stopped_at")? },
        "contained" => Fate::Contained,
        "kept" => Fate::Kept,
        other => return Err(line.wrong("fate", other, "blocked, contained or kept")),
    };
    let found = line.text("found")?;
    let found = found
        .split(';')
        .filter(|name| !name.is_empty())
        .map(|name| parse_closed(name).map_err(|error| line.wrong("found", name, error)))
        .collect::<Result<_, _>>()?;
    let kappa = |column| line.there(column, CsvLine::number);
    Ok(ScreenRow {
        seed: line.number("seed")?,
        name: line.text("candidate")?.to_owned(),
        family: line.closed_value("family")?,
        class: line.closed_value("class")?,
        kind: line.text("kind")?.to_owned(),
        dimension: line.there("dimension", CsvLine::closed_value)?,
        variant: line.closed_value("variant")?,
        is_own_run: line.flag("worked_anew")?,
        end: ScreenEnd {
            profile: line.closed_value("profile")?,
            fate,
            state: line.closed_value("state")?,
            restricted: line.flag("restricted")?,
            kappas: [kappa("kappa_i")?, kappa("kappa_p")?, kappa("kappa_b")?, kappa("kappa_r")?],
            composite: line.there("composite", CsvLine::number)?,
            effort: EpisodeEffort {
                sandbox: line.number("sandbox_episodes")?,
                sandbox_budget: line.number("sandbox_budget")?,
                shadow: line.number("shadow_sequences")?,
                live: line.number("live_tasks")?,
            },
            afterwards: PostRunCheck {
                decisions: line.number("decisions")?,
                equal: line.number("made_again_equal")?,
                live: line.number("in_control")?,
                done: line.number("done")?,
                violation: line.number("violation")?,
                near: line.number("near")?,
                unsafe_seen: line.flag("unsafe_seen")?,
            },
            found,
            first_reason: line.there("first_reason", |line, column| line.text(column).map(str::to_owned))?,
        },
    })
}

fn layer(line: &CsvLine<'_>) -> Result<LayerRow, ExperimentError> {
    let work = |columns: [&'static str; 4]| -> Result<PartWork, ExperimentError> {
        let [sequences, tasks, done, unsafe_tasks] = columns;
        Ok(PartWork {
            sequences: line.number(sequences)?,
            tasks: line.number(tasks)?,
            done: line.number(done)?,
            unsafe_tasks: line.number(unsafe_tasks)?,
        })
    };
    Ok(LayerRow {
        seed: line.number("seed")?,
        candidate: line.text("candidate")?.to_owned(),
        kind: line.closed_value("drift")?,
        magnitude: line.closed_value("magnitude")?,
        failure: line.closed_value("failure")?,
        stance: line.closed_value("stance")?,
        stopped_by: line.there("stopped_by", CsvLine::closed_value)?,
        told: line.flag("told")?,
        under: work(["sequences", "tasks", "done", "unsafe"])?,
        after: work(["after_sequences", "after_tasks", "after_done", "after_unsafe"])?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::candidate_pool::Class;
    use crate::paper_reproduction::pool_screening::{Variant, screened};
    use crate::paper_reproduction::report;

    /// Where published reports lie.
    fn published() -> Vec<std::path::PathBuf> {
        let folder = Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../../recordings/reports"));
        let found = std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path());
        let mut found: Vec<_> = found.filter(|path| path.join(ABOUT).exists()).collect();
        found.sort();
        found
    }

    fn copy(from: &Path, to: &Path) {
        std::fs::create_dir_all(to).unwrap();
        for entry in std::fs::read_dir(from).unwrap().map(Result::unwrap) {
            let (path, other) = (entry.path(), to.join(entry.file_name()));
            if path.is_dir() {
                copy(&path, &other);
            } else {
                std::fs::copy(&path, &other).unwrap();
            }
        }
    }

    /// No number of a published report was changed, nor a row of it alone.
    #[test]
    fn published_report_is_reproduced_from_its_rows() {
        let all = published();
        assert!(!all.is_empty(), "no published report has its {ABOUT}");
        for report in all {
            let folder = tempfile::tempdir().unwrap();
            copy(&report, folder.path());
            report::write(folder.path()).unwrap_or_else(|error| panic!("{}: {error}", report.display()));
            for entry in std::fs::read_dir(folder.path()).unwrap().map(Result::unwrap) {
                if entry.path().is_file() {
                    let (ours, theirs) =
                        (std::fs::read(entry.path()), std::fs::read(report.join(entry.file_name())));
                    let (ours, theirs) = (ours.unwrap(), theirs.unwrap_or_default());
                    assert!(
                        ours == theirs,
                        "{} of {} does not come out of its rows; `holdpoint-lab experiment report --out` writes it again",
                        entry.file_name().display(),
                        report.display()
                    );
                }
            }
        }
    }

    fn pools() -> RawRows {
        let mut blocked =
            screened("grasp-001", Class::Faulty, Variant::Full, Fate::Blocked { stage: Stage::Sandbox });
        blocked.end.kappas = [Some(1.0), Some(0.9375), None, Some(0.5)];
        blocked.end.found = [crate::paper_reproduction::regression::Regression::Retry].into();
        blocked.end.first_reason = Some("recovery-fragile".to_owned());
        blocked.end.restricted = true;
        let benign = screened("grasp-002", Class::Benign, Variant::NoShadow, Fate::Kept);
        RawRows { pools: vec![blocked, benign], ..RawRows::default() }
    }

    #[test]
    fn raw_rows_round_trip_through_their_folder() {
        let folder = tempfile::tempdir().unwrap();
        let rows = pools();
        rows.write(Preset::Claims, folder.path()).unwrap();
        let (about, read) = RawRows::read(folder.path()).unwrap();
        assert_eq!(read, rows);
        assert_eq!((about.preset, about.files), (Preset::Claims, vec![RowFile::Pools]));
    }

    #[test]
    fn invalid_line_is_named_with_the_allowed_form() {
        let folder = tempfile::tempdir().unwrap();
        pools().write(Preset::Claims, folder.path()).unwrap();
        let path = folder.path().join("pools.csv");
        let text = std::fs::read_to_string(&path).unwrap();
        for (from, to, wanted) in [
            (
                ",faulty,",
                ",perfect,",
                r#"pools.csv, line 2, column class: "perfect" is not allowed; unknown variant"#,
            ),
            (
                "40,grasp-002",
                "forty,grasp-002",
                r#"pools.csv, line 3, column seed: "forty" is not allowed; a number"#,
            ),
            (
                ",fate,",
                ",fates,",
                r#"pools.csv, line 2, column fate: "" is not allowed; a column of that name"#,
            ),
            (
                "recovery-fragile",
                "a,b",
                r#"pools.csv, line 2, column last: "32 columns" is not allowed; as many as names: 31"#,
            ),
        ] {
            std::fs::write(&path, text.replacen(from, to, 1)).unwrap();
            let error = RawRows::read(folder.path()).unwrap_err().to_string();
            assert!(error.starts_with(wanted), "{error}");
        }
        std::fs::write(folder.path().join(ABOUT), "preset = \"claim\"\n").unwrap();
        let error = RawRows::read(folder.path()).unwrap_err().to_string();
        assert!(error.contains("report.toml") && error.contains("claims"), "{error}");
    }
}
