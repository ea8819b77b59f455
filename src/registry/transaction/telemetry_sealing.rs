//! Changes about telemetry: sealed, removed and missing batches enter the chain, and touch no row.

use std::collections::BTreeSet;

use crate::telemetry::telemetry_quarantine::is_quarantine_name;
use crate::transaction::apply::{Applier, ChangeEffect, check_int};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::record::RecordKind;
use holdpoint_store::{BLOCK_BATCHES_MAX, BatchReceipt, Change, GAPS_MAX, QUARANTINED_MAX, StoreError};

impl Applier<'_> {
    /// Checks one of these changes; any other is about nothing.
    pub(crate) fn about_telemetry(&self, change: &Change) -> Result<ChangeEffect, StoreError> {
        match change {
            Change::SealTelemetry { version, batch, rows, .. } => {
                check_int("batch", *batch)?;
                check_int("rows", *rows)?;
                self.version(version)?;
                Ok(ChangeEffect::new(RecordKind::TelemetrySealed, version))
            }
            Change::SealTelemetryBlock { batches, .. } => self.seal_block(batches),
            Change::PruneTelemetry { through } => {
                check_int("batch", *through)?;
                Ok(ChangeEffect::new(RecordKind::TelemetryPruned, ""))
            }
            Change::MissTelemetry { gaps, aside } => {
                if (gaps.is_empty() && aside.is_empty()) || gaps.len() > GAPS_MAX {
                    return Err(StoreError::invalid("runs of missing batches", gaps.len(), "1 to 64"));
                }
                if aside.len() > QUARANTINED_MAX || !aside.iter().all(|file| is_quarantine_name(&file.file)) {
                    return Err(StoreError::invalid(
                        "quarantined files",
                        aside.len(),
                        "at most 64, by their names",
                    ));
                }
                for [first, last] in gaps {
                    check_int("batch", *last)?;
                    check_int("batch", last.saturating_sub(*first))?;
                }
                Ok(ChangeEffect::new(RecordKind::TelemetryMissed, ""))
            }
            _ => Err(StoreError::invalid("change", "another one", "one about telemetry")),
        }
    }

    /// The record is about a version if all of its batches are.
    fn seal_block(&self, batches: &[BatchReceipt]) -> Result<ChangeEffect, StoreError> {
        if batches.is_empty() || batches.len() > BLOCK_BATCHES_MAX {
            return Err(StoreError::invalid("block of batches", batches.len(), "1 to 64"));
        }
        let versions: BTreeSet<&CapabilityId> = batches.iter().map(|batch| &batch.version).collect();
        for version in &versions {
            self.version(version)?;
        }
        for batch in batches {
            check_int("batch", batch.batch)?;
            check_int("rows", batch.rows)?;
        }
        let only = versions.first().filter(|_| versions.len() == 1).map(ToString::to_string);
        Ok(ChangeEffect { kind: RecordKind::TelemetryBlockSealed, subject: only.unwrap_or_default() })
    }
}
