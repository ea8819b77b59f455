//! Changes about telemetry: what is sealed, removed and missed enters the chain, and touches no row.

use std::collections::BTreeSet;

use super::apply::{Applier, Touched, check_int};
use super::aside::is_name_of_aside;
use super::change::{ASIDE_MAX, BLOCK_BATCHES_MAX, BatchReceipt, Change, GAPS_MAX};
use super::error::StoreError;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::record::RecordKind;

impl Applier<'_> {
    /// Checks one of these changes; any other is about nothing.
    pub(super) fn about_telemetry(&self, change: &Change) -> Result<Touched, StoreError> {
        match change {
            Change::SealTelemetry { version, batch, rows, .. } => {
                check_int("batch", *batch)?;
                check_int("rows", *rows)?;
                self.version(version)?;
                Ok(Touched::new(RecordKind::TelemetrySealed, version))
            }
            Change::SealTelemetryBlock { batches, .. } => self.seal_block(batches),
            Change::PruneTelemetry { through } => {
                check_int("batch", *through)?;
                Ok(Touched::new(RecordKind::TelemetryPruned, ""))
            }
            Change::MissTelemetry { gaps, aside } => {
                if (gaps.is_empty() && aside.is_empty()) || gaps.len() > GAPS_MAX {
                    return Err(StoreError::invalid("runs of missing batches", gaps.len(), "1 to 64"));
                }
                if aside.len() > ASIDE_MAX || !aside.iter().all(|file| is_name_of_aside(&file.file)) {
                    return Err(StoreError::invalid(
                        "files put aside",
                        aside.len(),
                        "at most 64, by their names",
                    ));
                }
                for [first, last] in gaps {
                    check_int("batch", *last)?;
                    check_int("batch", last.saturating_sub(*first))?;
                }
                Ok(Touched::new(RecordKind::TelemetryMissed, ""))
            }
            _ => Err(StoreError::invalid("change", "another one", "one about telemetry")),
        }
    }

    /// The record is about a version if all of its batches are.
    fn seal_block(&self, batches: &[BatchReceipt]) -> Result<Touched, StoreError> {
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
        Ok(Touched { kind: RecordKind::TelemetryBlockSealed, subject: only.unwrap_or_default() })
    }
}
