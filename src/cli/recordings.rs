//! `holdpoint recordings list | verify | prune`: the recordings of upgrades. `list` and `verify` only read, and an
//! engine may have the store open. `prune` records each removal and needs the store for itself.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use clap::{ArgGroup, Args, Subcommand};
use serde_json::{Value, json};

use super::output::TextTable;
use super::prune::{self, PruneLimits, UpgradeRecordings};
use crate::cli::context::CliContext;
use crate::cli::output::CommandOutput;
use crate::error::{CliError, Exit};
use holdpoint_recordings::audit_record::{FileCheck, RecordedFiles};
use holdpoint_recordings::recording_folder::{self, IrregularFile, RecordingFile, RecordingFolder};
use holdpoint_registry::Views;
use holdpoint_service::recordings;
use holdpoint_store::Layout;
pub(super) use holdpoint_store::size;
use holdpoint_wording::counted;
use holdpoint_wording::program::recordings as sentences;
use holdpoint_wording::program::recordings::RecordingCheck;

/// Bytes of a mebibyte.
const MIB: u64 = 1 << 20;

/// The arguments of `recordings`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint recordings list
  holdpoint recordings verify
  holdpoint recordings prune --keep 50 --dry-run")]
pub struct RecordingsArgs {
    /// The verb with its arguments.
    #[command(subcommand)]
    pub verb: RecordingsVerb,
}

/// The verbs of `recordings`.
#[derive(Clone, Debug, PartialEq, Eq, Subcommand)]
pub enum RecordingsVerb {
    /// Lists the recordings, by version.
    #[command(after_help = "\
Example:
  holdpoint recordings list --json")]
    List,
    /// Compares every recording with its digest in the audit log. Exits with 1 if one differs or is missing.
    #[command(after_help = "\
To check the audit chain itself, run `holdpoint audit verify`.

Example:
  holdpoint recordings verify")]
    Verify,
    /// Removes recordings beyond a number, an age or a total size, each with an audit record of the reason.
    #[command(
        after_help = "\
An open upgrade keeps its recordings, and so does one whose recording differs from its digest.
At least one limit is needed.

Examples:
  holdpoint recordings prune --keep 50 --dry-run
  holdpoint recordings prune --older-than 90 --max-mib 2000",
        group = ArgGroup::new("limit").required(true).multiple(true)
    )]
    Prune(PruneArgs),
}

/// The arguments of `recordings prune`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
pub struct PruneArgs {
    /// Keeps the recordings of the N newest upgrades.
    #[arg(long, value_name = "N", group = "limit")]
    pub keep: Option<usize>,
    /// Removes recordings last written more than DAYS days ago.
    #[arg(long, value_name = "DAYS", group = "limit", value_parser = clap::value_parser!(u32).range(1..))]
    pub older_than: Option<u32>,
    /// Removes the oldest recordings until the total is at most N MiB.
    #[arg(long, value_name = "N", group = "limit")]
    pub max_mib: Option<u32>,
    /// Prints the recordings to remove, and removes nothing.
    #[arg(long)]
    pub dry_run: bool,
}

/// Runs the verb.
///
/// # Errors
/// [`CliError`].
pub fn run(
    context: &CliContext,
    args: &RecordingsArgs,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    let views = super::data::open(&context.data)?;
    let folder = Layout::new(&context.data).recordings();
    match &args.verb {
        RecordingsVerb::List => list(&look(&folder)?, &on_record(&views)?, out),
        RecordingsVerb::Verify => verify(&look(&folder)?, &on_record(&views)?, out),
        RecordingsVerb::Prune(args) => remove(context, &views, &folder, args, out),
    }
}

/// The recordings in a folder.
pub(super) fn shelved(folder: &Path) -> Result<Vec<RecordingFile>, CliError> {
    Ok(look(folder)?.files)
}

/// The entries of a folder that have names of recordings.
fn look(folder: &Path) -> Result<RecordingFolder, CliError> {
    recording_folder::look(folder).map_err(|error| {
        CliError::usage(format!("cannot read the recordings in {folder:?}: {error}")).with_bad_file(folder)
    })
}

/// The audit chain's records of recordings.
pub(super) fn on_record(views: &Views) -> Result<RecordedFiles, CliError> {
    recordings::on_record(views).map_err(CliError::usage)
}

/// How a file compares with its record.
pub(super) fn check(filed: &RecordingFile, record: &RecordedFiles) -> Result<FileCheck, CliError> {
    let path = &filed.path;
    record
        .check(filed)
        .map_err(|error| CliError::usage(format!("cannot read {path:?}: {error}")).with_bad_file(path))
}

fn list(
    folder: &RecordingFolder,
    record: &RecordedFiles,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    let RecordingFolder { files, no_files } = folder;
    let row = |filed: &RecordingFile| {
        let recorded = record.recorded(&filed.file);
        json!({
            "version": filed.name.version,
            "segment": filed.name.segment,
            "outcome": recorded.map(|recorded| &recorded.outcome),
            "bytes": filed.bytes,
            "written": utc(filed.written_secs),
            "on_record": recorded.is_some(),
            "file": filed.file,
        })
    };
    if out.is_json() {
        files.iter().try_for_each(|filed| out.json(&row(filed)))?;
        for IrregularFile { name, what } in no_files {
            out.json(&json!({ "file": name, "no_file": what }))?;
        }
        return Ok(Exit::Confirmed);
    }
    if files.is_empty() {
        out.line("no recordings")?;
        return print_skipped(no_files, out);
    }
    let mut table = TextTable::new(&["version", "outcome", "size", "written (UTC)", "on record", "file"]);
    for filed in files {
        let recorded = record.recorded(&filed.file);
        table.row([
            filed.name.version.to_string(),
            recorded.map_or_else(|| "not closed".to_owned(), |recorded| recorded.outcome.to_string()),
            size(filed.bytes),
            utc(filed.written_secs),
            if recorded.is_some() { "yes" } else { "no" }.to_owned(),
            filed.file.clone(),
        ]);
    }
    out.table(&table)?;
    out.line(&format!(
        "{}, {}",
        counted(files.len(), "file"),
        size(files.iter().map(|filed| filed.bytes).sum())
    ))?;
    print_skipped(no_files, out)
}

