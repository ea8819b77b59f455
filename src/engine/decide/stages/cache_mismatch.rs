//! Cached results that differ from their re-run: the engine deletes the cache and raises an alarm.

use holdpoint_governance::alarms::{AlarmKey, Priority};
use holdpoint_governance::cached_result::{CachedResultMismatch, SeedRange};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::notice::Notice;
use holdpoint_governance::record::RecordKind;
use holdpoint_trials::Trials;
use holdpoint_trials::reuse::Reuse;

use crate::decide::recorder::EngineRecorder;
use crate::fault::EngineFault;

/// Records the mismatch of a version's comparison, deletes the cached results, and raises the alarm. The caller
/// restarts the comparison.
///
/// # Errors
/// If it cannot be written.
pub(super) fn invalidate_cache(
    record: &mut EngineRecorder,
    trials: &Trials,
    id: &CapabilityId,
    active: &CapabilityId,
    reuse: &Reuse,
) -> Result<(), EngineFault> {
    let place = trials.result_cache(record.version_table().store()).place();
    let mismatch = reuse.mismatch_record(place, active);
    record.note(RecordKind::KeptVoided, id.to_string(), serde_json::to_string(&mismatch)?)?;
    trials.result_cache(record.version_table().store()).invalidate()?;
    record.raise(AlarmKey::KeptFalse, Priority::High, true, notice(&mismatch, id));
    Ok(())
}

fn notice(mismatch: &CachedResultMismatch, id: &CapabilityId) -> Notice {
    let CachedResultMismatch { place, active, rerun, differing } = mismatch;
    Notice::CacheMismatch {
        version: id.clone(),
        active: active.clone(),
        place: *place,
        differing: differing.iter().map(|(_, seeds)| SeedRange::count(seeds)).sum(),
        rerun: *rerun,
    }
}
