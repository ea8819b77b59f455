//! `holdpoint audit`: lists, verifies and exports the chain, proves things of it, and names its witnesses. All but the
//! last read only; an engine may have the store open meanwhile.

use std::fs::OpenOptions;
use std::path::PathBuf;

use clap::{Args, Subcommand};

use super::data;
use super::output::Table;
use super::proof::{self, CheckProofArgs, ConsistencyArgs, ProofArgs};
use super::verify::{self, VerifyArgs};
use super::witness::{self, WitnessArgs};
use crate::cli::context::CliContext;
use crate::cli::output::Output;
use crate::error::{CliError, Exit};
use holdpoint_governance::record::RecordKind;
use holdpoint_registry::{AuditFilter, ExportError, Views};

/// The most records `list` prints.
pub const LIST_MAX: u32 = 10_000;

/// The arguments of `audit`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint audit list --subject grasp@1.3.0
  holdpoint audit list --kind shift-note
  holdpoint audit verify --all
  holdpoint audit proof 120 --out record-120.json
  holdpoint audit witness add /mnt/witness
  holdpoint audit export --out audit.jsonl")]
pub struct AuditArgs {
    /// The verb that was given, with its arguments.
    #[command(subcommand)]
    pub verb: AuditVerb,
}

/// What can be done with the audit log.
#[derive(Clone, Debug, PartialEq, Eq, Subcommand)]
pub enum AuditVerb {
    /// Lists records, the newest first: all but the seals of telemetry, which are the most by far.
    #[command(after_help = "\
Examples:
  holdpoint audit list --subject grasp@1.3.0 --limit 20
  holdpoint audit list --kind shift-note
  holdpoint audit list --all")]
    List {
        /// About exactly this family or version only.
        #[arg(long, value_name = "FAMILY[@VERSION]")]
        subject: Option<String>,
        /// Of this kind only.
        #[arg(long)]
        kind: Option<RecordKind>,
        /// The seals of telemetry as well.
        #[arg(long, conflicts_with = "kind")]
        all: bool,
        /// How many at most.
        #[arg(long, value_name = "N", default_value_t = 50,
              value_parser = clap::value_parser!(u32).range(1..=i64::from(LIST_MAX)))]
        limit: u32,
    },
    /// Verifies the whole history and names the first thing that is bad. Ends with 1 if there is one.
    #[command(after_help = "\
Without a copy kept elsewhere nobody can tell that a whole store was put back to an earlier state: --against
takes such copies, and the store's witnesses are asked by themselves.

Examples:
  holdpoint audit verify --all
  holdpoint audit verify --against /mnt/backup/checkpoints
  holdpoint audit verify --file copy/holdpoint.db --key store.pub
  holdpoint audit verify --file store.jsonl --key store.pub")]
    Verify(VerifyArgs),
    /// Proves that a record is in the chain, by a file that is checked without the store.
    #[command(after_help = "\
Example:
  holdpoint audit proof 120 --out record-120.json")]
    Proof(ProofArgs),
    /// Proves that the chain goes on from an earlier checkpoint, by a file that is checked without the store.
    #[command(after_help = "\
Examples:
  holdpoint audit consistency --from 256
  holdpoint audit consistency --against kept/000000000256.json --out consistency.json")]
    Consistency(ConsistencyArgs),
    /// Checks a proof with the store's public key alone. Ends with 1 if it does not hold.
    #[command(after_help = "\
Example:
  holdpoint audit check-proof record-120.json --public-key store.pub")]
    CheckProof(CheckProofArgs),
    /// Adds, lists and removes witnesses: folders elsewhere that get every checkpoint.
    #[command(after_help = "\
Examples:
  holdpoint audit witness add /mnt/witness
  holdpoint audit witness list")]
    Witness(WitnessArgs),
    /// Writes the records as JSON lines, if they are what was signed.
    #[command(after_help = "\
Example:
  holdpoint audit export --from 100 --out audit.jsonl")]
    Export {
        /// From this record on.
        #[arg(long, value_name = "SEQ", default_value_t = 1)]
        from: u64,
        /// Also where they are not what was signed: as they lie there, for whoever looks into a damaged store.
        #[arg(long)]
        unchecked: bool,
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
    match &args.verb {
        AuditVerb::List { subject, kind, all, limit } => {
            let seals = RecordKind::SEALS.into_iter().filter(|_| kind.is_none() && !all);
            let filter = AuditFilter {
                from_seq: 0,
                before_seq: None,
                kind: *kind,
                without: seals.collect(),
                subject: subject.clone(),
                limit: *limit as usize,
                newest_first: true,
            };
            list(&data::open(&context.data)?, &filter, out)?;
        }
        AuditVerb::Verify(args) => return verify::run(context, args, out),
        AuditVerb::Proof(args) => return proof::record(context, args, out),
        AuditVerb::Consistency(args) => return proof::consistency(context, args, out),
        AuditVerb::CheckProof(args) => return proof::check(context, args, out),
        AuditVerb::Witness(args) => return witness::run(context, args, out),
        AuditVerb::Export { from, unchecked, out: None } => {
            export_to(&records_of(context, *unchecked)?, *from, out.sink())?;
        }
        AuditVerb::Export { from, unchecked, out: Some(path) } => {
            let views = records_of(context, *unchecked)?;
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

/// Where records are read from to be written out.
fn records_of(context: &CliContext, unchecked: bool) -> Result<Views, CliError> {
    if unchecked {
        return data::open(&context.data);
    }
    data::open_records(&context.data).map_err(|error| {
        error.with_hint(
            "`holdpoint audit verify` says what is wrong; --unchecked writes the records as they lie there",
        )
    })
}

fn list(views: &Views, filter: &AuditFilter, out: &mut Output<'_>) -> Result<(), CliError> {
    let records = views.audit(filter).map_err(CliError::usage)?;
    if out.is_json() {
        return records.iter().try_for_each(|record| out.json(record));
    }
    let rest = |out: &mut Output<'_>| {
        if filter.without.is_empty() {
            return Ok(());
        }
        out.line("seals of telemetry are left out; --all lists them too")
    };
    if records.is_empty() {
        out.line("no records")?;
        return rest(out);
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
    out.table(&table)?;
    rest(out)
}

fn export_to(views: &Views, from_seq: u64, sink: &mut dyn std::io::Write) -> Result<u64, CliError> {
    views.export(from_seq, sink).map_err(|error| match error {
        ExportError::Write(error) => CliError::from(error),
        error @ (ExportError::Read(_) | ExportError::Store(_) | ExportError::Json(_)) => {
            CliError::usage(error)
        }
    })
}
