//! Values of a task that are past a limit, with the limit: of the profile in an evaluation, of the envelope in a live task.
//!
//! Reads the record of the task; measures nothing and decides nothing.

use std::collections::BTreeMap;

use holdpoint_governance::evidence::HardStop;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::monitor::SafetyEvent;
use holdpoint_governance::past_limit::{ForcePlace, LimitedQuantity, MeasuredInTask, PastLimit};
use holdpoint_governance::profile::Profile;
use holdpoint_governance::shared_event::StoppingEvent;
use holdpoint_runtime::agent::dispatcher::DispatchedTask;
use holdpoint_runtime::limits::Envelope;
use holdpoint_runtime::task::TaskRecord;

/// A live task, and the envelope that it ran under.
#[derive(Clone, Copy)]
pub struct MeasuredTask<'a> {
    /// Which sequence of the live world.
    pub sequence: u64,
    /// What the task left.
    pub record: &'a TaskRecord,
    /// Absent for a version that was not at work when the sequence began.
    pub envelope: Option<&'a Envelope>,
}

impl<'a> MeasuredTask<'a> {
    /// A task of a sequence, with the envelopes of the versions at work in it.
    #[must_use]
    pub fn new(
        sequence: u64,
        dispatched: &'a DispatchedTask,
        envelopes: &'a BTreeMap<CapabilityId, Envelope>,
    ) -> Self {
        Self { sequence, record: &dispatched.record, envelope: envelopes.get(&dispatched.id) }
    }

    /// The task with the value of its first violation.
    #[must_use]
    pub fn violation(&self) -> MeasuredInTask {
        let first = self.record.hits.first();
        self.with_value(first.and_then(|(_, hit)| hit.quantity()))
    }

    /// The task with the value of the safety event that stopped it, else of its first violation.
    #[must_use]
    pub fn safety_event(&self, event: Option<SafetyEvent>) -> MeasuredInTask {
        match event {
            Some(event) => self.with_value(quantity(StoppingEvent::Safety(event))),
            None => self.violation(),
        }
    }

    fn with_value(&self, of: Option<LimitedQuantity>) -> MeasuredInTask {
        let past = of.zip(self.envelope).and_then(|(quantity, envelope)| {
            let limit = match quantity {
                LimitedQuantity::Force => envelope.contact_force_max_n,
                LimitedQuantity::Speed => envelope.tool_speed_max_m_s,
                LimitedQuantity::Motion => envelope.unsafe_continuation_max_ms as f64,
                LimitedQuantity::Retries => f64::from(envelope.retries_max),
            };
            past(quantity, self.record, limit)
        });
        MeasuredInTask { sequence: self.sequence, task: self.record.task, past }
    }
}

/// The value of a record that an event is about, with the profile's limit, where it is past it.
#[must_use]
pub fn past_limit(event: StoppingEvent, record: &TaskRecord, profile: &Profile) -> Option<PastLimit> {
    let (quantity, limits) = (quantity(event)?, &profile.runtime);
    let limit = match quantity {
        LimitedQuantity::Force => limits.contact_force_max_n,
        LimitedQuantity::Speed => limits.tool_speed_max_m_s,
        LimitedQuantity::Motion => limits.unsafe_continuation_max_ms,
        LimitedQuantity::Retries => f64::from(limits.retries_max),
    };
    past(quantity, record, limit)
}

/// The quantity that an event is about.
const fn quantity(event: StoppingEvent) -> Option<LimitedQuantity> {
    match event {
        StoppingEvent::HardStop(HardStop::MotionAfterStop)
        | StoppingEvent::Safety(SafetyEvent::UnsafeContinuation) => Some(LimitedQuantity::Motion),
        StoppingEvent::Safety(SafetyEvent::ForceLimit | SafetyEvent::Collision) => {
            Some(LimitedQuantity::Force)
        }
        StoppingEvent::Safety(SafetyEvent::SpeedLimit) => Some(LimitedQuantity::Speed),
        StoppingEvent::HardStop(
            HardStop::UndeclaredImport
            | HardStop::CommandPastGuard
            | HardStop::NonFiniteOutput
            | HardStop::BudgetBreach,
        )
        | StoppingEvent::Safety(
            SafetyEvent::KeepOut
            | SafetyEvent::NotANumber
            | SafetyEvent::PermissionBreach
            | SafetyEvent::Danger,
        ) => None,
    }
}

/// The largest value of a quantity in a task, where it is past the limit. A value that is no number is in no record.
fn past(quantity: LimitedQuantity, record: &TaskRecord, limit: f64) -> Option<PastLimit> {
    let (value, place) = match quantity {
        LimitedQuantity::Force => (record.peak_force_n, force_place(record)),
        LimitedQuantity::Speed => (record.peak_speed_m_s, None),
        LimitedQuantity::Motion => (record.unsafe_continuation_ms as f64, None),
        LimitedQuantity::Retries => (f64::from(record.retries), None),
    };
    (value.is_finite() && value > limit).then_some(PastLimit { quantity, value, limit, place })
}

