//! `holdpoint store rebuild | backup | check | info | export`: repairs a store that no engine has open, copies it,
//! inspects it, and exports its history.

use std::fs::{self, OpenOptions};
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};

use super::audit::export_error;
use super::data;
use super::output::TextTable;
use super::recordings::size;
use crate::cli::context::CliContext;
use crate::cli::output::CommandOutput;
use crate::error::{CliError, Exit};
use holdpoint_approvals::keyfile;
use holdpoint_audit::rebuild_report::RebuildReport;
use holdpoint_governance::store_finding::StoreFinding;
use holdpoint_record::caller;
use holdpoint_recordings::audit_record::RecordingClosure;
use holdpoint_registry::{
    BackupParts, BackupReport, ExportScope, ListRecordings, OmittedFile, RetainedRecording, StoreInfo,
    UnsignedRecords, Views, backup, check_store, export_store, rebuild, store_info,
};
use holdpoint_service::recordings::{self, RecordListError};
use holdpoint_store::{Layout, StoreError};
use holdpoint_text::shell_word;
use holdpoint_wording::program::audit::exported_with_heads;
use holdpoint_wording::program::store as sentences;
use holdpoint_wording::program::store::CopyGap;
use holdpoint_wording::program::store_check::{checked, store_finding};
use serde_json::json;

/// The arguments of `store`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint store check
  holdpoint store backup /mnt/backup/2026-11-22
  holdpoint store export store.jsonl
  holdpoint store rebuild --from-chain")]
pub struct StoreArgs {
    /// The verb with its arguments.
    #[command(subcommand)]
    pub verb: StoreVerb,
}

/// The verbs of `store`.
#[derive(Clone, Debug, PartialEq, Eq, Subcommand)]
pub enum StoreVerb {
    /// Rebuilds the tables, keeps the damaged file beside them, and records both.
    #[command(after_help = "\
If the chain lacks data, the verb names it and changes nothing. Evidence and signatures that are \
lost are named; a version that depends on them must be evaluated or approved again.

Example:
  holdpoint store rebuild --from-chain")]
    Rebuild {
        /// Rebuilds from the audit log, which must be complete; there is no other source.
        #[arg(long, required = true)]
        from_chain: bool,
        /// Accepts unsigned records at its end; without this option, the verb names them and changes nothing.
        #[arg(long)]
        take_unsigned: bool,
    },
    /// Copies the store, even while an engine runs on it; verifies the copy, which is complete or absent.
    #[command(after_help = "\
The copy has the database, checkpoints, telemetry, the site profiles and all public keys. A name that ends \
with .db gets only the database. Nothing is overwritten, and the store's own folder takes no copy. The copy is \
made in a folder of the same name with .part at its end, which must not exist either.

With --with-recordings, each recording is copied only if it matches its digest at closure. Omissions are \
named; if one was on record, the verb exits with 1.

Examples:
  holdpoint store backup /mnt/backup/2026-11-22
  holdpoint store backup copy.db")]
    Backup {
        /// A new folder, or a new file that ends with .db.
        #[arg(value_name = "DIR|FILE")]
        to: PathBuf,
        /// Copies the secret keys: the holder of the copy can sign as this store, and with every unencrypted key.
        #[arg(long)]
        with_keys: bool,
        /// Copies the recordings.
        #[arg(long)]
        with_recordings: bool,
    },
    /// Checks the store and prints the findings. Exits with 1 if something is wrong.
    #[command(after_help = "\
The verb verifies the audit chain, every row against its records, the sealed telemetry, the keys and
the witnesses. It writes nothing. `holdpoint audit verify --all` verifies the recordings, too.

Example:
  holdpoint store check")]
    Check,
    /// Prints the store's id, schema, records, sizes, checkpoint and user.
    #[command(after_help = "\
Example:
  holdpoint store info --json")]
    Info,
    /// Writes the whole history into one file that another program can verify: checkpoints, records and approvals.
    #[command(after_help = "\
`holdpoint audit verify --file FILE` verifies it; the script in the guide does so without this program.

Example:
  holdpoint store export store.jsonl")]
    Export {
        /// Writes records that fail verification, too, unchanged, to inspect a damaged store.
        #[arg(long)]
        unchecked: bool,
        /// A new file, or `-` for the standard output.
        #[arg(value_name = "FILE")]
        file: PathBuf,
    },
}

