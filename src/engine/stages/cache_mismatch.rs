//! Cached results that differ from their re-run: all are voided, and an alarm is raised.

use holdpoint_governance::alarms::{AlarmKey, Priority};
use holdpoint_governance::cached_result::{CacheLocation, CachedResultMismatch, SeedRange};
use holdpoint_governance::ids::CapabilityId;
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
    record.raise(AlarmKey::KeptFalse, Priority::High, true, &text(&found, id));
    Ok(())
}

fn text(found: &CachedResultMismatch, id: &CapabilityId) -> String {
    let CachedResultMismatch { place, active, rerun, differing } = found;
    let count: u64 = differing.iter().map(|(_, seeds)| SeedRange::count(seeds)).sum();
    let (done, who) = match place {
        CacheLocation::Store => (
            "every cached result of the store was deleted",
            "find out who writes to the store's telemetry.db and reads its keys",
        ),
        CacheLocation::Folder => (
            "the shared folder is not used again by this run",
            "find out who writes to the folder and reads its key file, then delete both",
        ),
    };
    format!(
        "{count} of {rerun} cached results of {active} differ from their re-run for {id}: a user with the key \
         falsified them, or this machine computes other results than the one that cached them; {done}, and the \
         comparison runs every episode; {who}"
    )
}
