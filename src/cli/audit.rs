//! `holdpoint audit list | verify | export`. Reads the store; an engine may have it open meanwhile.

use std::fs::OpenOptions;
use std::path::{Path, PathBuf};

use clap::{Args, Subcommand};

use super::output::Table;
use crate::cli::context::CliContext;
use crate::cli::output::Output;
use crate::error::{CliError, Exit};
use holdpoint_approvals::keyfile;
use holdpoint_governance::record::RecordKind;
use holdpoint_registry::{
    AuditFilter, ExportError, Layout, MissingBatches, VerifyError, VerifyReport, Views, verify,
};

/// The most records `list` prints.
pub const LIST_MAX: u32 = 10_000;

/// The arguments of `audit`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint audit list --subject grasp@1.3.0
  holdpoint audit verify
  holdpoint audit export --out audit.jsonl")]
pub struct AuditArgs {
    /// The verb that was given, with its arguments.
    #[command(subcommand)]
    pub verb: AuditVerb,
}

/// What can be done with the audit log.
#[derive(Clone, Debug, PartialEq, Eq, Subcommand)]
pub enum AuditVerb {
    /// Lists records, the newest first.
    #[command(after_help = "\
Example:
  holdpoint audit list --subject grasp@1.3.0 --limit 20")]
    List {
        /// About exactly this family or version only.
        #[arg(long, value_name = "FAMILY[@VERSION]")]
        subject: Option<String>,
        /// Of this kind only.
        #[arg(long)]
        kind: Option<RecordKind>,
        /// How many at most.
        #[arg(long, value_name = "N", default_value_t = 50,
              value_parser = clap::value_parser!(u32).range(1..=i64::from(LIST_MAX)))]
        limit: u32,
    },
    /// Verifies the whole chain and names the first bad record. Ends with 1 if there is one.
    #[command(after_help = "\
Example:
  holdpoint audit verify --file copy/holdpoint.db --key store.pub")]
    Verify {
        /// The database [default: the store's].
        #[arg(long)]
        file: Option<PathBuf>,
        /// The store's public key [default: the one in the store].
        #[arg(long)]
        key: Option<PathBuf>,
    },
    /// Writes the records as JSON lines.
    #[command(after_help = "\
Example:
  holdpoint audit export --from 100 --out audit.jsonl")]
    Export {
        /// From this record on.
        #[arg(long, value_name = "SEQ", default_value_t = 1)]
        from: u64,
        /// A new file [default: the standard output].
        #[arg(long, value_name = "FILE")]
        out: Option<PathBuf>,
    },
}

/// Does what was asked for.
///
/// # Errors
/// [`CliError`].
pub fn run(context: &CliContext, args: &AuditArgs, out: &mut Output<'_>) -> Result<Exit, CliError> {
    let layout = Layout::new(&context.data);
    match &args.verb {
        AuditVerb::List { subject, kind, limit } => {
            let filter = AuditFilter {
                from_seq: 0,
                before_seq: None,
                kind: *kind,
                subject: subject.clone(),
                limit: *limit as usize,
                newest_first: true,
            };
            list(&open(&context.data)?, &filter, out)?;
        }
        AuditVerb::Verify { file, key } => {
            let database = file.clone().unwrap_or_else(|| layout.database());
            // Beside a copied file the store's own key would be a guess, so it is used for the store alone.
            let own_key =
                (file.is_none() && layout.store_public_key().is_file()).then(|| layout.store_public_key());
            return check(&database, key.clone().or(own_key).as_deref(), out);
        }
        AuditVerb::Export { from, out: None } => {
            export_to(&open(&context.data)?, *from, out.sink())?;
        }
        AuditVerb::Export { from, out: Some(path) } => {
            let views = open(&context.data)?;
            let cannot = |error: std::io::Error| CliError::usage(format!("cannot write {path:?}: {error}"));
            let mut file = OpenOptions::new().write(true).create_new(true).open(path).map_err(cannot)?;
            let records = export_to(&views, *from, &mut file)?;
            file.sync_all().map_err(cannot)?;
            out.answer(
                &serde_json::json!({ "records": records, "file": path.display().to_string() }),
                |out| out.line(&format!("wrote {records} records to {}", path.display())),
            )?;
        }
    }
    Ok(Exit::Confirmed)
}

