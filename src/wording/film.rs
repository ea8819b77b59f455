//! A film in words: why it shows this part of an evaluation, the result of each run, and the events in it.

use holdpoint_body::FailureSignal;
use holdpoint_governance::evidence::DrillKind;
use holdpoint_governance::failure_cause::FailureCause;
use holdpoint_governance::permission::fault_text;
use holdpoint_governance::watcher_signal::WatcherSignal;
use holdpoint_protocol::film::{
    BreakCause, CodeFaultCount, ExceededLimit, ExceededValue, Film, FilmRefusal, FilmSubject, MarkedEvent,
    OutcomePart, ReplayDifference, SelectionFailure, SelectionReason,
};

use crate::harm::harm_measure;
use crate::policy_hit::policy_hit;
use crate::{failure_cause, hard_stop};

/// The next step after a refusal.
pub const REFUSAL_HINT: &str = "`holdpoint explain` shows its measurements";

/// The part of an evaluation that a film shows: `episode 17 of 120, seed 10016`.
#[must_use]
pub fn title(of: &Film) -> String {
    let Film { number, count, beyond, seed, .. } = of;
    let what = match (of.drill, of.phase) {
        (Some(drill), Some(phase)) => format!("{drill} drill in {phase},"),
        (Some(drill), None) => format!("{drill} drill,"),
        (None, _) => of.of.to_string(),
    };
    let which = if of.drill.is_some() { "failed one " } else { "" };
    let all =
        if *beyond > 0 { format!("the first {count}, {beyond} more failed") } else { count.to_string() };
    format!("{what} {which}{number} of {all}, seed {seed}")
}

/// A film as a part of a recording, with the reason for its selection, which may be empty.
#[must_use]
pub fn recorded_part(title: &str, why: &str) -> String {
    let why = if why.is_empty() { String::new() } else { format!(": {why}") };
    format!("re-run with the active version as its twin: {title}{why}")
}

/// Why there is no film.
#[must_use]
pub fn refusal(of: &FilmRefusal) -> String {
    match of {
        FilmRefusal::UnknownVersion { version } => format!("there is no version {version} in the registry"),
        FilmRefusal::NotSelected { version, failure } => {
            format!("{version}: {}", selection_failure(*failure))
        }
        FilmRefusal::ComparedVersionMissing { version } => {
            format!("the version that {version} was compared with is not in the registry")
        }
        FilmRefusal::CellCannotFilm => "the cell keeps no frames of its episodes".to_owned(),
    }
}

/// Why nothing could be selected.
#[must_use]
pub fn selection_failure(of: SelectionFailure) -> String {
    use FilmSubject as S;
    match of {
        SelectionFailure::NoneOnRecord(S::Episode) => {
            "no paired episode of the sandbox is on record".to_owned()
        }
        SelectionFailure::NoneOnRecord(S::Confirmation) => {
            "no paired episode of a confirmation is on record".to_owned()
        }
        SelectionFailure::NoneOnRecord(S::Drill) => "no failed drill is on record one by one".to_owned(),
        SelectionFailure::NoneOnRecord(S::Alone) => {
            "no episode that it worked alone is on record one by one".to_owned()
        }
        SelectionFailure::OutOfRange { of, number, count } => {
            let what = match of {
                S::Episode | S::Confirmation => "paired episodes",
                S::Drill => "failed drills on record one by one",
                S::Alone => "episodes that it worked alone",
            };
            format!("number {number} is not among the {count} {what}")
        }
    }
}

/// Why the selected part is the worst of its kind.
#[must_use]
pub fn selection_reason(of: SelectionReason) -> String {
    use SelectionReason as R;
    let other = "the active version";
    match of {
        R::BrokenOff(cause) => {
            let cause = match cause {
                BreakCause::Code(count) => code_fault_count(count),
                BreakCause::HardStop { stop, overrun } => hard_stop(stop, overrun).to_owned(),
            };
            format!("it is broken off, the active version's is not; on record: {cause}")
        }
        R::Harm { kind, candidate, active } => {
            format!("{} {}, of {other} {}", harm_measure(kind), kind.format(candidate), kind.format(active))
        }
        R::LimitExceeded => format!("it passes a limit, {other} does not"),
        R::RecoveryTookOver => format!("the recovery manager has to take over, not from {other}"),
        R::FailureNamed => format!("the watcher names a failure, of {other} none"),
        R::NotDone => format!("it does not do the task, {other} does"),
        R::MoreAttempts { more: 1 } => format!("it tries once more than {other}"),
        R::MoreAttempts { more } => format!("it tries {more} times more than {other}"),
        R::MoreTime { more_s } => format!("it takes {more_s:.1} s longer than {other}"),
        R::NowhereWorse => format!("in no episode on record is it worse than {other}"),
        R::MostFailingDrill { active_passes } => match active_passes {
            Some(true) => "it is of the kind that fails most, and the active version passes it".to_owned(),
            Some(false) => "it is of the kind that fails most; the active version fails it too".to_owned(),
            None => "it is of the kind that fails most".to_owned(),
        },
        R::EndsEvaluation { stop, overrun } => {
            format!("{}, which ends an evaluation", hard_stop(stop, overrun))
        }
        R::Gravest => "the gravest of them".to_owned(),
    }
}

