//! Replays recorded actions of monitors: feeds the charts with the live tasks in telemetry.

use serde_json::Value;

use holdpoint_governance::decision::ReasonCode;
use holdpoint_governance::live_harm::danger_reason;
use holdpoint_governance::metrics::store_metrics::{NotReplayable, ReplayOutcome};
use holdpoint_governance::monitor::{Monitor, MonitorDecision, roll_back};
use holdpoint_governance::record::{AuditRecord, RecordKind};
use holdpoint_governance::strictness::Strictness;
use holdpoint_wording::program::replay as sentences;

use super::LiveTask;
use super::monitor_action::cause;
use super::replay::{Replayer, VersionRecords, differing};

/// The most starts of the charts that are tried beside the activation, each with all tasks.
const STARTS_MAX: usize = 500;

/// Whether a monitor acted on missing telemetry or a missing answer.
const fn rests_on_time(cause: ReasonCode) -> bool {
    matches!(cause, ReasonCode::MonitorTelemetryMissing | ReasonCode::MonitorEscalationUnanswered)
}

/// Whether a monitor acted on a measurement: neither on silence nor on an operator's request.
pub(super) const fn is_measured(cause: ReasonCode) -> bool {
    !rests_on_time(cause) && !matches!(cause, ReasonCode::MonitorOperator)
}

/// Replays a monitor. `live` are all live tasks on record, in order; `is_whole` states whether no batch sealed between two
/// records is gone.
pub(super) fn action(
    replayer: &Replayer<'_>,
    of: &VersionRecords,
    record: &AuditRecord,
    live: &[LiveTask],
    is_whole: impl Fn(u64, u64) -> bool,
) -> ReplayOutcome {
    let not = |why| ReplayOutcome::NotReplayed { why };
    let Ok(recorded) = serde_json::from_str::<Value>(&record.body) else {
        return not(NotReplayable::Unreadable);
    };
    let Some(cause) = cause(record) else { return not(NotReplayable::Unreadable) };
    if rests_on_time(cause) {
        return not(NotReplayable::RestsOnTime);
    }
    if !is_measured(cause) {
        return not(NotReplayable::ByPerson);
    }
    if cause == ReasonCode::MonitorHarmTrip {
        return not(NotReplayable::WholeLife);
    }
    let Some(control) = replayer.history.control_at(&of.id, record.seq) else {
        return not(NotReplayable::EvidenceMissing);
    };
    if !is_whole(control.from_seq, record.seq) {
        return not(NotReplayable::TelemetryPruned);
    }
    let evidence_file = of.shadow_before(control.from_seq);
    let Some(frame) = replayer.frame_at(&of.id, record.seq) else {
        return not(NotReplayable::ProfileUnknown);
    };
    let settings = &frame.profile.monitor;
    let Some(normal) = evidence_file.and_then(|evidence_file| evidence_file.normal_rates(settings)) else {
        return not(NotReplayable::NormalUnknown);
    };
    let tasks: Vec<&LiveTask> = live
        .iter()
        .filter(|task| task.version == of.id && task.seq > control.from_seq && task.seq < record.seq)
        .collect();
    let Some(last) = tasks.last() else { return not(NotReplayable::EvidenceMissing) };
    let strictness = Strictness::of(&of.conditions_before(control.from_seq));
    let Ok(fresh) = Monitor::strict(&frame.profile, &normal, strictness, 0) else {
        return not(NotReplayable::Unreadable);
    };
    let confirmed = replayer.history.confirmed_in(control);
    let stepped_in = restricted_by_people(replayer, of, |seq| control.covers(seq));
    let same = |again: &MonitorDecision| {
        let replayed = serde_json::json!({ "action": again.action.name(), "reasons": again.reasons });
        differing("monitor", &recorded, &replayed)
    };
    // An event within a task is published before the task is charted.
    let tripped = last.safety.iter().map(|event| fresh.clone().safety(*event, 0));
    let harm = last.values.and_then(|values| values.harm);
    let dangers = harm.map(|harm| frame.profile.live_harm.dangers(&harm)).unwrap_or_default();
    let in_danger = roll_back(dangers.iter().map(danger_reason).collect(), 0);
    let tripped = tripped.chain((!dangers.is_empty()).then_some(in_danger));
    if tripped.map(|again| same(&again)).any(|differs| differs.is_none()) {
        return ReplayOutcome::Equal;
    }
    // An answer and a restart of the engine restart the charts. Any start may be the right one, and a wrong one does not give the
    // same statistic.
    let mut found = None;
    let newest = tasks.len().saturating_sub(STARTS_MAX);
    for from in std::iter::once(0).chain(newest.max(1)..tasks.len()) {
        let part = tasks.get(from..).unwrap_or_default();
        let begun_seq = if from == 0 { 0 } else { part.first().map_or(0, |task| task.seq) };
        let steps = stepped_in.get(stepped_in.partition_point(|seq| *seq < begun_seq)..).unwrap_or_default();
        let Some(again) = replay_tasks(fresh.clone(), part, confirmed, steps) else { continue };
        match same(&again) {
            None => return ReplayOutcome::Equal,
            Some(differs) => found = found.or(Some(differs)),
        }
    }
    if newest > 1 {
        return not(NotReplayable::BeginningUnknown);
    }
    ReplayOutcome::Differs { what: found.unwrap_or_else(|| sentences::NO_TASK_SUPPORTS.to_owned()) }
}