/// Runs the verb.
///
/// # Errors
/// [`CliError`]; the store is then unchanged.
pub fn run(context: &CliContext, args: &StoreArgs, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    match &args.verb {
        StoreVerb::Rebuild { from_chain: _, take_unsigned } => {
            data::database(&context.data)?;
            let by = serde_json::to_string(&caller::own()).map_err(CliError::internal)?;
            let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
            let wall_ms = since.ok().and_then(|since| i64::try_from(since.as_millis()).ok()).unwrap_or(0);
            let unsigned = if *take_unsigned { UnsignedRecords::Take } else { UnsignedRecords::Refuse };
            let rebuilt = rebuild(&context.data, unsigned, &by, wall_ms).map_err(CliError::usage)?;
            out.answer(&serde_json::json!({ "rebuilt": rebuilt }), |out| {
                print_rebuild(rebuilt.as_ref(), out)
            })?;
            Ok(Exit::Confirmed)
        }
        StoreVerb::Backup { to, with_keys, with_recordings } => {
            data::database(&context.data)?;
            let recordings = with_recordings.then_some(&recordings_of as &ListRecordings<'_>);
            let parts = BackupParts { keys: *with_keys, recordings };
            let report = backup(&context.data, to, parts).map_err(CliError::usage)?;
            let value = json!({ "copied": to.display().to_string(), "report": report });
            out.answer(&value, |out| {
                let files = usize::try_from(report.files).unwrap_or(usize::MAX);
                let records = report.verified.records;
                out.line(&sentences::copied(records, &size(report.bytes), files, to.display()))?;
                if let Some(line) = left_out(context, to, &report, *with_recordings) {
                    out.line(&line)?;
                }
                if *with_recordings {
                    let recordings = usize::try_from(report.recordings).unwrap_or(usize::MAX);
                    out.line(&sentences::copied_recordings(recordings))?;
                }
                report.left_out.iter().try_for_each(|OmittedFile { file, why, bad }| {
                    out.line(&sentences::left_out(*bad, file, *why))
                })
            })?;
            let lacks = report.left_out.iter().any(|left| left.bad);
            Ok(if lacks { Exit::Rejected } else { Exit::Confirmed })
        }
        StoreVerb::Check => {
            data::database(&context.data)?;
            let found = check_store(&context.data).map_err(CliError::usage)?;
            let sound = found.iter().all(StoreFinding::is_good);
            let rows = found.iter().map(|one| json!({ "good": one.is_good(), "text": store_finding(one) }));
            let value =
                json!({ "good": sound, "found": rows.collect::<Vec<_>>(), "not_checked": ["recordings"] });
            out.answer(&value, |out| {
                out.line(sentences::RECORDINGS_NOT_CHECKED)?;
                found.iter().try_for_each(|one| out.line(&checked(one)))
            })?;
            Ok(if sound { Exit::Confirmed } else { Exit::Rejected })
        }
        StoreVerb::Info => {
            data::database(&context.data)?;
            let info = store_info(&context.data).map_err(CliError::usage)?;
            out.answer(&info, |out| print_info(&info, out))?;
            Ok(Exit::Confirmed)
        }
        StoreVerb::Export { unchecked, file } => {
            let exporting = if *unchecked { ExportScope::Unchecked } else { ExportScope::Signed };
            let database = data::database(&context.data)?;
            let key = keyfile::read_public(&Layout::new(&context.data).store_public_key()).ok();
            let cannot = |error: std::io::Error| {
                CliError::usage(format!("cannot write {file:?}: {error}")).with_unwritable(file, &error)
            };
            let key = key.as_ref().map(|(key, _)| key);
            if file.as_os_str() == "-" {
                let mut writer = BufWriter::new(out.sink());
                export_store(&database, exporting, key, &mut writer).map_err(export_error)?;
                writer.flush()?;
                return Ok(Exit::Confirmed);
            }
            let output = OpenOptions::new().write(true).create_new(true).open(file).map_err(cannot)?;
            let mut writer = BufWriter::new(output);
            let records = export_store(&database, exporting, key, &mut writer).map_err(CliError::usage)?;
            writer.flush().and_then(|()| writer.get_ref().sync_all()).map_err(cannot)?;
            out.answer(&json!({ "records": records, "file": file.display().to_string() }), |out| {
                out.line(&exported_with_heads(records, file.display()))
            })?;
            Ok(Exit::Confirmed)
        }
    }
}

/// What a copy lacks, and the command for a copy that has it. An engine does not start without the secret keys.
fn left_out(context: &CliContext, to: &Path, report: &BackupReport, with_recordings: bool) -> Option<String> {
    let is_alone = to.extension().is_some_and(|ending| ending == "db");
    let has_files = |folder: PathBuf| fs::read_dir(folder).is_ok_and(|mut entries| entries.next().is_some());
    let lacks_recordings =
        (is_alone || !with_recordings) && has_files(Layout::new(&context.data).recordings());
    let gap = match (report.keys, lacks_recordings) {
        (true, false) => return None,
        (true, true) => CopyGap::Recordings,
        (false, false) => CopyGap::Keys,
        (false, true) => CopyGap::KeysAndRecordings,
    };
    let mut other = to.with_extension("").into_os_string();
    other.push("-whole");
    let other = shell_word(&other.to_string_lossy());
    Some(sentences::copy_lacks(gap, &other))
}

/// The records of the store's recordings.
fn recordings_of(views: &Views) -> Result<Vec<RetainedRecording>, StoreError> {
    let on_record = recordings::on_record(views).map_err(|error| match error {
        RecordListError::Store(error) => error,
        RecordListError::Form(error) => StoreError::Invalid {
            what: "record of a recording",
            value: error.to_string(),
            allowed: "one in the form of this program".to_owned(),
        },
    })?;
    let of = |recorded: &RecordingClosure| RetainedRecording {
        file: recorded.file.clone(),
        sha256: recorded.sha256,
        bytes: recorded.bytes,
    };
    Ok(on_record.present().map(of).collect())
}

fn print_info(info: &StoreInfo, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    let mut table = TextTable::new(&["what", "is"]);
    // Scripts record no wall time.
    let wall = |ms: Option<i64>| {
        let ms = ms.filter(|ms| *ms != 0);
        let secs = ms.and_then(|ms| u64::try_from(ms / 1_000).ok());
        secs.map_or_else(|| "-".to_owned(), holdpoint_store::utc)
    };
    let number = |number: Option<u64>| number.map_or_else(|| "-".to_owned(), |number| number.to_string());
    table.row(["store", info.store_id.as_str()]);
    table.row(["schema".to_owned(), format!("{} of {}", info.schema, info.schema_newest)]);
    table.row(["records".to_owned(), info.records.to_string()]);
    table.row(["head", info.head.as_str()]);
    table.row([sentences::SIGNED_AT_RECORD.to_owned(), number(info.signed_at)]);
    table.row([sentences::ROOT_OF_TREE, info.root.as_deref().unwrap_or("-")]);
    table.row(["checkpoints".to_owned(), info.checkpoints.to_string()]);
    table.row(["versions".to_owned(), info.versions.to_string()]);
    table.row([sentences::FIRST_RECORD.to_owned(), wall(info.first_wall_ms)]);
    table.row([sentences::LAST_RECORD.to_owned(), wall(info.last_wall_ms)]);
    for (name, bytes) in &info.bytes {
        table.row([name.clone(), size(*bytes)]);
    }
    table.row(["free".to_owned(), size(info.free_bytes)]);
    for witness in &info.witnesses {
        table.row(["witness", witness.as_str()]);
    }
    table.row([sentences::IN_USE_BY, info.in_use_by.as_deref().unwrap_or(sentences::NO_PROCESS)]);
    out.table(&table)
}

fn print_rebuild(rebuilt: Option<&RebuildReport>, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    let Some(rebuilt) = rebuilt else {
        return out.line(sentences::NOTHING_TO_REBUILD);
    };
    out.line(&sentences::rebuilt(rebuilt.from_seq, &rebuilt.kept_as))?;
    out.line(&sentences::first_found(&rebuilt.problem))?;
    if rebuilt.unsigned > 0 {
        let first = (rebuilt.from_seq + 1).saturating_sub(rebuilt.unsigned);
        out.line(&sentences::took_unsigned(first, rebuilt.from_seq))?;
    }
    for row in &rebuilt.differed {
        out.line(&sentences::repaired(&row.table, &row.key, &row.problem, &row.columns))?;
    }
    for (table, key) in &rebuilt.lost {
        out.line(&sentences::lost(table, key))?;
    }
    Ok(())
}
