//! Events that a candidate shares with the active version: they are kept, and raise an alarm about the active version.

use holdpoint_governance::alarms::AlarmKey;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::notice::Notice;
use holdpoint_trials::scene_stops::SceneStops;

use crate::decide::recorder::EngineRecorder;
use holdpoint_record::context::Context;
use holdpoint_record::evidence_file::EvidenceFile;

/// Keeps the hard stops so far of a candidate and the active version.
pub(crate) fn keep_stops(
    context: &Context,
    record: &mut EngineRecorder,
    evidence_file: &mut EvidenceFile,
    (candidate, active): (&CapabilityId, &CapabilityId),
    stops: &SceneStops,
) {
    evidence_file.hard_stops.clone_from(&stops.own);
    evidence_file.uncompared_stops.clone_from(&stops.uncompared);
    alarm_since(context, record, (candidate, active), stops, evidence_file.shared_events.len());
    evidence_file.shared_events.clone_from(&stops.shared);
}

/// Raises the alarm for what the two share beyond the first `known` events.
pub(crate) fn alarm_since(
    context: &Context,
    record: &mut EngineRecorder,
    (candidate, active): (&CapabilityId, &CapabilityId),
    stops: &SceneStops,
    known: usize,
) {
    for shared in stops.shared.iter().skip(known) {
        let (version, with) = (active.clone(), candidate.clone());
        alarm(context, record, active, Notice::SharedEvent { version, with, shared: *shared });
    }
}

/// Raises the alarm that an active version may do what another one was stopped or rolled back for.
pub(crate) fn alarm(context: &Context, record: &mut EngineRecorder, version: &CapabilityId, notice: Notice) {
    record.raise(AlarmKey::SharedEvent(version.clone()), context.profile.alarms.violation, true, notice);
}
