//! Read access to a store: the record, and the telemetry. Both show transactions that follow.

use std::collections::BTreeSet;
use std::fmt::Debug;
use std::path::PathBuf;

use crate::change::ApprovalRequest;
use crate::entries::{
    AlarmEntry, ApprovalEntry, AuditFilter, EvidenceEntry, FamilyStatus, PAGE_ROWS_MAX, RecordTime,
    VersionDetail, VersionFilter, VersionHistory,
};
use crate::error::StoreError;
use crate::store_terms::EvidenceKind;
use crate::telemetry_batch::StoredBatch;
use crate::verify_error::VerifyError;
use crate::verify_report::VerifyReport;
use holdpoint_approvals::PersonDirectory;
use holdpoint_audit::chain::Head;
use holdpoint_audit::profile_history::ProfileHistory;
use holdpoint_governance::ids::{CapabilityId, Digest, Family};
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::record::{AuditRecord, RecordKind, VersionSummary};
use holdpoint_governance::version_status::RecordedChanges;
use holdpoint_governance::wall_time::WallTime;

/// Read access to the record of a store.
pub trait RecordViews: Debug + Send {
    /// The folder of the store on this machine, if it has one.
    fn folder(&self) -> Option<PathBuf>;

    /// Versions that pass the filter, by family and semantic version, and how many there are in all.
    ///
    /// # Errors
    /// If the store cannot be read.
    fn versions(&self, filter: &VersionFilter) -> Result<(Vec<VersionSummary>, usize), StoreError>;

    /// Versions that were activated by break-glass and are not reviewed yet, with the deadline of the review.
    ///
    /// # Errors
    /// If the store cannot be read.
    fn open_reviews(&self) -> Result<Vec<(CapabilityId, WallTime)>, StoreError>;

    /// One version in full, `None` if there is none.
    ///
    /// # Errors
    /// If the store cannot be read.
    fn version(&self, id: &CapabilityId) -> Result<Option<VersionDetail>, StoreError>;

    /// Evidence on a version, the newest [`PAGE_ROWS_MAX`] pieces, oldest first; of one kind if one is given.
    ///
    /// # Errors
    /// If the store cannot be read.
    fn evidence(
        &self,
        id: &CapabilityId,
        kind: Option<EvidenceKind>,
    ) -> Result<Vec<EvidenceEntry>, StoreError>;

    /// Decisions about a version, the newest [`PAGE_ROWS_MAX`], oldest first.
    ///
    /// # Errors
    /// If the store cannot be read.
    fn approvals(&self, id: &CapabilityId) -> Result<Vec<ApprovalEntry>, StoreError>;

    /// All persons, revoked ones included: each act is checked again.
    ///
    /// # Errors
    /// If the store cannot be read.
    fn persons(&self) -> Result<PersonDirectory, StoreError>;

    /// Open requests for approval, the most urgent first.
    ///
    /// # Errors
    /// If the store cannot be read.
    fn open_requests(&self) -> Result<Vec<ApprovalRequest>, StoreError>;

    /// When a request for approval was made, the engine's time, ms; `None` if there is none of that id.
    ///
    /// # Errors
    /// If the store cannot be read.
    fn requested_ms(&self, request: &str) -> Result<Option<u64>, StoreError>;

    /// Every version of a family, in the order of registration.
    ///
    /// # Errors
    /// If the store cannot be read.
    fn family_in_order(&self, family: &Family) -> Result<Vec<CapabilityId>, StoreError>;

    /// All families, by name.
    ///
    /// # Errors
    /// If the store cannot be read.
    fn families(&self) -> Result<Vec<FamilyStatus>, StoreError>;

    /// Families whose active pointer names the robot it was set with, and that robot's digest.
    ///
    /// # Errors
    /// If the store cannot be read.
    fn pointer_robots(&self) -> Result<Vec<(String, String)>, StoreError>;

    /// Profile, policy digest and content of the present context; `None` before the first.
    ///
    /// # Errors
    /// If the store cannot be read.
    fn context(&self) -> Result<Option<(ProfileName, Digest, String)>, StoreError>;

    /// The history of the profiles from the records, unchecked.
    ///
    /// # Errors
    /// If the store cannot be read.
    fn profiles(&self) -> Result<ProfileHistory, StoreError>;

    /// Alarms as they stand, the last changed first.
    ///
    /// # Errors
    /// If the store cannot be read.
    fn alarms(&self) -> Result<Vec<AlarmEntry>, StoreError>;