/// The place of the largest force, where one place alone had it.
fn force_place(record: &TaskRecord) -> Option<ForcePlace> {
    let harm = record.harm?;
    let [pads, surroundings] =
        [harm.grip_peak_n, harm.contact_peak_n].map(|peak_n| peak_n >= record.peak_force_n);
    match (pads, surroundings) {
        (true, false) => Some(ForcePlace::Pads),
        (false, true) => Some(ForcePlace::Surroundings),
        (true, true) | (false, false) => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_body::TaskKind;
    use holdpoint_governance::harm::HarmMeasures;
    use holdpoint_governance::policy_hit::PolicyHit;
    use holdpoint_governance::profile::ProfileName;

    fn envelope() -> Envelope {
        Envelope {
            tool_speed_max_m_s: 0.25,
            joint_speed_max_rad_s: 1.0,
            grip_force_max_n: 30.0,
            contact_force_max_n: 35.0,
            unsafe_continuation_max_ms: 200,
            workspace_min_m: [0.0; 3],
            workspace_max_m: [1.0; 3],
            near_share: 0.9,
            near_zone_m: 0.02,
            retries_max: 3,
        }
    }

    fn pressed(grip_peak_n: f64, contact_peak_n: f64) -> TaskRecord {
        TaskRecord {
            hits: vec![(200, PolicyHit::ForceMeasured)],
            harm: Some(HarmMeasures { grip_peak_n, contact_peak_n, ..HarmMeasures::STILL }),
            peak_force_n: 71.0,
            ..TaskRecord::invalid(TaskKind::Grasp, 7)
        }
    }

    #[test]
    fn a_violation_has_its_largest_value_and_the_limit_of_the_envelope() {
        let tight = envelope().tightened(0.5);
        for (envelope, limit) in [(envelope(), 35.0), (tight, 17.5)] {
            let record = pressed(71.0, 20.0);
            let task = MeasuredTask { sequence: 153, record: &record, envelope: Some(&envelope) };
            let past = task.violation().past.unwrap();
            assert_eq!((past.quantity, past.value, past.limit), (LimitedQuantity::Force, 71.0, limit));
            assert_eq!((task.violation().sequence, task.violation().task), (153, TaskKind::Grasp));
        }
    }

    #[test]
    fn a_force_is_placed_where_one_place_alone_had_it() {
        for (grip, contact, place) in [
            (71.0, 20.0, Some(ForcePlace::Pads)),
            (20.0, 71.0, Some(ForcePlace::Surroundings)),
            (71.0, 71.0, None),
            (20.0, 20.0, None),
        ] {
            assert_eq!(force_place(&pressed(grip, contact)), place, "{grip} {contact}");
        }
    }

    #[test]
    fn what_is_not_measured_past_a_limit_has_no_value() {
        let envelope = envelope();
        let past = |record: &TaskRecord, envelope| {
            MeasuredTask { sequence: 1, record, envelope }.violation().past.map(|past| past.value)
        };
        let hit = |hit| TaskRecord { hits: vec![(1, hit)], retries: 4, ..pressed(71.0, 20.0) };
        assert_eq!(past(&hit(PolicyHit::RetriesExceeded), Some(&envelope)), Some(4.0));
        assert_eq!(past(&hit(PolicyHit::KeepOutEntered), Some(&envelope)), None);
        assert_eq!(past(&hit(PolicyHit::SpeedMeasured), Some(&envelope)), None, "no speed was measured");
        assert_eq!(past(&pressed(71.0, 20.0), None), None, "the envelope is not known");
        let endless = TaskRecord { peak_force_n: f64::INFINITY, ..pressed(71.0, 20.0) };
        assert_eq!(past(&endless, Some(&envelope)), None);
    }

    #[test]
    fn a_safety_event_has_the_value_of_its_quantity() {
        let (envelope, record) = (envelope(), pressed(71.0, 20.0));
        let task = MeasuredTask { sequence: 1, record: &record, envelope: Some(&envelope) };
        let value = |event| task.safety_event(event).past.map(|past| past.value);
        assert_eq!(value(Some(SafetyEvent::Collision)), Some(71.0));
        assert_eq!(value(Some(SafetyEvent::Danger)), None);
        assert_eq!(value(None), Some(71.0), "the first violation");
        let profile = Profile::builtin(ProfileName::Sim).unwrap();
        let stop = StoppingEvent::HardStop(HardStop::BudgetBreach);
        assert!(past_limit(stop, &record, &profile).is_none());
    }
}