/// How confined code failed, and in how many of the tasks.
#[must_use]
pub fn code_fault_count(of: CodeFaultCount) -> String {
    format!("{} in {} of {} tasks", fault_text(of.fault), of.failed, of.tasks)
}

/// How a re-run differs from the original.
#[must_use]
pub fn replay_difference(of: ReplayDifference) -> String {
    match of {
        ReplayDifference::Profile { present } => {
            format!("it was judged under another profile than {present}")
        }
        ReplayDifference::Policies => "it was judged under other policies".to_owned(),
        ReplayDifference::Environment => "it was judged by another build, or in another cell".to_owned(),
        ReplayDifference::Neighbours => "it was judged beside other active versions".to_owned(),
        ReplayDifference::CutOff => "it continues after the film: only two minutes are stored".to_owned(),
    }
}

/// The result of a run, its parts in their order.
#[must_use]
pub fn outcome(parts: &[OutcomePart]) -> String {
    parts.iter().map(outcome_part).collect::<Vec<_>>().join(", ")
}

fn outcome_part(of: &OutcomePart) -> String {
    use OutcomePart as P;
    match of {
        P::SimulatorFailed => "the simulator failed in it".to_owned(),
        P::CallRefused => "the call is refused: what it needs to begin does not hold".to_owned(),
        P::HardStop { stop, fault } => hard_stop(*stop, *fault).to_owned(),
        P::CodeFault(fault) => fault_text(*fault).to_owned(),
        P::Violation { hits } if hits.is_empty() => "passes a limit".to_owned(),
        P::Violation { hits } => {
            let labels: Vec<&str> = hits.iter().map(|hit| policy_hit(*hit)).collect();
            format!("passes a limit: {}", labels.join(" and "))
        }
        P::Exceeded(limit) => exceeded_limit(*limit),
        P::MoreExceeded { limits: 1 } => "one more limit passed".to_owned(),
        P::MoreExceeded { limits } => format!("{limits} more limits passed"),
        P::MovedOn { ms } => format!("moves on for {ms} ms after it was to stop"),
        P::RecoveryTookOver => "the recovery manager takes over".to_owned(),
        P::TimedOut => "runs out of time".to_owned(),
        P::Task { done: true, .. } => "does the task".to_owned(),
        P::Task { done: false, cause } => with_cause("does not do the task", *cause),
        P::Attempts { more: 1 } => "tries once more".to_owned(),
        P::Attempts { more } => format!("tries {more} times more"),
        P::Took { secs } => format!("{secs:.1} s"),
        P::Drill { kind, passed: true } => format!("passes the {kind} drill"),
        P::Drill { kind, passed: false } => format!("fails the {kind} drill"),
        P::DrillNotSetUp => "could not be set up for it".to_owned(),
    }
}

/// What failed, and why if that is known.
fn with_cause(failed: &str, cause: Option<FailureCause>) -> String {
    cause.map_or_else(|| failed.to_owned(), |cause| format!("{failed}: {}", failure_cause(cause)))
}

/// The value, and how far it is past its limit.
fn exceeded_limit(of: ExceededLimit) -> String {
    let times = of.times;
    let over = if times.is_finite() { format!("{times:.1} times") } else { "past".to_owned() };
    match of.value {
        ExceededValue::Grip { most_n } => format!("grip {most_n:.1} N, {over} what its guard allows"),
        ExceededValue::Speed { most_m_s } => format!("speed {most_m_s:.1} m/s, {over} what its guard allows"),
        ExceededValue::Harm { kind, value, limit } if kind.is_worse_when_lower() => {
            format!(
                "{} {}, at least {} is wanted",
                harm_measure(kind),
                kind.format(value),
                kind.format(limit)
            )
        }
        ExceededValue::Harm { kind, value, .. } => {
            format!("{} {}, {over} the limit", harm_measure(kind), kind.format(value))
        }
    }
}

