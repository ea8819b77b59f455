//! What follows from an alarm without an action, and what to look at first: one sentence each for every kind.

use holdpoint_governance::alarms::AlarmKind;

/// What follows without an action.
#[must_use]
pub const fn consequence(kind: AlarmKind) -> &'static str {
    use AlarmKind as K;
    match kind {
        K::RolledBack => "its rollback target stays in control",
        K::Escalated => "without an answer the version is rolled back at the deadline",
        K::Restricted => "the version works with less speed and force until the restriction is lifted",
        K::Violation => "the limit may be passed again",
        K::Degraded => "the family keeps doing less of its work",
        K::Harm => "the version may do harm again",
        K::WeakRecovery => "a failure of the version may not end safely while it is in control",
        K::Shifted => "what the sandbox showed may not hold in the live cell",
        K::SharedEvent => "the active version may do what another version was stopped for",
        K::OutsideDomain => "tasks that start there are not covered by evidence",
        K::CellDegraded => "every version sees worse than it did at commissioning",
        K::SafeStopped => "no task of the family runs",
        K::NotRecovered => "the family works on under a version that is not safe either",
        K::Rejected => "the candidate is not activated",
        K::Approval => "without signatures the candidate is put on hold at the deadline",
        K::Unreviewed => "without a review the version is demoted at the deadline",
        K::KeptFalse => "later decisions may rest on false results",
        K::TelemetryMissed => "telemetry that the record seals is missing",
        K::CheckpointFailed => "a change of the record since the last checkpoint could stay unseen",
        K::NameTaken => "another program may have answered in place of the engine",
        K::CameUpStopped => "the arm is at standstill until a person starts the cell",
        K::CellLost => "the cell stays stopped until a person starts it",
        K::ProfileUnauthorized => "no version is activated and the arm is at standstill",
        K::ClockDoubted => "nothing is activated until a person confirms the time",
        K::EngineFault => "no version is evaluated or activated; stops still work",
    }
}

/// What to look at first.
#[must_use]
pub const fn look_at(kind: AlarmKind) -> &'static str {
    use AlarmKind as K;
    match kind {
        K::RolledBack => "the reason and the worst episodes of the version",
        K::Escalated => "the live tasks of the version, then answer",
        K::Restricted => "gripper, tool and object, then the tasks of the version",
        K::Violation => "gripper, tool and what they touch, then the film of the task",
        K::Degraded => "since when the results fell, then tool, parts and light",
        K::Harm => "stop the cell and inspect it; the counts are in the audit",
        K::WeakRecovery => "stop the cell and inspect it, then the drills of the version",
        K::Shifted => "what differs between the cell and its scene: parts, positions, camera",
        K::SharedEvent => "value and limit of the event, then the cell",
        K::OutsideDomain => "the quantity named above, then bring the cell back inside",
        K::CellDegraded => "the camera: lens, light, cable",
        K::SafeStopped => "why the version lost control, then which version to activate",
        K::NotRecovered => "stop the cell and inspect it",
        K::Rejected => "the reason of the decision",
        K::Approval => "the request",
        K::Unreviewed => "the reason of the activation, then the request",
        K::KeptFalse => "who can write to the store; tell the administrator",
        K::TelemetryMissed => "the disk of the store; tell the administrator",
        K::CheckpointFailed => "the disk of the store and the link to the witness",
        K::NameTaken => "who can log in to this machine; tell the administrator",
        K::CameUpStopped => "the cell: arm, object and people, before a start",
        K::CellLost => "the process of the cell and its link, then arm and object",
        K::ProfileUnauthorized => "the profile, then ask an administrator",
        K::ClockDoubted => "a clock that you trust",
        K::EngineFault => "the fault above and the log of the engine",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_kind_has_its_own_sentences() {
        let texts = |of: fn(AlarmKind) -> &'static str| -> std::collections::BTreeSet<&'static str> {
            AlarmKind::ALL.iter().map(|kind| of(*kind)).collect()
        };
        assert_eq!(texts(consequence).len(), AlarmKind::ALL.len());
        assert!(texts(look_at).iter().all(|text| !text.ends_with('.') && text.len() < 90));
    }
}