/// Opens the store's views for reading the chain, for judging evidence, or where an engine checks them before it acts.
///
/// # Errors
/// [`CliError::Usage`] if there is no store, or it cannot be read.
pub(super) fn open(data: &Path) -> Result<Views, CliError> {
    Views::open(&database(data)?).map_err(CliError::usage)
}

/// Opens the store's views for showing what the tables hold: they are what the chain says.
///
/// # Errors
/// [`CliError::Usage`] if there is no store, or its tables are not what its chain says.
pub(super) fn open_checked(data: &Path) -> Result<Views, CliError> {
    Views::open_checked(&database(data)?).map_err(CliError::usage)
}

/// The database of a store.
///
/// # Errors
/// [`CliError::Usage`] if there is none.
pub(super) fn database(data: &Path) -> Result<PathBuf, CliError> {
    let database = Layout::new(data).database();
    if database.is_file() {
        return Ok(database);
    }
    Err(CliError::usage(format!("there is no store in {data:?}"))
        .with_hint("`holdpoint run` makes one; --data DIR names another"))
}

fn list(views: &Views, filter: &AuditFilter, out: &mut Output<'_>) -> Result<(), CliError> {
    let records = views.audit(filter).map_err(CliError::usage)?;
    if out.is_json() {
        return records.iter().try_for_each(|record| out.json(record));
    }
    if records.is_empty() {
        return out.line("no records");
    }
    let mut table = Table::new(&["seq", "time", "kind", "subject", "hash"]);
    for record in &records {
        let time = format!("{:.3} s", record.at_ms as f64 / 1_000.0);
        table.row([
            record.seq.to_string(),
            time,
            record.kind.to_string(),
            record.subject.clone(),
            record.hash.short(),
        ]);
    }
    out.table(&table)
}

fn check(database: &Path, key: Option<&Path>, out: &mut Output<'_>) -> Result<Exit, CliError> {
    if !database.is_file() {
        return Err(CliError::usage(format!("there is no database {database:?}")));
    }
    let key = key.map(keyfile::read_public).transpose().map_err(CliError::usage)?.map(|(key, _)| key);
    match verify(database, key.as_ref()) {
        Ok(report) => {
            out.answer(&serde_json::json!({ "sound": true, "report": report }), |out| sound(&report, out))?;
            Ok(Exit::Confirmed)
        }
        Err(VerifyError::Unreadable(error)) => Err(CliError::usage(error)),
        Err(
            error @ (VerifyError::Damaged(_)
            | VerifyError::Record { .. }
            | VerifyError::State { .. }
            | VerifyError::Invariant(_)
            | VerifyError::Checkpoint { .. }
            | VerifyError::Unsigned(_)
            | VerifyError::Approval { .. }
            | VerifyError::Person { .. }
            | VerifyError::Telemetry { .. }),
        ) => {
            let problem = error.to_string();
            out.answer(&serde_json::json!({ "sound": false, "problem": problem }), |out| {
                out.line(&format!("not sound: {problem}"))
            })?;
            Ok(Exit::Rejected)
        }
    }
}

fn sound(report: &VerifyReport, out: &mut Output<'_>) -> Result<(), CliError> {
    out.line(&format!("sound: {} records, head {}", report.records, report.head))?;
    let signatures =
        if report.key_given { "signatures checked" } else { "signatures not checked: no public key" };
    out.line(&format!("checkpoints        {} ({signatures})", report.checkpoints))?;
    out.line(&format!("approvals          {}", report.approvals))?;
    out.line(&format!(
        "telemetry batches  {} ({} removed for age, {} not looked at)",
        report.batches, report.batches_pruned, report.batches_unseen
    ))?;
    let Some(missing) = report.batches_missing else { return Ok(()) };
    let MissingBatches { first, last, first_sealed_by, last_sealed_by } = missing;
    out.line(&format!(
        "missing batches    {first} to {last}, sealed by the records {first_sealed_by} to {last_sealed_by}: no record says \
         whether for age or by somebody"
    ))
}

fn export_to(views: &Views, from_seq: u64, sink: &mut dyn std::io::Write) -> Result<u64, CliError> {
    views.export(from_seq, sink).map_err(|error| match error {
        ExportError::Write(error) => CliError::from(error),
        error @ (ExportError::Read(_) | ExportError::Json(_)) => CliError::usage(error),
    })
}
