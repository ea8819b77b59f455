//! `holdpoint audit verify`: verifies the whole history, its copies, and the files that belong to it.

use std::fs;
use std::path::{Path, PathBuf};

use clap::Args;
use serde_json::json;

use super::progress_bar::DelayedProgressBar;
use super::recordings;
use crate::cli::context::CliContext;
use crate::cli::output::CommandOutput;
use crate::error::{CliError, Exit};
use holdpoint_approvals::keyfile;
use holdpoint_audit::export_file::{ExportReport, is_exported, verify_export};
use holdpoint_audit::history_error::HistoryError;
use holdpoint_engine::decide::evaluation_keys::key_check::{KeyCheck, check_keys};
use holdpoint_recordings::audit_record::FileCheck;
use holdpoint_registry::{DatabaseLocation, VerifyOptions, verify_against};
use holdpoint_store::{Layout, MissingBatches, VerifyError, VerifyReport};
use holdpoint_text::file::kind_of;
use holdpoint_text::{ErrorDetails, ErrorReason};
use holdpoint_wording::program::audit as sentences;

/// The most copies in one command.
const COPIES_MAX: usize = 64;

/// The arguments of `audit verify`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
pub struct VerifyArgs {
    /// The database, or a file of `store export` [default: the store's database].
    #[arg(long)]
    pub file: Option<PathBuf>,
    /// The store's public key [default: the one in the store].
    #[arg(long)]
    pub key: Option<PathBuf>,
    /// Signed checkpoints from elsewhere: a checkpoint, an exported store, a proof, a database, or a folder of
    /// checkpoints of a store or a witness. Can be given several times.
    #[arg(long, value_name = "FILE|DIR")]
    pub against: Vec<PathBuf>,
    /// Verifies the recordings, too.
    #[arg(long, conflicts_with = "file")]
    pub all: bool,
}

/// Verifies, and reports the first error.
///
/// # Errors
/// [`CliError`] if something cannot be read.
pub(super) fn run(
    context: &CliContext,
    args: &VerifyArgs,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    let layout = Layout::new(&context.data);
    let database = args.file.clone().unwrap_or_else(|| layout.database());
    if !database.is_file() {
        let (reason, text) = match fs::symlink_metadata(&database) {
            Ok(found) => {
                let text = format!("{database:?} is not a database: it is {}", kind_of(&found));
                (ErrorReason::BadFile, text)
            }
            Err(_) => {
                let reason = if args.file.is_some() { ErrorReason::BadFile } else { ErrorReason::NoStore };
                (reason, format!("there is no database {database:?}"))
            }
        };
        let hint = if database.join("holdpoint.db").is_file() {
            format!(
                "`holdpoint audit verify --file {}` verifies the database in it",
                database.join("holdpoint.db").display()
            )
        } else if database.is_dir() {
            format!(
                "`holdpoint audit verify --against {}` compares the store with the heads in it",
                database.display()
            )
        } else if args.file.is_some() {
            "`holdpoint audit verify` verifies the store itself".to_owned()
        } else {
            "`holdpoint run` creates a store; --data DIR names another".to_owned()
        };
        let details = ErrorDetails::of_path(reason, &database);
        return Err(CliError::usage(text).with_hint(hint).with_details(details));
    }
    if args.against.len() > COPIES_MAX {
        return Err(CliError::usage(format!("--against can be given {COPIES_MAX} times at most")));
    }
    // The store's own key verifies only the store; for a copied file it would be a guess.
    let own_key =
        (args.file.is_none() && layout.store_public_key().is_file()).then(|| layout.store_public_key());
    let key = args.key.clone().or(own_key);
    let key = key.as_deref().map(keyfile::read_public).transpose().map_err(CliError::usage)?;
    let key = key.map(|(key, _)| key);
    if is_exported(&database) {
        if !args.against.is_empty() {
            let problem = "--against compares a store or its database, not an exported file";
            return Err(CliError::usage(problem.to_owned())
                .with_hint("name the exported file with --against, and the store with --data"));
        }
        let found = verify_export(&database, key.as_ref()).map_err(VerifyError::from);
        return answer(found, exported, out);
    }
    let bar = DelayedProgressBar::new();
    let tell = |what: &'static str, done: u64, total: u64| bar.update(what, done, total);
    let place = if args.file.is_some() { DatabaseLocation::Copy } else { DatabaseLocation::Store };
    if place == DatabaseLocation::Store && key.is_none() {
        // A history that any process could have rewritten is not "sound".
        let problem = format!(
            "the store's public key {:?} is missing, so no signature can be checked; restore it from a backup, or \
             name a copy with --key",
            layout.store_public_key()
        );
        return not_sound(&problem, None, out);
    }
    let judged = VerifyOptions { key: key.as_ref(), against: &args.against, place, tell: &tell };
    let found = verify_against(&database, &judged);
    let (Ok(report), DatabaseLocation::Store) = (&found, place) else {
        drop(bar);
        return answer(found, sound, out);
    };
    let keys = check_keys(&super::data::open(&context.data)?).map_err(CliError::usage)?;
    let keys = match keys {
        Ok(keys) => keys,
        Err(problem) => return not_sound(&problem.to_string(), Some(problem.record()), out),
    };
    let recordings = if args.all { Some(check_recordings(context, &bar)?) } else { None };
    drop(bar);
    let recordings = match recordings.transpose() {
        Ok(recordings) => recordings,
        Err(problem) => return not_sound(&problem, None, out),
    };
    let mut value = json!({ "sound": true, "report": report, "seed_keys": keys });
    if let (Some(fields), Some(recordings)) = (value.as_object_mut(), recordings) {
        fields.insert("recordings".to_owned(), recordings.into());
    }
    out.answer(&value, |out| {
        sound(report, out)?;
        show_keys(&keys, out)?;
        recordings.map_or(Ok(()), |recordings| out.line(&sentences::recordings(recordings)))
    })?;
    Ok(Exit::Confirmed)
}

