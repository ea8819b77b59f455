//! The reply to an accepted command in words: what was done, and what happens next.

use holdpoint_body::TaskKind;
use holdpoint_body::disturbance::{DriftKind, LiveFault};
use holdpoint_governance::alarms::AlarmKey;
use holdpoint_governance::decision::Reason;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::notice::{Notice, OperatorAct};
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::command::{Caller, StopPersistence};
use holdpoint_protocol::snapshot::StartupProgressView;

use crate::count::{counted, is_or_are};
use crate::program::run::startup_progress;
use crate::{notice_sentence, operator_act, reason};

/// What an accepted command did to a version, and what happens next.
#[derive(Clone, Copy, Debug)]
pub enum VersionEffect<'a> {
    /// It is registered; its author should change this.
    Registered(&'a [Notice]),
    /// A stage runs again or begins.
    InStage(Stage),
    /// An operator moved it.
    Moved(OperatorAct),
    /// It runs within less speed and force.
    Restricted,
    /// It lost control and can be evaluated again.
    Demoted,
    /// It lost control for good.
    RolledBack,
    /// It works on; its promotion waits.
    PromotionPaused,
    /// It is evaluated again by the gate.
    Resumed,
    /// It works on after the monitor's question.
    Continues,
    /// Candidates of its family are compared with it, too.
    Anchor,
    /// The tries of its family are counted from 1 again.
    TriesReviewed,
    /// Answers are missing.
    AwaitsApproval {
        /// How many.
        missing: u8,
        /// The newest reason of the count.
        last: Option<&'a Reason>,
    },
    /// It is approved and takes over later.
    ApprovedForLater {
        /// The cell is stopped; else a sequence runs.
        is_cell_stopped: bool,
    },
    /// It changed before it was approved.
    NotApproved {
        /// Why the lifecycle refuses it.
        problem: &'a str,
    },
    /// It is approved.
    Approved,
    /// A person refused it.
    RejectedBy(&'a str),
    /// Too few people answered.
    ApprovalExpired,
    /// It is active after an emergency approval.
    ActiveByBreakGlass {
        /// The deadline of its review.
        until: WallTime,
    },
    /// The review of its emergency activation lacks people.
    AwaitsReview {
        /// The newest reason of the count.
        last: Option<&'a Reason>,
    },
    /// The review of its emergency activation is over.
    Reviewed {
        /// The activation stands.
        upheld: bool,
    },
    /// Its restriction is lifted.
    Released,
    /// People are asked to lift its restriction.
    ReleaseAsked,
    /// Answers are missing to lift its restriction.
    AwaitsRelease {
        /// How many.
        missing: u8,
        /// The newest reason of the count.
        last: Option<&'a Reason>,
    },
    /// A person refused to lift its restriction.
    ReleaseRefusedBy(&'a str),
    /// Too few people answered about its restriction.
    ReleaseExpired,
    /// The profiles that block it now.
    BlockedUnder(&'a [ProfileName]),
}

/// The reply about a version, one sentence.
#[must_use]
pub fn version_effect(id: &CapabilityId, of: &VersionEffect<'_>) -> String {
    use VersionEffect as V;
    let reason_of = |last: Option<&Reason>| last.map_or_else(String::new, reason);
    match of {
        V::Registered(notices) => {
            let registered = format!("{id} is registered");
            notices.iter().fold(registered, |text, notice| format!("{text}; {}", notice_sentence(notice)))
        }
        V::InStage(stage) => format!("{id} is in {stage}"),
        V::Moved(act) => format!("{id} is {}", operator_act(*act)),
        V::Restricted => format!("{id} is restricted"),
        V::Demoted => format!("{id} is demoted"),
        V::RolledBack => format!("{id} is rolled back"),
        V::PromotionPaused => format!("{id} keeps control provisionally; its promotion is paused"),
        V::Resumed => format!("{id} resumes where it was; the gate evaluates it again"),
        V::Continues => format!("{id} continues"),
        V::Anchor => format!("{id} is the anchor of {}: candidates are compared with it, too", id.family),
        V::TriesReviewed => format!(
            "the tries of {} are reviewed and counted from 1 again; a version that was demoted for them continues with \
             `holdpoint version retry`",
            id.family
        ),
        V::AwaitsApproval { missing, last } => {
            format!("{id} waits for {missing} more; {}", reason_of(*last))
        }
        V::ApprovedForLater { is_cell_stopped: true } => {
            format!("{id} is approved and takes over at once when the cell starts again")
        }
        V::ApprovedForLater { is_cell_stopped: false } => {
            format!("{id} is approved and takes over when the sequence that runs is over")
        }
        V::NotApproved { problem } => {
            format!("{id} is not approved ({problem}); people are asked again")
        }
        V::Approved => format!("{id} is approved"),
        V::RejectedBy(person) => format!("{id} is rejected: {person} refused"),
        V::ApprovalExpired => format!("{id} is held: too few people answered in time"),
        V::ActiveByBreakGlass { until } => {
            format!("{id} is active by break-glass; two people review it by {until}")
        }
        V::AwaitsReview { last } => {
            format!("the review of {id} waits for more people; {}", reason_of(*last))
        }
        V::Reviewed { upheld: true } => format!("the emergency activation of {id} is upheld"),
        V::Reviewed { upheld: false } => format!("the emergency activation of {id} is not upheld"),
        V::Released => format!("{id} has its full envelope again"),
        V::ReleaseAsked => format!("people are asked to lift the restriction of {id}"),
        V::AwaitsRelease { missing, last } => {
            format!("the release of {id} waits for {missing} more; {}", reason_of(*last))
        }
        V::ReleaseRefusedBy(person) => format!("{id} stays restricted: {person} refused"),
        V::ReleaseExpired => format!("{id} stays restricted: too few people answered in time"),
        V::BlockedUnder([]) => format!("profiles that block {id}: none"),
        V::BlockedUnder(profiles) => {
            let names: Vec<&str> = profiles.iter().map(|profile| profile.name()).collect();
            format!("profiles that block {id}: {}", names.join(", "))
        }
    }
}

/// What a person does with an alarm.
#[derive(Clone, Copy, Debug)]
pub enum AlarmAct {
    /// Confirms that they saw it.
    Acknowledge,
    /// Ends it, as its condition is over.
    Reset,
    /// Silences it for a time.
    Shelve,
    /// Ends that silence.
    Unshelve,
}

/// What an accepted command did to the cell, the store's people or the engine.
#[derive(Clone, Copy, Debug)]
pub enum EngineEffect<'a> {
    /// The agent has another goal.
    Goal(&'a [TaskKind]),
    /// The drift of the live cell, or none any more.
    Drift(Option<DriftKind>),
    /// The fault of the live cell, or none any more.
    Fault(Option<LiveFault>),
    /// The live cell has another pace.
    Pace,
    /// A person started the cell.
    CellStarted,
    /// A note for the next shift is recorded.
    NoteRecorded,
    /// A person confirmed the machine's time.
    TimeConfirmed {
        /// The person.
        by: &'a str,
        /// The time.
        time: WallTime,
    },
    /// A person acted on an alarm.
    Alarm(&'a AlarmKey, AlarmAct),
    /// An administrator enrolled a person.
    Enrolled {
        /// The person.
        name: &'a str,
        /// The role.
        role: &'a str,
        /// The administrator.
        by: &'a str,
    },
    /// An administrator confirmed a person.
    PersonConfirmed {
        /// The person.
        name: &'a str,
        /// The administrator.
        by: &'a str,
    },
    /// An administrator revoked a person.
    Revoked {
        /// The person.
        name: &'a str,
        /// The administrator.
        by: &'a str,
        /// Answers of the person to open requests; they count no more.
        discarded: usize,
    },
    /// The engine ends.
    Ends,
}

/// The reply about the cell, a person or the engine, one sentence.
#[must_use]
pub fn engine_effect(of: &EngineEffect<'_>) -> String {
    use EngineEffect as E;
    match of {
        E::Goal(tasks) => {
            let names: Vec<&str> = tasks.iter().map(|task| task.name()).collect();
            format!("from the next sequence on the agent runs {}", names.join(", "))
        }
        E::Drift(None) => "the drift has ended".to_owned(),
        E::Drift(Some(kind)) => {
            let kind = kind.name().replace('_', "-");
            format!("the drift {kind} has set in; the cell has no other one")
        }
        E::Fault(None) => "the fault is repaired".to_owned(),
        E::Fault(Some(fault)) => format!("the fault {fault} has set in"),
        E::Pace => "the live cell runs at the new pace".to_owned(),
        E::CellStarted => "the cell runs again".to_owned(),
        E::NoteRecorded => "the note is on record".to_owned(),
        E::TimeConfirmed { by, time } => format!("{by} confirmed the time, {time}"),
        E::Alarm(alarm, AlarmAct::Acknowledge) => format!("{alarm} is acknowledged"),
        E::Alarm(alarm, AlarmAct::Reset) => format!("{alarm} is reset"),
        E::Alarm(alarm, AlarmAct::Shelve) => format!("{alarm} is shelved"),
        E::Alarm(alarm, AlarmAct::Unshelve) => format!("{alarm} is taken from its shelf"),
        E::Enrolled { name, role, by } => format!("{name} is enrolled as {role} by {by}"),
        E::PersonConfirmed { name, by } => format!("{name} is confirmed by {by}"),
        E::Revoked { name, by, discarded: 0 } => format!("{name} is revoked by {by}"),
        E::Revoked { name, by, discarded } => {
            format!("{name} is revoked by {by}; answers to open questions that count no more: {discarded}")
        }
        E::Ends => "the engine ends; nothing was approved or activated by it".to_owned(),
    }
}

const KEPT_NOWHERE: &str =
    "the engine could store the stop neither on record nor beside it: a sudden end of the engine loses it";

/// The reply to a stop that the engine carried out. `first` stopped the cell before, `problem` kept the stop from the
/// record, and `summed` stops of this account are recorded as a number.
#[must_use]
pub fn stop_effect(
    first: Option<&Caller>,
    kept: StopPersistence,
    problem: Option<&str>,
    summed: u64,
) -> String {
    let stopped = first.map_or_else(
        || "the cell is stopped".to_owned(),
        |first| format!("the cell is stopped, first by {first}"),
    );
    let why = problem.map_or_else(String::new, |problem| format!(": {problem}"));
    match kept {
        StopPersistence::OnRecord if summed == 0 => {
            format!("{stopped}; it stays stopped until a person starts it")
        }
        StopPersistence::OnRecord => format!(
            "{stopped}; it stays stopped until a person starts it; {} of this account {} on record as a sum",
            counted(summed, "stop"),
            is_or_are(summed)
        ),
        StopPersistence::InMark => {
            format!("{stopped}; the engine could not record the stop and keeps it beside the record{why}")
        }
        StopPersistence::InMemory => format!("{stopped}; {KEPT_NOWHERE}{why}"),
    }
}

/// When a stop that is not on record yet is recorded.
#[derive(Clone, Copy, Debug)]
pub enum StopFollowUp {
    /// By this engine, as its next action.
    Next,
    /// By the next engine: this one ends.
    NextEngine,
    /// By this engine, after it has read the record.
    AfterStart(Option<StartupProgressView>),
}

/// The reply to a stop before the engine records it. `kept` says whether it is stored beside the record, `problem` why
/// it is not.
#[must_use]
pub fn early_stop_effect(follow_up: StopFollowUp, kept: StopPersistence, problem: Option<&str>) -> String {
    let next = match follow_up {
        StopFollowUp::Next => "the engine puts it on record next".to_owned(),
        StopFollowUp::NextEngine => "this engine ends, and the next one puts it on record".to_owned(),
        StopFollowUp::AfterStart(reading) => {
            let reading =
                reading.map_or_else(String::new, |reading| format!(" ({})", startup_progress(Some(reading))));
            format!(
                "it stays stopped; the engine records the stop as soon as it has read the record{reading}"
            )
        }
    };
    match kept {
        StopPersistence::OnRecord | StopPersistence::InMark => {
            format!("the cell is stopped; the stop is stored beside the record; {next}")
        }
        StopPersistence::InMemory => {
            let why = problem.map_or_else(String::new, |problem| format!(": {problem}"));
            format!("the cell is stopped; {next}; until then {KEPT_NOWHERE}{why}")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn effects_on_a_version_have_their_sentences() {
        use VersionEffect as V;
        let id: CapabilityId = "grasp@1.1.0".parse().unwrap();
        let profiles = [ProfileName::Real, ProfileName::Human];
        for (effect, text) in [
            (V::Registered(&[]), "grasp@1.1.0 is registered"),
            (V::InStage(Stage::Sandbox), "grasp@1.1.0 is in sandbox"),
            (V::Moved(OperatorAct::Paused), "grasp@1.1.0 is paused"),
            (V::PromotionPaused, "grasp@1.1.0 keeps control provisionally; its promotion is paused"),
            (V::Anchor, "grasp@1.1.0 is the anchor of grasp: candidates are compared with it, too"),
            (V::AwaitsApproval { missing: 2, last: None }, "grasp@1.1.0 waits for 2 more; "),
            (
                V::ApprovedForLater { is_cell_stopped: true },
                "grasp@1.1.0 is approved and takes over at once when the cell starts again",
            ),
            (
                V::ApprovedForLater { is_cell_stopped: false },
                "grasp@1.1.0 is approved and takes over when the sequence that runs is over",
            ),
            (V::RejectedBy("mia"), "grasp@1.1.0 is rejected: mia refused"),
            (V::Reviewed { upheld: false }, "the emergency activation of grasp@1.1.0 is not upheld"),
            (V::ReleaseExpired, "grasp@1.1.0 stays restricted: too few people answered in time"),
            (V::BlockedUnder(&[]), "profiles that block grasp@1.1.0: none"),
            (V::BlockedUnder(&profiles), "profiles that block grasp@1.1.0: real, human"),
        ] {
            assert_eq!(version_effect(&id, &effect), text);
        }
    }

    #[test]
    fn effects_on_cell_and_people_have_their_sentences() {
        use EngineEffect as E;
        let revoked = |discarded| E::Revoked { name: "ben", by: "mia", discarded };
        for (effect, text) in [
            (
                E::Goal(&[TaskKind::Grasp, TaskKind::Align]),
                "from the next sequence on the agent runs grasp, align",
            ),
            (E::Drift(None), "the drift has ended"),
            (E::Fault(Some(LiveFault::CameraLost)), "the fault camera-lost has set in"),
            (E::Enrolled { name: "ben", role: "safety", by: "mia" }, "ben is enrolled as safety by mia"),
            (revoked(0), "ben is revoked by mia"),
            (revoked(2), "ben is revoked by mia; answers to open questions that count no more: 2"),
        ] {
            assert_eq!(engine_effect(&effect), text);
        }
    }

    #[test]
    fn a_stop_names_its_first_caller_and_where_it_is_stored() {
        let stopped = "the cell is stopped; it stays stopped until a person starts it";
        assert_eq!(stop_effect(None, StopPersistence::OnRecord, None, 0), stopped);
        let summed = format!("{stopped}; 3 stops of this account are on record as a sum");
        assert_eq!(stop_effect(None, StopPersistence::OnRecord, None, 3), summed);
        assert_eq!(
            stop_effect(Some(&Caller::Script), StopPersistence::InMark, Some("the disk is full"), 0),
            "the cell is stopped, first by a script; the engine could not record the stop and keeps it beside the \
             record: the disk is full"
        );
    }

    #[test]
    fn an_early_stop_names_when_it_is_recorded() {
        let reading = StartupProgressView { read: 3, of: 9 };
        assert_eq!(
            early_stop_effect(StopFollowUp::AfterStart(Some(reading)), StopPersistence::InMark, None),
            "the cell is stopped; the stop is stored beside the record; it stays stopped; the engine records the stop \
             as soon as it has read the record (not verified yet: 3 of 9 records read)"
        );
        assert_eq!(
            early_stop_effect(StopFollowUp::Next, StopPersistence::InMemory, Some("no space")),
            format!(
                "the cell is stopped; the engine puts it on record next; until then {KEPT_NOWHERE}: no space"
            )
        );
    }
}
