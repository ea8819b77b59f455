//! The views of the crate `store`, answered from SQLite.

use std::path::PathBuf;

use crate::reading::views::Views;
use holdpoint_approvals::PersonDirectory;
use holdpoint_audit::chain::Head;
use holdpoint_audit::profile_history::ProfileHistory;
use holdpoint_governance::ids::{CapabilityId, Digest, Family};
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::record::{AuditRecord, RecordKind, VersionSummary};
use holdpoint_governance::version_status::RecordedChanges;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_store::{
    AlarmEntry, ApprovalEntry, ApprovalRequest, AuditFilter, EvidenceEntry, EvidenceKind, FamilyStatus,
    RecordTime, RecordViews, StoreError, VersionDetail, VersionFilter, VersionHistory,
};

impl RecordViews for Views {
    fn folder(&self) -> Option<PathBuf> {
        Self::folder(self)
    }

    fn versions(&self, filter: &VersionFilter) -> Result<(Vec<VersionSummary>, usize), StoreError> {
        Self::versions(self, filter)
    }

    fn open_reviews(&self) -> Result<Vec<(CapabilityId, WallTime)>, StoreError> {
        Self::open_reviews(self)
    }

    fn version(&self, id: &CapabilityId) -> Result<Option<VersionDetail>, StoreError> {
        Self::version(self, id)
    }

    fn evidence(
        &self,
        id: &CapabilityId,
        kind: Option<EvidenceKind>,
    ) -> Result<Vec<EvidenceEntry>, StoreError> {
        Self::evidence(self, id, kind)
    }

    fn approvals(&self, id: &CapabilityId) -> Result<Vec<ApprovalEntry>, StoreError> {
        Self::approvals(self, id)
    }

    fn persons(&self) -> Result<PersonDirectory, StoreError> {
        Self::persons(self)
    }

    fn open_requests(&self) -> Result<Vec<ApprovalRequest>, StoreError> {
        Self::open_requests(self)
    }

    fn requested_ms(&self, request: &str) -> Result<Option<u64>, StoreError> {
        Self::requested_ms(self, request)
    }

    fn family_in_order(&self, family: &Family) -> Result<Vec<CapabilityId>, StoreError> {
        Self::family_in_order(self, family)
    }

    fn families(&self) -> Result<Vec<FamilyStatus>, StoreError> {
        Self::families(self)
    }

    fn pointer_robots(&self) -> Result<Vec<(String, String)>, StoreError> {
        Self::pointer_robots(self)
    }

    fn context(&self) -> Result<Option<(ProfileName, Digest, String)>, StoreError> {
        Self::context(self)
    }

    fn profiles(&self) -> Result<ProfileHistory, StoreError> {
        Self::profiles(self)
    }

    fn alarms(&self) -> Result<Vec<AlarmEntry>, StoreError> {
        Self::alarms(self)
    }

    fn version_history(&self, id: &CapabilityId) -> Result<VersionHistory, StoreError> {
        Self::version_history(self, id)
    }

    fn recorded_changes(&self, id: &CapabilityId) -> Result<RecordedChanges, StoreError> {
        Self::recorded_changes(self, id)
    }

    fn audit(&self, filter: &AuditFilter) -> Result<Vec<AuditRecord>, StoreError> {
        Self::audit(self, filter)
    }

    fn each_record(&self, to_seq: u64, visit: &mut dyn FnMut(AuditRecord)) -> Result<(), StoreError> {
        Self::each_record(self, to_seq, visit)
    }

    fn head(&self) -> Result<Head, StoreError> {
        Self::head(self)
    }

    fn stamp(&self, seq: u64) -> Result<Option<RecordTime>, StoreError> {
        Self::stamp(self, seq)
    }

    fn numbers_of(&self, kind: RecordKind, from_seq: u64, before_seq: u64) -> Result<Vec<u64>, StoreError> {
        Self::numbers_of(self, kind, from_seq, before_seq)
    }
}