/// Prints the check of the keys for secret seeds, if the store has any.
fn show_keys(keys: &KeyCheck, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    let KeyCheck { committed, revealed, follow, pending, replaced } = keys;
    if *committed == 0 {
        return Ok(());
    }
    out.line(&sentences::seed_keys(*committed, *revealed, *follow, *pending))?;
    if *replaced > 0 {
        out.line(&sentences::replaced_keys(*replaced))?;
    }
    Ok(())
}

/// Checks that every recording matches its record, and that every one on record exists. Returns the count, or the
/// error.
fn check_recordings(context: &CliContext, bar: &DelayedProgressBar) -> Result<Result<u64, String>, CliError> {
    let record = recordings::on_record(&super::data::open(&context.data)?)?;
    let files = recordings::shelved(&Layout::new(&context.data).recordings())?;
    let bytes = files.iter().map(|filed| filed.bytes).sum();
    let (mut read, mut good) = (0, 0);
    for filed in &files {
        bar.update(sentences::BYTES_OF_RECORDINGS, read, bytes);
        let checked = recordings::check(filed, &record)?;
        match checked {
            FileCheck::Matches => good += 1,
            FileCheck::NotOnRecord => {}
            FileCheck::Differs { .. } | FileCheck::OtherSize { .. } => {
                let difference = recordings::difference(&checked).unwrap_or_default();
                return Ok(Err(format!("the recording {:?} is bad: {difference}", filed.file)));
            }
        }
        read += filed.bytes;
    }
    let missing = record.present().find(|recorded| files.iter().all(|filed| filed.file != recorded.file));
    Ok(match missing {
        Some(recorded) => Err(format!(
            "the recording {:?} is missing: it was recorded at closure, and no removal is on record",
            recorded.file
        )),
        None => Ok(good),
    })
}

fn answer<T: serde::Serialize>(
    found: Result<T, VerifyError>,
    show: impl FnOnce(&T, &mut CommandOutput<'_>) -> Result<(), CliError>,
    out: &mut CommandOutput<'_>,
) -> Result<Exit, CliError> {
    match found {
        Ok(report) => {
            out.answer(&json!({ "sound": true, "report": report }), |out| show(&report, out))?;
            Ok(Exit::Confirmed)
        }
        Err(error @ (VerifyError::Unreadable(_) | VerifyError::History(HistoryError::Unreadable(_)))) => {
            Err(CliError::usage(error))
        }
        Err(error) => not_sound(&error.to_string(), error.record(), out),
    }
}

fn not_sound(problem: &str, record: Option<u64>, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    let mut value = json!({ "sound": false, "problem": problem });
    if let (Some(fields), Some(record)) = (value.as_object_mut(), record) {
        fields.insert("record".to_owned(), record.into());
    }
    out.answer(&value, |out| out.line(&sentences::not_sound(problem)))?;
    Ok(Exit::Rejected)
}

fn sound(report: &VerifyReport, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    out.line(&sentences::sound(report.key_given, report.records, report.head))?;
    out.line(&sentences::checkpoints(report.checkpoints, report.key_given))?;
    if report.copies > 0 {
        out.line(&sentences::heads_elsewhere(report.copies))?;
    }
    for silent in &report.witnesses_silent {
        out.line(&sentences::silent_witness(silent))?;
    }
    for (first, last) in &report.taken_unsigned {
        out.line(&sentences::accepted_unsigned(*first, *last))?;
    }
    out.line(&sentences::approvals(report.approvals))?;
    if report.persons > 0 {
        out.line(&sentences::persons(report.persons, report.confirmed))?;
    }
    out.line(&sentences::batches(report.batches, report.batches_pruned, report.batches_unseen))?;
    if report.batches_missed > 0 {
        out.line(&sentences::batches_missed(report.batches_missed))?;
    }
    let Some(missing) = report.batches_missing else { return Ok(()) };
    let MissingBatches { first, last, first_sealed_by, last_sealed_by } = missing;
    out.line(&sentences::batches_away(first, last, (first_sealed_by, last_sealed_by)))
}

fn exported(report: &ExportReport, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    out.line(&sentences::sound(true, report.records, report.head))?;
    out.line(&sentences::signed_heads(report.heads, report.key_given))?;
    out.line(&sentences::root_of_tree(report.root))?;
    out.line(&sentences::approvals(report.approvals))?;
    out.line(&sentences::persons(report.persons, report.confirmed))
}

/// The folder of a witness, as recorded.
///
/// # Errors
/// If it does not exist.
pub(super) fn absolute(path: &Path) -> Result<String, CliError> {
    let not_utf8 = || CliError::usage(format!("{path:?} is not UTF-8")).with_bad_file(path);
    let text = path.to_str().ok_or_else(not_utf8)?;
    // The store refuses addresses, with a hint.
    if text.contains("://") || text.contains('@') {
        return Ok(text.to_owned());
    }
    let full = std::path::absolute(path)
        .map_err(|error| CliError::usage(format!("{path:?}: {error}")).with_bad_file(path))?;
    Ok(full.display().to_string())
}
