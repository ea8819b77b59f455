//! `holdpoint audit`: lists, verifies and exports the chain, re-runs evaluations, writes proofs, and manages witnesses. Only the witness
//! verbs write; an engine may have the store open meanwhile.

use std::fs::OpenOptions;
use std::path::PathBuf;

use clap::{Args, Subcommand};

use super::audit_proof::{self, CheckProofArgs, ConsistencyArgs, ProofArgs};
use super::data;
use super::metrics::SinceArg;
use super::output::TextTable;
use super::rerun::{self, RerunArgs};
use super::time_arg::when_help;
use super::verify::{self, VerifyArgs};
use super::witness::{self, WitnessArgs};
use crate::cli::context::CliContext;
use crate::cli::output::CommandOutput;
use crate::error::{CliError, Exit};
use holdpoint_governance::record::RecordKind;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_registry::{ExportError, Views};
use holdpoint_store::AuditFilter;
use holdpoint_wording::program::audit as sentences;

/// The most records `list` prints.
pub const LIST_MAX: u32 = 10_000;

/// The arguments of `audit`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint audit list --subject grasp@1.3.0
  holdpoint audit list --kind shift-note
  holdpoint audit verify --all
  holdpoint audit rerun --most 3
  holdpoint audit proof 120 --out record-120.json
  holdpoint audit witness add /mnt/witness
  holdpoint audit export --out audit.jsonl")]
pub struct AuditArgs {
    /// The verb with its arguments.
    #[command(subcommand)]
    pub verb: AuditVerb,
}

/// The verbs of `audit`.
#[derive(Clone, Debug, PartialEq, Eq, Subcommand)]
pub enum AuditVerb {
    /// Lists records, newest first. Omits telemetry digests, which are most of the records, unless --all is given.
    #[command(after_help = concat!(
        when_help!(),
        "  a record: #120

Examples:
  holdpoint audit list --subject grasp@1.3.0 --limit 20
  holdpoint audit list --kind shift-note --since 24h
  holdpoint audit list --all"
    ))]
    List {
        /// Only records about exactly this family or version.
        #[arg(long, value_name = "FAMILY[@VERSION]")]
        subject: Option<String>,
        /// Only records of this kind.
        #[arg(long)]
        kind: Option<RecordKind>,
        /// Includes telemetry digests.
        #[arg(long, conflicts_with = "kind")]
        all: bool,
        /// Only records since then [default: all].
        #[arg(long, value_name = "WHEN")]
        since: Option<SinceArg>,
        /// The largest number of records.
        #[arg(long, value_name = "N", default_value_t = 50,
              value_parser = clap::value_parser!(u32).range(1..=i64::from(LIST_MAX)))]
        limit: u32,
    },
    /// Verifies the whole history and reports the first error. Exits with 1 if there is one.
    #[command(after_help = "\
Only a copy kept elsewhere can show that the whole store was restored from an older copy.
--against names such copies; the store's witnesses are always read.

Examples:
  holdpoint audit verify --all
  holdpoint audit verify --against /mnt/backup/checkpoints
  holdpoint audit verify --file copy/holdpoint.db --key store.pub
  holdpoint audit verify --file store.jsonl --key store.pub")]
    Verify(VerifyArgs),
    /// Runs every closed evaluation again from its revealed key, and compares results and decisions with the record.
    #[command(after_help = "\
A copy of the store without its secret keys is enough, on any machine with the same build: `holdpoint store
backup` makes one. `holdpoint audit verify` checks signatures and keys; this verb checks the numbers.

Exits with 0 if every decision is the same, 1 if one differs, 3 if one could not be made again, and 5 if the
store has no decision.

Examples:
  holdpoint audit rerun
  holdpoint audit rerun --data /mnt/backup/2026-11-22 --most 3 --json")]
    Rerun(RerunArgs),
    /// Writes a proof that a record is in the chain; it can be checked without the store.
    #[command(after_help = "\
Example:
  holdpoint audit proof 120 --out record-120.json")]
    Proof(ProofArgs),
    /// Writes a proof that the chain extends an earlier checkpoint; it can be checked without the store.
    #[command(after_help = "\
Examples:
  holdpoint audit consistency --from 256
  holdpoint audit consistency --against kept/000000000256.json --out consistency.json")]
    Consistency(ConsistencyArgs),
    /// Checks a proof with only the store's public key. Exits with 1 if the proof fails.
    #[command(after_help = "\
Example:
  holdpoint audit check-proof record-120.json --public-key store.pub")]
    CheckProof(CheckProofArgs),
    /// Adds, lists and removes witnesses: folders elsewhere that receive each checkpoint.
    #[command(after_help = "\
Examples:
  holdpoint audit witness add /mnt/witness
  holdpoint audit witness list")]
    Witness(WitnessArgs),
    /// Writes the records as JSON lines after it verifies them.
    #[command(after_help = "\
