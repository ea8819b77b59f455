//! The status of a version in words: what it is, since when, by whom or by which rule, and what ends that.

use holdpoint_governance::explanation::RecordMoment;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::notice::Notice;
use holdpoint_governance::version_status::{ConditionEnd, Obstacle, VersionCondition, VersionStatus};

use crate::{line, notice, record_time};

/// The whole status, as one sentence without a full stop. Parts may be a person's text.
#[must_use]
pub fn version_status(version: &CapabilityId, of: &VersionStatus) -> String {
    let since = of.since.map_or_else(String::new, |since| format!(" since {}", moment(since)));
    let cause = status_cause(of).map_or_else(String::new, |cause| format!(" ({cause})"));
    format!("{}{since}{cause}; {}", condition(of), status_end(version, of))
}

/// Who made a version what it is, and why, or by which rule; absent if nothing on record says it.
#[must_use]
pub fn status_cause(of: &VersionStatus) -> Option<String> {
    let cause = of.cause.as_ref()?;
    Some(match cause.notice() {
        Some(Notice::Decided { reason }) => line(reason),
        _ => notice(cause),
    })
}

fn moment(RecordMoment { at_ms, wall, .. }: RecordMoment) -> String {
    record_time(at_ms, wall)
}

/// What a version is.
fn condition(of: &VersionStatus) -> String {
    let stage = of.stage.map_or("its next stage", Stage::name);
    match of.condition {
        VersionCondition::Queued => format!("queued for {stage}"),
        VersionCondition::Running => format!("in {stage}"),
        VersionCondition::Paused => "paused".to_owned(),
        VersionCondition::AwaitingApproval => "awaiting approval".to_owned(),
        VersionCondition::Held => "on hold".to_owned(),
        VersionCondition::Demoted => "returned to evaluation".to_owned(),
        VersionCondition::Provisional => "in control, provisional".to_owned(),
        VersionCondition::PromotionPaused => "in control, promotion paused".to_owned(),
        VersionCondition::Restricted => "in control, restricted".to_owned(),
        VersionCondition::Confirmed => "in control, confirmed".to_owned(),
        VersionCondition::Leaving => "being rolled back".to_owned(),
        VersionCondition::Superseded => "replaced".to_owned(),
        VersionCondition::Rejected => "rejected".to_owned(),
        VersionCondition::RolledBack => "rolled back".to_owned(),
    }
}

/// What a version waits for, and what ends its status.
#[must_use]
pub fn status_end(version: &CapabilityId, of: &VersionStatus) -> String {
    if let Some(obstacle) = &of.obstacle {
        return obstacle_sentence(version, obstacle);
    }
    let end = match of.ends {
        ConditionEnd::StageStart => "a running engine starts it",
        ConditionEnd::StageEnd => "ends with the stage",
        ConditionEnd::Resumption => "nothing moves it on until a person resumes it",
        ConditionEnd::Answers => "ends with the answers, or with their deadline",
        ConditionEnd::Retry => "waits for an operator to evaluate it again",
        ConditionEnd::Window => "its window has to pass without a trip",
        ConditionEnd::Release => "a person has to lift the restriction",
        ConditionEnd::Ladder => "ends with the rollback ladder",
        ConditionEnd::Replacement => "until another version replaces it, or it is rolled back",
        ConditionEnd::Return => "until its successor is rolled back to it",
        ConditionEnd::Nothing => "final",
    };
    end.to_owned()
}

fn obstacle_sentence(version: &CapabilityId, of: &Obstacle) -> String {
    match of {
        Obstacle::EngineAbsent => "waits for an engine: none runs".to_owned(),
        Obstacle::EngineHalted => "waits: the engine is halted".to_owned(),
        Obstacle::CellStopped => "waits: the cell is stopped".to_owned(),
        Obstacle::NoActiveVersion => {
            format!("waits until {} has an active version to compare it with", version.family)
        }
        Obstacle::ReviewOf { version } => format!("waits for the review of {version}"),
        Obstacle::Behind { version, work } => format!("waits for {version}, in {work}: one runs at a time"),
    }
}

#[cfg(test)]
mod tests {
    use holdpoint_governance::decision::{Dimension, Reason};
    use holdpoint_governance::finding::Finding;
    use holdpoint_governance::notice::{NoticeOrText, OperatorAct};
    use holdpoint_governance::version_status::RunningWork;

    use super::*;

    fn status(condition: VersionCondition, cause: Option<Notice>) -> VersionStatus {
        let since = Some(RecordMoment { record: 7, at_ms: 3_723_000, wall: None });
        VersionStatus {
            condition,
            stage: None,
            since,
            cause: cause.map(NoticeOrText::from),
            obstacle: None,
            ends: condition.end(),
        }
    }

    fn told(of: &VersionStatus) -> String {
        version_status(&"grasp@1.1.0".parse().unwrap(), of)
    }

    #[test]
    fn a_status_names_person_reason_time_and_end() {
        let (by, reason) = ("mia".to_owned(), "an odd noise".to_owned());
        let paused = Notice::OperatorDid { act: OperatorAct::Paused, by, reason };
        let status = |condition, cause| told(&status(condition, cause));
        assert_eq!(
            status(VersionCondition::Paused, Some(paused)),
            "paused since 01:02:03 (paused by mia: an odd noise); nothing moves it on until a person resumes it"
        );
        let trip = Reason::new(Dimension::Monitor, Finding::TripHolds);
        let rule = line(&trip);
        assert_eq!(
            status(VersionCondition::RolledBack, Some(Notice::decided(Some(&trip)))),
            format!("rolled back since 01:02:03 ({rule}); final")
        );
        assert_eq!(
            status(VersionCondition::Superseded, None),
            "replaced since 01:02:03; until its successor is rolled back to it"
        );
    }

    #[test]
    fn a_queued_version_names_what_it_waits_for() {
        let queued = VersionStatus {
            stage: Some(Stage::Sandbox),
            since: None,
            ..status(VersionCondition::Queued, None)
        };
        assert_eq!(told(&queued), "queued for sandbox; a running engine starts it");
        let behind =
            Obstacle::Behind { version: "align@2.0.0".parse().unwrap(), work: RunningWork::Confirmation };
        let behind = VersionStatus { obstacle: Some(behind), ..queued };
        assert_eq!(
            told(&behind),
            "queued for sandbox; waits for align@2.0.0, in confirmation: one runs at a time"
        );
        let interrupted = VersionStatus {
            stage: Some(Stage::Shadow),
            since: None,
            obstacle: Some(Obstacle::EngineAbsent),
            ..status(VersionCondition::Running, None)
        };
        assert_eq!(told(&interrupted), "in shadow; waits for an engine: none runs");
    }

    #[test]
    fn every_condition_has_words() {
        for condition in VersionCondition::ALL {
            let told = told(&status(condition, None));
            assert!(told.contains(" since 01:02:03"), "{condition}: {told}");
        }
    }
}
