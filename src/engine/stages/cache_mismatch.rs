//! Cached results that differ from their re-run: all are voided, and an alarm is raised.

use holdpoint_governance::alarms::{AlarmKey, Priority};
use holdpoint_governance::cached_result::{CachedResultMismatch, SeedRange};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::notice::Notice;
use holdpoint_governance::record::RecordKind;

use crate::fault::EngineFault;
use crate::recorder::EngineRecorder;
use crate::trial::Trials;
use crate::trial::reuse::Reuse;

/// Records the mismatch of a version's comparison, deletes the cached results, and raises the alarm. The caller
/// restarts the comparison.
///
/// # Errors
/// If it cannot be written.
pub(super) fn void(
    record: &mut EngineRecorder,
    trials: &Trials,
    id: &CapabilityId,
    active: &CapabilityId,
    reuse: &Reuse,
) -> Result<(), EngineFault> {
    let place = trials.cells(record.version_table().store()).place();
    let found = reuse.voided(place, active);
    record.note(RecordKind::KeptVoided, id.to_string(), serde_json::to_string(&found)?)?;
    trials.cells(record.version_table().store()).invalidate()?;
    record.raise(AlarmKey::KeptFalse, Priority::High, true, notice(&found, id));
    Ok(())
}

fn notice(found: &CachedResultMismatch, id: &CapabilityId) -> Notice {
    let CachedResultMismatch { place, active, rerun, differing } = found;
    Notice::CacheMismatch {
        version: id.clone(),
        active: active.clone(),
        place: *place,
        differing: differing.iter().map(|(_, seeds)| SeedRange::count(seeds)).sum(),
        rerun: *rerun,
    }
}
