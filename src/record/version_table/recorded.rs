//! What is on record of the present state of each version, kept up with the record.
//!
//! Reads back each record that may change it. A record that cannot be read explains nothing, and stops nothing.

use std::collections::BTreeMap;

use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::version_status::RecordedChanges;
use holdpoint_store::{AuditBody, AuditFilter, Change, Receipt, RecordViews, StoreError};

use super::VersionTable;

/// What is on record of these versions.
pub(super) fn of_all(
    views: &dyn RecordViews,
    ids: impl Iterator<Item = CapabilityId>,
) -> Result<BTreeMap<CapabilityId, RecordedChanges>, StoreError> {
    ids.map(|id| views.recorded_changes(&id).map(|changes| (id, changes))).collect()
}

/// Whether a transaction has a record that a status rests on.
pub(super) fn changes_status(changes: &[Change], audit: &[AuditBody]) -> bool {
    let is_one = |change: &Change| {
        matches!(
            change,
            Change::RegisterVersion(_)
                | Change::SetState { .. }
                | Change::SetFlags { .. }
                | Change::PutApprovalRequest(_)
        )
    };
    changes.iter().any(is_one) || audit.iter().any(|body| RecordedChanges::reads(body.kind))
}

impl VersionTable {
    /// What is on record of the present state of a version; absent if there is no such version.
    #[must_use]
    pub fn recorded_changes(&self, id: &CapabilityId) -> Option<&RecordedChanges> {
        self.recorded.get(id)
    }

    /// Takes in the records of a transaction.
    pub(super) fn note_records(&mut self, receipt: &Receipt) {
        if receipt.first_seq == 0 {
            return;
        }
        let filter = AuditFilter { from_seq: receipt.first_seq, ..AuditFilter::default() };
        let Ok(records) = self.store.views().and_then(|views| views.audit(&filter)) else { return };
        for record in records {
            if let Ok(version) = record.subject.parse::<CapabilityId>() {
                self.recorded.entry(version).or_default().note(&record);
            }
        }
    }
}