/// What happened in a run, a few words.
#[must_use]
pub fn marked_event(of: &MarkedEvent) -> String {
    match of {
        MarkedEvent::Guard(hit) => policy_hit(*hit).to_owned(),
        MarkedEvent::Watcher(signal) => watcher_signal(*signal).to_owned(),
        MarkedEvent::Declared(signal) => format!("it says that it failed: {}", failure_signal(*signal)),
        MarkedEvent::StoppedByHook => "its abort hook stops the arm".to_owned(),
        MarkedEvent::StoppedByInterrupt => "the arm has to be interrupted".to_owned(),
        MarkedEvent::NotStopped => "nothing stops the arm".to_owned(),
        MarkedEvent::TaskEnded { done: true, .. } => "the task is done".to_owned(),
        MarkedEvent::TaskEnded { done: false, cause } => with_cause("the task is not done", *cause),
        MarkedEvent::DrillBegan(kind) => drill_begin(*kind).to_owned(),
        MarkedEvent::Outcome(part) => outcome_part(part),
    }
}

/// What begins a drill.
const fn drill_begin(kind: DrillKind) -> &'static str {
    match kind {
        DrillKind::Rollback => "its rollback hook is called",
        DrillKind::Fallback => "it is aborted, the fallback takes over",
        DrillKind::Abort => "its abort hook is called",
        DrillKind::Detect => "a fault is injected",
    }
}

/// What the watcher saw, a few words.
const fn watcher_signal(of: WatcherSignal) -> &'static str {
    match of {
        WatcherSignal::ObjectSlip => "the object slips in the hand",
        WatcherSignal::ObjectLost => "the hand has lost the object",
        WatcherSignal::TrackingError => "a joint is far from where it should be",
        WatcherSignal::UnexpectedContact => "it touches what it should not",
        WatcherSignal::StaleInput => "it moves on camera frames that are too old",
        WatcherSignal::ToolLost => "the gripper does not answer",
        WatcherSignal::GripFault => "the gripper does not follow",
        WatcherSignal::Overrun => "the work takes too long",
        WatcherSignal::TelemetryInvalid => "a sensor gives no number",
    }
}