/// How a file differs from the closed one; `None` if it matches or no record names it.
pub(super) fn difference(checked: &FileCheck) -> Option<String> {
    match checked {
        FileCheck::Matches | FileCheck::NotOnRecord => None,
        FileCheck::Differs { found, recorded } => Some(sentences::other_digest(found, recorded)),
        FileCheck::OtherSize { found, recorded } => Some(sentences::other_size(*found, *recorded)),
    }
}

/// Reports an entry that has a recording's name and is not a recording.
fn print_skipped(no_files: &[IrregularFile], out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    for IrregularFile { name, what } in no_files {
        out.line(&sentences::skipped(name, what))?;
    }
    Ok(Exit::Confirmed)
}

/// The result for one recording, as printed.
struct RecordingFindings {
    file: String,
    result: RecordingCheck,
    detail: String,
}

fn verify(
    folder: &RecordingFolder,
    record: &RecordedFiles,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    let RecordingFolder { files, no_files } = folder;
    let mut found = Vec::new();
    for filed in files {
        let checked = check(filed, record)?;
        let (result, detail) = match checked {
            FileCheck::Matches => (RecordingCheck::Matches, String::new()),
            FileCheck::Differs { .. } | FileCheck::OtherSize { .. } => {
                (RecordingCheck::Differs, difference(&checked).unwrap_or_default())
            }
            FileCheck::NotOnRecord => (RecordingCheck::NotOnRecord, sentences::NO_RECORD.to_owned()),
        };
        found.push(RecordingFindings { file: filed.file.clone(), result, detail });
    }
    let there: BTreeSet<&str> = files.iter().map(|filed| filed.file.as_str()).collect();
    for recorded in record.present().filter(|recorded| !there.contains(recorded.file.as_str())) {
        let in_its_place = no_files.iter().find(|one| one.name == recorded.file);
        let detail = sentences::missing(in_its_place.map(|one| one.what));
        let result = RecordingCheck::Missing;
        found.push(RecordingFindings { file: recorded.file.clone(), result, detail });
    }
    let bad = found.iter().filter(|one| one.result.is_bad()).count();
    let unknown = found.iter().filter(|one| one.result == RecordingCheck::NotOnRecord).count();
    let of_others = |one: &&IrregularFile| record.present().all(|recorded| recorded.file != one.name);
    for IrregularFile { name, what } in no_files.iter().filter(of_others) {
        let value = json!({ "file": name, "standing": "no file", "detail": what });
        out.answer(&value, |out| out.line(&sentences::other_file(name, what)))?;
    }
    for one in &found {
        let value = json!({ "file": one.file, "standing": one.result.name(), "detail": one.detail });
        out.answer(&value, |out| out.line(&sentences::checked(&one.file, one.result, &one.detail)))?;
    }
    let summary =
        json!({ "sound": bad == 0, "recordings": found.len(), "bad": bad, "not_on_record": unknown });
    out.answer(&summary, |out| out.line(&sentences::checked_all(found.len(), bad, unknown)))?;
    Ok(if bad == 0 { Exit::Confirmed } else { Exit::Rejected })
}

fn remove(
    context: &CliContext,
    views: &Views,
    folder: &Path,
    args: &PruneArgs,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    let limits = PruneLimits {
        keep: args.keep,
        older_than_secs: args.older_than.map(|days| u64::from(days) * 86_400),
        bytes_max: args.max_mib.map(|mib| u64::from(mib) * MIB),
    };
    // The verb opens the store first, so that no engine opens or closes an upgrade meanwhile.
    let store = if args.dry_run { None } else { Some(prune::take_store(&context.data)?) };
    let record = on_record(views)?;
    let chosen = prune::choose(prune::upgrades(shelved(folder)?, views)?, limits, prune::now_secs());
    let (mut removed, mut skipped, mut bytes) = (0_usize, 0_u64, 0_u64);
    for (UpgradeRecordings { files, version, .. }, reason) in &chosen {
        for filed in files {
            if difference(&check(filed, &record)?).is_some() {
                skipped += 1;
                let value = json!({ "kept": filed.file, "reason": sentences::KEPT_REASON });
                out.answer(&value, |out| out.line(&sentences::kept(&filed.file)))?;
                continue;
            }
            if let Some(store) = &store {
                prune::remove(store, version, filed, reason)?;
            }
            removed += 1;
            bytes += filed.bytes;
            let key = if args.dry_run { "would_remove" } else { "removed" };
            let value: BTreeMap<&str, Value> =
                [(key, json!(filed.file)), ("bytes", json!(filed.bytes)), ("reason", json!(reason))].into();
            out.answer(&value, |out| {
                out.line(&sentences::removed(args.dry_run, &filed.file, &size(filed.bytes), reason))
            })?;
        }
    }
    if !out.is_json() {
        out.line(&sentences::removed_all(args.dry_run, removed, &size(bytes)))?;
    }
    Ok(if skipped == 0 { Exit::Confirmed } else { Exit::Rejected })
}

/// A wall time for people: `2026-11-21 02:10`.
fn utc(secs: u64) -> String {
    holdpoint_store::utc(secs).chars().take(16).collect()
}

#[cfg(test)]
mod tests;
