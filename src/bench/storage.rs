//! The store: a commit with its audit record on disk, and verifying a chain.
//!
//! Works on a scratch store in the temporary folder, which is removed; the operator's store is never opened. What
//! a commit costs is what that folder's disk takes to flush.

use super::BenchError;
use super::measure::{Figure, FigureClock, FigureEffort, FigureUnit, MeasuredFigure};
use holdpoint_registry::{Store, verify};
use holdpoint_store::{AuditBody, Transaction};
use holdpoint_wording::program::bench as names;

/// Length of a record's body, bytes: about what a stage's decision has.
const BODY_BYTES: usize = 1024;

/// Records written in one transaction while the chain is filled; the store takes up to 256.
const RECORDS_AT_ONCE: u64 = 250;

/// The records the figure of verification is given for.
const PER_RECORDS: f64 = 10_000.0;

pub(super) fn measure(effort: &FigureEffort) -> Result<Vec<MeasuredFigure>, BenchError> {
    let folder = tempfile::tempdir()?;
    let store = Store::open(folder.path())?;
    let commit = Figure::new(names::AUDIT_COMMIT, FigureUnit::Micros, FigureClock::Wall, "commit");
    let commit = commit.take(effort, effort.fast_secs, |call| {
        store.commit(transaction(format!("one {call}"), 1))?;
        Ok(Some(1))
    })?;
    let mut left = effort.audit_records;
    while left > 0 {
        let records = left.min(RECORDS_AT_ONCE);
        store.commit(transaction(format!("fill {left}"), records))?;
        left -= records;
    }
    let database = store.layout().database();
    let verified = verify(&database, Some(store.public_key()))?;
    if verified.records < effort.audit_records {
        return Err(BenchError::Unexpected {
            what: "audit verification",
            found: format!("{} records", verified.records),
            expected: "every record that was written",
        });
    }
    // Counted in ten-thousands of records, so that the figure is for that many whatever the chain has.
    let share = verified.records as f64 / PER_RECORDS;
    let name = names::audit_verification(verified.records);
    let mut samples = Vec::new();
    let begin = FigureClock::Wall.secs();
    while samples.len() < effort.samples_max {
        let before = FigureClock::ThreadCpu.secs();
        verify(&database, Some(store.public_key()))?;
        samples.push((FigureClock::ThreadCpu.secs() - before) / share);
        if samples.len() >= effort.samples_min && FigureClock::Wall.secs() - begin >= effort.fast_secs {
            break;
        }
    }
    let figure = Figure::new(name, FigureUnit::Millis, FigureClock::ThreadCpu, "verification");
    Ok(vec![commit, figure.of(samples, effort.samples_min)?])
}

/// So many records and nothing else.
fn transaction(command_id: String, records: u64) -> Transaction {
    let body = AuditBody {
        kind: holdpoint_governance::record::RecordKind::Decision,
        subject: "align@1.1.0".to_owned(),
        body: format!("\"{}\"", "x".repeat(BODY_BYTES)),
    };
    let audit = (0..records).map(|_| body.clone()).collect();
    Transaction { command_id, at_ms: 1, wall_ms: 0, changes: Vec::new(), audit }
}