    /// The history of a version's state, by the audit chain.
    ///
    /// # Errors
    /// If the store cannot be read.
    fn version_history(&self, id: &CapabilityId) -> Result<VersionHistory, StoreError>;

    /// What is on record of a version's present state.
    ///
    /// # Errors
    /// If the store cannot be read.
    fn recorded_changes(&self, id: &CapabilityId) -> Result<RecordedChanges, StoreError>;

    /// Audit records that pass the filter. The cost depends on the number of returned rows.
    ///
    /// # Errors
    /// If the store cannot be read.
    fn audit(&self, filter: &AuditFilter) -> Result<Vec<AuditRecord>, StoreError>;

    /// Every audit record that passes the filter, oldest first, read page by page. The filter's limit and order do not count.
    ///
    /// # Errors
    /// If the store cannot be read.
    fn whole_audit(&self, filter: &AuditFilter) -> Result<Vec<AuditRecord>, StoreError> {
        let mut all = Vec::new();
        let mut rest = AuditFilter { limit: PAGE_ROWS_MAX, newest_first: false, ..filter.clone() };
        loop {
            let page = self.audit(&rest)?;
            let is_last = page.len() < PAGE_ROWS_MAX;
            rest.from_seq = page.last().map_or(rest.from_seq, |record| record.seq.saturating_add(1));
            all.extend(page);
            if is_last {
                return Ok(all);
            }
        }
    }

    /// Calls `visit` with each record of the chain up to `to_seq`, in order, one at a time.
    ///
    /// # Errors
    /// If the store cannot be read.
    fn each_record(&self, to_seq: u64, visit: &mut dyn FnMut(AuditRecord)) -> Result<(), StoreError>;

    /// The end of the chain.
    ///
    /// # Errors
    /// If the store cannot be read.
    fn head(&self) -> Result<Head, StoreError>;

    /// The stamp of a record; `None` if there is none of that number.
    ///
    /// # Errors
    /// If the store cannot be read.
    fn stamp(&self, seq: u64) -> Result<Option<RecordTime>, StoreError>;

    /// Numbers of the records of a kind, of those from `from_seq` on and before `before_seq`, in order.
    ///
    /// # Errors
    /// If the store cannot be read.
    fn numbers_of(&self, kind: RecordKind, from_seq: u64, before_seq: u64) -> Result<Vec<u64>, StoreError>;
}

/// Read access to the telemetry of a store.
pub trait TelemetryReader: Debug + Send {
    /// Calls `visit` with each batch up to the number `to_batch`, in order, one at a time.
    ///
    /// # Errors
    /// If the telemetry cannot be read.
    fn each_batch(&self, to_batch: u64, visit: &mut dyn FnMut(StoredBatch)) -> Result<(), StoreError>;

    /// Calls `visit` with each batch of two streams, from the first number of `span` to the last, in order, one at a time.
    ///
    /// # Errors
    /// If the telemetry cannot be read.
    fn each_of_streams(
        &self,
        streams: [&str; 2],
        span: (u64, u64),
        visit: &mut dyn FnMut(StoredBatch),
    ) -> Result<(), StoreError>;

    /// Calls `visit` with each of these numbers that has a batch.
    ///
    /// # Errors
    /// If the telemetry cannot be read.
    fn each_of(&self, numbers: &[u64], visit: &mut dyn FnMut(u64)) -> Result<(), StoreError>;

    /// The number of the oldest batch; `None` without one.
    ///
    /// # Errors
    /// If the telemetry cannot be read.
    fn oldest(&self) -> Result<Option<u64>, StoreError>;

    /// The numbers of all batches.
    ///
    /// # Errors
    /// If the telemetry cannot be read.
    fn numbers(&self) -> Result<BTreeSet<u64>, StoreError>;
}

/// Read access to a store beside its writer, also from other threads. Each call opens what it returns.
pub trait ReadableStore: Debug + Send + Sync {
    /// The record.
    ///
    /// # Errors
    /// If the store cannot be read.
    fn views(&self) -> Result<Box<dyn RecordViews>, StoreError>;

    /// The telemetry; `None` if there is none.
    ///
    /// # Errors
    /// If it cannot be read.
    fn telemetry(&self) -> Result<Option<Box<dyn TelemetryReader>>, StoreError>;

    /// Verifies the whole history, what the store has against it, and the sealed telemetry.
    ///
    /// # Errors
    /// The first problem.
    fn verify(&self) -> Result<VerifyReport, VerifyError>;
}