/// The failure that a skill declared, as its name is written.
const fn failure_signal(of: FailureSignal) -> &'static str {
    match of {
        FailureSignal::TargetNotFound => "target not found",
        FailureSignal::GraspMissed => "grasp missed",
        FailureSignal::ObjectSlipped => "object slipped",
        FailureSignal::UnexpectedContact => "unexpected contact",
        FailureSignal::AlignmentLost => "alignment lost",
        FailureSignal::PlacementMissed => "placement missed",
        FailureSignal::ToolUnavailable => "tool unavailable",
        FailureSignal::InputStale => "input stale",
        FailureSignal::TimedOut => "timed out",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_body::CodeFault;
    use holdpoint_governance::evidence::HardStop;
    use holdpoint_governance::harm::HarmKind;
    use holdpoint_governance::policy_hit::PolicyHit;
    use holdpoint_governance::profile::ProfileName;

    const COUNT: CodeFaultCount = CodeFaultCount { fault: CodeFault::Trap, failed: 40, tasks: 120 };

    #[test]
    fn every_selection_reason_has_its_sentence() {
        use SelectionReason as R;
        let breach = (HardStop::BudgetBreach, Some(CodeFault::Fuel));
        for (reason, text) in [
            (
                R::BrokenOff(BreakCause::Code(COUNT)),
                "it is broken off, the active version's is not; on record: its code traps in 40 of 120 tasks",
            ),
            (
                R::BrokenOff(BreakCause::HardStop { stop: breach.0, overrun: breach.1 }),
                "it is broken off, the active version's is not; on record: its code computed beyond its budget",
            ),
            (
                R::Harm { kind: HarmKind::GripPeak, candidate: 70.0, active: 24.0 },
                "peak grip force on the object 70.0 N, of the active version 24.0 N",
            ),
            (R::LimitExceeded, "it passes a limit, the active version does not"),
            (R::RecoveryTookOver, "the recovery manager has to take over, not from the active version"),
            (R::FailureNamed, "the watcher names a failure, of the active version none"),
            (R::NotDone, "it does not do the task, the active version does"),
            (R::MoreAttempts { more: 1 }, "it tries once more than the active version"),
            (R::MoreAttempts { more: 3 }, "it tries 3 times more than the active version"),
            (R::MoreTime { more_s: 2.04 }, "it takes 2.0 s longer than the active version"),
            (R::NowhereWorse, "in no episode on record is it worse than the active version"),
            (
                R::MostFailingDrill { active_passes: Some(true) },
                "it is of the kind that fails most, and the active version passes it",
            ),
            (
                R::MostFailingDrill { active_passes: Some(false) },
                "it is of the kind that fails most; the active version fails it too",
            ),
            (R::MostFailingDrill { active_passes: None }, "it is of the kind that fails most"),
            (
                R::EndsEvaluation { stop: breach.0, overrun: breach.1 },
                "its code computed beyond its budget, which ends an evaluation",
            ),
            (R::Gravest, "the gravest of them"),
        ] {
            assert_eq!(selection_reason(reason), text);
        }
    }

    #[test]
    fn a_code_fault_explains_an_exceeded_budget_alone() {
        let text = |fault| hard_stop(HardStop::BudgetBreach, fault);
        assert_ne!(text(None), text(Some(CodeFault::Fuel)));
        let moved = |fault| hard_stop(HardStop::MotionAfterStop, fault);
        assert_eq!(moved(Some(CodeFault::Fuel)), moved(None));
    }

    #[test]
    fn a_refusal_names_the_version_and_the_cause() {
        let version = || "grasp@1.1.0".parse().unwrap();
        let not_selected = |failure| FilmRefusal::NotSelected { version: version(), failure };
        let out_of_range = |of| SelectionFailure::OutOfRange { of, number: 4, count: 3 };
        for (of, text) in [
            (
                FilmRefusal::UnknownVersion { version: version() },
                "there is no version grasp@1.1.0 in the registry",
            ),
            (
                FilmRefusal::ComparedVersionMissing { version: version() },
                "the version that grasp@1.1.0 was compared with is not in the registry",
            ),
            (FilmRefusal::CellCannotFilm, "the cell keeps no frames of its episodes"),
            (
                not_selected(SelectionFailure::NoneOnRecord(FilmSubject::Episode)),
                "grasp@1.1.0: no paired episode of the sandbox is on record",
            ),
            (
                not_selected(SelectionFailure::NoneOnRecord(FilmSubject::Confirmation)),
                "grasp@1.1.0: no paired episode of a confirmation is on record",
            ),
            (
                not_selected(SelectionFailure::NoneOnRecord(FilmSubject::Drill)),
                "grasp@1.1.0: no failed drill is on record one by one",
            ),
            (
                not_selected(SelectionFailure::NoneOnRecord(FilmSubject::Alone)),
                "grasp@1.1.0: no episode that it worked alone is on record one by one",
            ),
            (
                not_selected(out_of_range(FilmSubject::Confirmation)),
                "grasp@1.1.0: number 4 is not among the 3 paired episodes",
            ),
            (
                not_selected(out_of_range(FilmSubject::Drill)),
                "grasp@1.1.0: number 4 is not among the 3 failed drills on record one by one",
            ),
            (
                not_selected(out_of_range(FilmSubject::Alone)),
                "grasp@1.1.0: number 4 is not among the 3 episodes that it worked alone",
            ),
        ] {
            assert_eq!(refusal(&of), text);
        }
    }

    #[test]
    fn a_difference_of_the_re_run_is_one_sentence() {
        for (of, text) in [
            (
                ReplayDifference::Profile { present: ProfileName::Human },
                "it was judged under another profile than human",
            ),
            (ReplayDifference::Policies, "it was judged under other policies"),
            (ReplayDifference::Environment, "it was judged by another build, or in another cell"),
            (ReplayDifference::Neighbours, "it was judged beside other active versions"),
            (ReplayDifference::CutOff, "it continues after the film: only two minutes are stored"),
        ] {
            assert_eq!(replay_difference(of), text);
        }
    }

    #[test]
    fn an_outcome_joins_its_parts() {
        use OutcomePart as P;
        let grip = ExceededLimit { tick: 8, times: 3.0, value: ExceededValue::Grip { most_n: 90.0 } };
        let hits = vec![PolicyHit::ForceMeasured, PolicyHit::SpeedMeasured];
        for (parts, text) in [
            (vec![P::SimulatorFailed], "the simulator failed in it"),
            (vec![P::CallRefused], "the call is refused: what it needs to begin does not hold"),
            (
                vec![
                    P::Violation { hits: vec![PolicyHit::ForceMeasured] },
                    P::Exceeded(grip),
                    P::Task { done: false, cause: Some(FailureCause::Slipped) },
                    P::Attempts { more: 2 },
                    P::Took { secs: 2.0 },
                ],
                "passes a limit: a force is larger than allowed, grip 90.0 N, 3.0 times what its guard allows, does not do \
                 the task: the object slipped, tries 2 times more, 2.0 s",
            ),
            (
                vec![
                    P::HardStop { stop: HardStop::BudgetBreach, fault: Some(CodeFault::Fuel) },
                    P::Violation { hits },
                    P::MoreExceeded { limits: 1 },
                ],
                "its code computed beyond its budget, passes a limit: a force is larger than allowed and the tool is \
                 faster than allowed, one more limit passed",
            ),
            (
                vec![
                    P::CodeFault(CodeFault::Trap),
                    P::Violation { hits: Vec::new() },
                    P::MoreExceeded { limits: 2 },
                    P::MovedOn { ms: 30 },
                    P::RecoveryTookOver,
                    P::TimedOut,
                    P::Task { done: true, cause: None },
                    P::Attempts { more: 1 },
                ],
                "its code traps, passes a limit, 2 more limits passed, moves on for 30 ms after it was to stop, the \
                 recovery manager takes over, runs out of time, does the task, tries once more",
            ),
            (vec![P::Drill { kind: DrillKind::Abort, passed: true }], "passes the abort drill"),
            (vec![P::Drill { kind: DrillKind::Abort, passed: false }], "fails the abort drill"),
            (vec![P::DrillNotSetUp], "could not be set up for it"),
        ] {
            assert_eq!(outcome(&parts), text);
        }
    }

    #[test]
    fn an_exceeded_limit_shows_value_and_limit() {
        let harm = |kind, value, limit| ExceededValue::Harm { kind, value, limit };
        for (times, value, text) in [
            (
                f64::INFINITY,
                harm(HarmKind::ZoneClearance, -0.1, 0.05),
                "distance to a keep-out zone -0.100 m, at least 0.050 m is wanted",
            ),
            (
                5.0,
                harm(HarmKind::ExcessDepth, 0.5, 0.1),
                "excess of a command over the declaration 0.500, 5.0 times the limit",
            ),
            (3.0, ExceededValue::Grip { most_n: 60.0 }, "grip 60.0 N, 3.0 times what its guard allows"),
            (2.4, ExceededValue::Speed { most_m_s: 1.2 }, "speed 1.2 m/s, 2.4 times what its guard allows"),
            (
                f64::INFINITY,
                ExceededValue::Speed { most_m_s: 1.2 },
                "speed 1.2 m/s, past what its guard allows",
            ),
        ] {
            assert_eq!(exceeded_limit(ExceededLimit { tick: 0, times, value }), text);
        }
    }

    #[test]
    fn every_event_has_its_words() {
        use MarkedEvent as E;
        for (event, text) in [
            (E::Guard(PolicyHit::ForceMeasured), "a force is larger than allowed"),
            (E::Watcher(WatcherSignal::ObjectSlip), "the object slips in the hand"),
            (E::StoppedByHook, "its abort hook stops the arm"),
            (E::StoppedByInterrupt, "the arm has to be interrupted"),
            (E::NotStopped, "nothing stops the arm"),
            (E::TaskEnded { done: true, cause: None }, "the task is done"),
            (E::TaskEnded { done: false, cause: None }, "the task is not done"),
            (
                E::TaskEnded { done: false, cause: Some(FailureCause::Dropped) },
                "the task is not done: dropped the object",
            ),
            (E::DrillBegan(DrillKind::Rollback), "its rollback hook is called"),
            (E::DrillBegan(DrillKind::Fallback), "it is aborted, the fallback takes over"),
            (E::DrillBegan(DrillKind::Abort), "its abort hook is called"),
            (E::DrillBegan(DrillKind::Detect), "a fault is injected"),
            (
                E::Outcome(OutcomePart::Drill { kind: DrillKind::Detect, passed: false }),
                "fails the detect drill",
            ),
        ] {
            assert_eq!(marked_event(&event), text);
        }
        for signal in FailureSignal::ALL {
            let name = serde_json::to_value(signal).unwrap().as_str().unwrap().replace('_', " ");
            assert_eq!(marked_event(&E::Declared(signal)), format!("it says that it failed: {name}"));
        }
    }
}