/// The records of an operator's restrictions of a version.
fn restricted_by_people(
    replayer: &Replayer<'_>,
    of: &VersionRecords,
    covers: impl Fn(u64) -> bool,
) -> Vec<u64> {
    let name = of.id.to_string();
    let acted = replayer.history.decisions.iter();
    acted
        .filter(|one| one.kind == RecordKind::Monitor && one.subject == name && covers(one.seq))
        .filter(|one| cause(one) == Some(ReasonCode::MonitorOperator))
        .map(|one| one.seq)
        .collect()
}

/// The action of a monitor after the last of some tasks. `confirmed`: the record that confirmed the version. `stepped_in`:
/// records of an operator's restrictions, which the monitor received.
fn replay_tasks(
    mut monitor: Monitor,
    tasks: &[&LiveTask],
    mut confirmed: Option<u64>,
    mut stepped_in: &[u64],
) -> Option<MonitorDecision> {
    let mut last = None;
    for task in tasks {
        while let Some((first, rest)) = stepped_in.split_first().filter(|(first, _)| **first < task.seq) {
            monitor.record_intervention(*first);
            stepped_in = rest;
        }
        if confirmed.take_if(|seq| *seq < task.seq).is_some() {
            monitor.confirmed().ok()?;
        }
        // A task that was cut short reached the monitor only if a person intervened.
        let shown = !task.marks.cut_short || task.marks.stepped_in;
        let Some(values) = task.values.filter(|_| shown) else { continue };
        monitor.set_tightened(task.marks.tightened);
        let mut decision = monitor.observe(&values, 0);
        for event in &task.safety {
            decision = monitor.safety(*event, 0);
        }
        last = Some(decision);
    }
    last
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_body::TaskKind;
    use holdpoint_governance::condition::Condition;
    use holdpoint_governance::evidence::EpisodeValues;
    use holdpoint_governance::monitor::{MonitorAction, normal_rates};
    use holdpoint_governance::profile::{Profile, ProfileName};
    use holdpoint_record::live_task_record::LiveTaskMarks;
    use holdpoint_runtime::task::TaskRecord;

    fn values(success: bool) -> EpisodeValues {
        let record = TaskRecord { invalid: false, success, ..TaskRecord::invalid(TaskKind::Align, 1) };
        record.values().unwrap()
    }

    fn tasks(count: u64, cut_short: bool) -> Vec<LiveTask> {
        let task = |seq| LiveTask {
            seq,
            version: "align@1.1.0".parse().unwrap(),
            values: Some(values(false)),
            safety: Vec::new(),
            hard_stop: false,
            stop_demanded: false,
            marks: LiveTaskMarks { cut_short, ..LiveTaskMarks::default() },
        };
        (1..=count).map(task).collect()
    }

    fn replayed_decision(
        conditions: &[Condition],
        tasks: &[LiveTask],
        confirmed: Option<u64>,
    ) -> Option<MonitorDecision> {
        let profile = Profile::builtin(ProfileName::Sim).unwrap();
        let normal = normal_rates(&[values(true); 20], &profile.monitor).unwrap();
        let monitor = Monitor::strict(&profile, &normal, Strictness::of(conditions), 0).unwrap();
        replay_tasks(monitor, &tasks.iter().collect::<Vec<_>>(), confirmed, &[])
    }

    /// The first consecutive failure for which a plain monitor warns.
    fn warning() -> u64 {
        let acts = |count: &u64| {
            replayed_decision(&[], &tasks(*count, false), None).unwrap().action != MonitorAction::Continue
        };
        (1..100).find(acts).unwrap()
    }

    #[test]
    fn replayed_monitor_uses_the_conditions_of_the_activation() {
        let count = warning();
        let action = |conditions: &[Condition], confirmed| {
            replayed_decision(conditions, &tasks(count, false), confirmed).unwrap().action
        };
        assert_eq!(action(&[], None), MonitorAction::Restrict);
        assert_eq!(action(&[Condition::RollbackCoupled], None), MonitorAction::Rollback);
        assert_eq!(action(&[Condition::RollbackCoupled], Some(1)), MonitorAction::Restrict);
        let stricter = [Condition::StricterThresholds { factor: 0.5 }];
        let early = replayed_decision(&stricter, &tasks(count - 1, false), None).unwrap();
        assert_ne!(early.action, MonitorAction::Continue, "half the level is reached sooner");
    }

    #[test]
    fn tasks_that_a_person_stopped_are_not_charted() {
        let mut worked = tasks(warning(), true);
        assert_eq!(replayed_decision(&[], &worked, None), None);
        worked.extend(tasks(1, false));
        assert_eq!(replayed_decision(&[], &worked, None).unwrap().action, MonitorAction::Continue);
    }

    #[test]
    fn interventions_and_a_tighter_envelope_are_replayed() {
        let stepped = |mut task: LiveTask| {
            task.marks.stepped_in = true;
            task.values = task.values.map(|values| EpisodeValues { intervention: true, ..values });
            task
        };
        let stopped: Vec<_> = tasks(50, true).into_iter().map(stepped).collect();
        let action = |decision: Option<MonitorDecision>| decision.unwrap().action;
        assert_ne!(action(replayed_decision(&[], &stopped, None)), MonitorAction::Continue, "fifty stops");
        let monitor = || {
            let profile = Profile::builtin(ProfileName::Sim).unwrap();
            let normal = [EpisodeValues { time_s: 2.0, ..values(true) }; 20];
            let normal = normal_rates(&normal, &profile.monitor).unwrap();
            Monitor::strict(&profile, &normal, Strictness::of(&[]), 0).unwrap()
        };
        let acts = |count: &usize| {
            action(replayed_decision(&[], &stopped[..*count], None)) != MonitorAction::Continue
        };
        let enough = (1..=50).find(acts).unwrap();
        assert!(enough > 1, "once is no habit");
        // The same number in total, except one task for a restriction.
        let last: Vec<&LiveTask> = stopped[enough - 1..enough].iter().collect();
        let restricted = vec![0; enough - 1];
        assert_ne!(action(replay_tasks(monitor(), &last, None, &restricted)), MonitorAction::Continue);
        assert_eq!(action(replay_tasks(monitor(), &last, None, &[])), MonitorAction::Continue);
        let slow = |tightened| {
            let mut slow = tasks(60, false);
            for task in &mut slow {
                task.marks.tightened = tightened;
                task.values = Some(EpisodeValues { time_s: 500.0, ..values(true) });
            }
            action(replay_tasks(monitor(), &slow.iter().collect::<Vec<_>>(), None, &[]))
        };
        assert_ne!(slow(false), MonitorAction::Continue);
        assert_eq!(slow(true), MonitorAction::Continue);
    }

    #[test]
    fn causes_are_classified() {
        for (cause, measured, time) in [
            (ReasonCode::MonitorSafetyTrip, true, false),
            (ReasonCode::MonitorRateWarning, true, false),
            (ReasonCode::MonitorCoupledTrip, true, false),
            (ReasonCode::MonitorHarmTrip, true, false),
            (ReasonCode::MonitorTelemetryMissing, false, true),
            (ReasonCode::MonitorEscalationUnanswered, false, true),
            (ReasonCode::MonitorOperator, false, false),
        ] {
            assert_eq!((is_measured(cause), rests_on_time(cause)), (measured, time), "{cause}");
        }
    }
}