Example:
  holdpoint audit export --from 100 --out audit.jsonl")]
    Export {
        /// The first record to write.
        #[arg(long, value_name = "SEQ", default_value_t = 1)]
        from: u64,
        /// Writes records that fail verification, too, unchanged, to inspect a damaged store.
        #[arg(long)]
        unchecked: bool,
        /// The file to create [default: the standard output].
        #[arg(long, value_name = "FILE")]
        out: Option<PathBuf>,
    },
}

/// Runs the verb.
///
/// # Errors
/// [`CliError`].
pub fn run(context: &CliContext, args: &AuditArgs, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    match &args.verb {
        AuditVerb::List { subject, kind, all, since, limit } => {
            let views = data::open(&context.data)?;
            let first = since.as_ref().map(|since| since.first_record(&views)).transpose()?;
            let seals = RecordKind::SEALS.into_iter().filter(|_| kind.is_none() && !all);
            let filter = AuditFilter {
                from_seq: first.unwrap_or(0),
                before_seq: None,
                kind: *kind,
                without: seals.collect(),
                subject: subject.clone(),
                limit: *limit as usize,
                newest_first: true,
            };
            list(&views, &filter, out)?;
        }
        AuditVerb::Verify(args) => return verify::run(context, args, out),
        AuditVerb::Rerun(args) => return rerun::run(context, args, out),
        AuditVerb::Proof(args) => return audit_proof::record(context, args, out),
        AuditVerb::Consistency(args) => return audit_proof::consistency(context, args, out),
        AuditVerb::CheckProof(args) => return audit_proof::check(context, args, out),
        AuditVerb::Witness(args) => return witness::run(context, args, out),
        AuditVerb::Export { from, unchecked, out: None } => {
            export_to(&records_of(context, *unchecked)?, *from, out.sink())?;
        }
        AuditVerb::Export { from, unchecked, out: Some(path) } => {
            let views = records_of(context, *unchecked)?;
            let cannot = |error: std::io::Error| {
                CliError::usage(format!("cannot write {path:?}: {error}")).with_unwritable(path, &error)
            };
            let mut file = OpenOptions::new().write(true).create_new(true).open(path).map_err(cannot)?;
            let records = export_to(&views, *from, &mut file)?;
            file.sync_all().map_err(cannot)?;
            out.answer(
                &serde_json::json!({ "records": records, "file": path.display().to_string() }),
                |out| out.line(&sentences::exported(records, path.display())),
            )?;
        }
    }
    Ok(Exit::Confirmed)
}

/// The source of the exported records.
fn records_of(context: &CliContext, unchecked: bool) -> Result<Views, CliError> {
    if unchecked {
        return data::open(&context.data);
    }
    data::open_records(&context.data).map_err(|error| {
        error.with_hint(
            "`holdpoint audit verify` shows the error; --unchecked writes the records without verification",
        )
    })
}

fn list(views: &Views, filter: &AuditFilter, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    let records = views.audit(filter).map_err(CliError::usage)?;
    if out.is_json() {
        return records.iter().try_for_each(|record| out.json(record));
    }
    let rest = |out: &mut CommandOutput<'_>| {
        if filter.without.is_empty() {
            return Ok(());
        }
        out.line(sentences::DIGESTS_OMITTED)
    };
    if records.is_empty() {
        out.line(sentences::NO_RECORDS)?;
        return rest(out);
    }
    let mut table = TextTable::new(&["seq", "time", "kind", "subject", "hash"]);
    for record in &records {
        table.row([
            record.seq.to_string(),
            moment(record.at_ms, record.wall()),
            record.kind.to_string(),
            record.subject.clone(),
            record.hash.short(),
        ]);
    }
    out.table(&table)?;
    rest(out)
}

/// When a record was written, for people: in scripts, which have no wall time, the engine's time to the millisecond.
pub(super) fn moment(at_ms: u64, wall: Option<WallTime>) -> String {
    wall.map_or_else(|| format!("{:.3} s", at_ms as f64 / 1_000.0), WallTime::label)
}

fn export_to(views: &Views, from_seq: u64, sink: &mut dyn std::io::Write) -> Result<u64, CliError> {
    views.export(from_seq, sink).map_err(export_error)
}

/// An export to the standard output failed: its reader may be gone.
pub(super) fn export_error(error: ExportError) -> CliError {
    match error {
        ExportError::Write(error) => CliError::from(error),
        error @ (ExportError::Read(_) | ExportError::Store(_) | ExportError::Json(_)) => {
            CliError::usage(error)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Engine seconds alone did not tell when something happened.
    #[test]
    fn a_record_has_its_wall_time_where_it_is_known() {
        let wall = WallTime::from_ms(1_795_501_000_000);
        assert_eq!(moment(5_250, Some(wall)), wall.label());
        assert_eq!(moment(5_250, None), "5.250 s");
    }
}
