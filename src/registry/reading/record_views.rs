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

/// Each call is the method of the same name.
macro_rules! forward {
    ($($name:ident($($argument:ident: $type:ty),*) -> $result:ty;)*) => {
        $(fn $name(&self, $($argument: $type),*) -> $result {
            Self::$name(self, $($argument),*)
        })*
    };
}

pub(crate) use forward;

impl RecordViews for Views {
    forward! {
        folder() -> Option<PathBuf>;
        versions(filter: &VersionFilter) -> Result<(Vec<VersionSummary>, usize), StoreError>;
        open_reviews() -> Result<Vec<(CapabilityId, WallTime)>, StoreError>;
        version(id: &CapabilityId) -> Result<Option<VersionDetail>, StoreError>;
        evidence(id: &CapabilityId, kind: Option<EvidenceKind>) -> Result<Vec<EvidenceEntry>, StoreError>;
        approvals(id: &CapabilityId) -> Result<Vec<ApprovalEntry>, StoreError>;
        persons() -> Result<PersonDirectory, StoreError>;
        open_requests() -> Result<Vec<ApprovalRequest>, StoreError>;
        requested_ms(request: &str) -> Result<Option<u64>, StoreError>;
        family_in_order(family: &Family) -> Result<Vec<CapabilityId>, StoreError>;
        families() -> Result<Vec<FamilyStatus>, StoreError>;
        pointer_robots() -> Result<Vec<(String, String)>, StoreError>;
        context() -> Result<Option<(ProfileName, Digest, String)>, StoreError>;
        profiles() -> Result<ProfileHistory, StoreError>;
        alarms() -> Result<Vec<AlarmEntry>, StoreError>;
        version_history(id: &CapabilityId) -> Result<VersionHistory, StoreError>;
        recorded_changes(id: &CapabilityId) -> Result<RecordedChanges, StoreError>;
        audit(filter: &AuditFilter) -> Result<Vec<AuditRecord>, StoreError>;
        each_record(to_seq: u64, visit: &mut dyn FnMut(AuditRecord)) -> Result<(), StoreError>;
        head() -> Result<Head, StoreError>;
        stamp(seq: u64) -> Result<Option<RecordTime>, StoreError>;
        numbers_of(kind: RecordKind, from_seq: u64, before_seq: u64) -> Result<Vec<u64>, StoreError>;
    }
}
