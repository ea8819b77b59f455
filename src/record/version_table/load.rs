//! Versions as the store has them, loaded and compared with their digests.

use holdpoint_governance::ids::{CapabilityId, Family};
use holdpoint_runtime::capability::Capability;
use holdpoint_store::RecordViews;

use super::{StoredPackage, VersionEntry, VersionTableError};

/// Loads every version of a family from the store, in registration order, and checks its digest.
pub(super) fn load_members(
    views: &dyn RecordViews,
    family: &Family,
) -> Result<Vec<VersionEntry>, VersionTableError> {
    let ids = views.family_in_order(family)?;
    ids.iter().filter_map(|id| load_member(views, id).transpose()).collect()
}

/// Loads one version from the store and checks its digest.
///
/// # Errors
/// If it cannot be read, does not load, or its digest differs.
pub fn load_member(
    views: &dyn RecordViews,
    id: &CapabilityId,
) -> Result<Option<VersionEntry>, VersionTableError> {
    let Some(detail) = views.version(id)? else { return Ok(None) };
    let stored: StoredPackage = serde_json::from_str(&detail.submission)
        .map_err(|source| VersionTableError::Record { what: "package", of: id.to_string(), source })?;
    let capability = Capability::load(&id.to_string(), stored.package)
        .map_err(|source| VersionTableError::Load { id: id.clone(), source })?;
    if capability.digest() != detail.candidate_digest {
        return Err(VersionTableError::DigestDiffers {
            id: id.clone(),
            found: capability.digest(),
            recorded: detail.candidate_digest,
        });
    }
    let course = views.version_history(id)?;
    let origin = stored.origin;
    Ok(Some(VersionEntry { capability, origin, row_version: detail.summary.row_version, course }))
}
