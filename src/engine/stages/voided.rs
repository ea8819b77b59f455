//! Kept results that came out otherwise when they were run again: none of them counts any more, and somebody is told.

use holdpoint_governance::alarms::{AlarmKey, Priority};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::kept::{KeptPlace, KeptVoid, SeedRange};
use holdpoint_governance::record::RecordKind;

use crate::fault::Fault;
use crate::record::Record;
use crate::trial::Trials;
use crate::trial::reuse::Reuse;

/// Puts on record what was found for a version's comparison, throws away what was kept, and raises the alarm. Whoever
/// calls begins the comparison again.
///
/// # Errors
/// If it cannot be written.
pub(super) fn void(
    record: &mut Record,
    trials: &Trials,
    id: &CapabilityId,
    active: &CapabilityId,
    reuse: &Reuse,
) -> Result<(), Fault> {
    let place = trials.cells(record.ledger().store()).place();
    let found = reuse.voided(place, active);
    record.note(RecordKind::KeptVoided, id.to_string(), serde_json::to_string(&found)?)?;
    trials.cells(record.ledger().store()).void()?;
    record.raise(AlarmKey::KeptFalse, Priority::High, true, &text(&found, id));
    Ok(())
}

fn text(found: &KeptVoid, id: &CapabilityId) -> String {
    let KeptVoid { place, active, rerun, differing } = found;
    let count: u64 = differing.iter().map(|(_, seeds)| SeedRange::count(seeds)).sum();
    let (done, who) = match place {
        KeptPlace::Store => (
            "everything the store kept was thrown away",
            "find out who writes to the store's telemetry.db and reads its keys",
        ),
        KeptPlace::Folder => (
            "the shared folder is not used again by this run",
            "find out who writes to the folder and reads its key file, then delete both",
        ),
    };
    format!(
        "{count} of {rerun} kept results of {active} that were run again for {id} came out otherwise: somebody who has \
         the key kept false ones, or this machine does not compute what another did; {done}, and the comparison runs \
         everything itself; {who}"
    )
}
