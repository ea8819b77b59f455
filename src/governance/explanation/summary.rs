//! A version in short: what it is now, the reasons for that, and what ends it.
//!
//! Typed values for the short form of `explain`. The engine reads them from the store, and the crate `holdpoint-wording`
//! makes the lines.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::{DecisionRemark, DrillComparison, ReasonContent, ReasonMeasurement, Remedy};
use crate::approval::Role;
use crate::condition::Condition;
use crate::decision::{Dimension, Reason};
use crate::failure_cause::FailureCause;
use crate::ids::CapabilityId;
use crate::lifecycle::Stage;
use crate::notice::NoticeOrText;
use crate::past_limit::MeasuredInTask;
use crate::permission::PermissionExcess;
use crate::record::ActivationCause;
use crate::rollback::PostStatus;
use crate::start_domain::StartDomain;
use crate::tries::CountedTry;
use crate::version_status::VersionStatus;
use crate::wall_time::WallTime;

/// A version in short.
#[derive(Clone, Debug, PartialEq)]
pub struct ExplanationSummary {
    /// The version.
    pub version: CapabilityId,
    /// What it is now.
    pub position: VersionPosition,
    /// The record that made it so.
    pub since: RecordMoment,
    /// The version that it was compared with; absent if there is none, or the record does not name a version near it.
    pub compared: Option<CapabilityId>,
    /// The reasons against it, the strongest first.
    pub against: Vec<DecisiveReason>,
    /// The checks that it passed, as far as they were measured.
    pub passed: Vec<PassedCheck>,
    /// What else its operators have to know.
    pub remarks: Vec<SummaryRemark>,
    /// What would change the result: only of what failed.
    pub remedies: Vec<Remedy>,
    /// Whether its recording can be replayed.
    pub has_recording: bool,
}

/// A record and its time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
pub struct RecordMoment {
    /// Number of the record.
    pub record: u64,
    /// Virtual time, ms.
    pub at_ms: u64,
    /// Wall time; absent in scripts.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub wall: Option<WallTime>,
}

/// What a version is now.
#[derive(Clone, Debug, PartialEq)]
#[allow(missing_docs, reason = "a field is named as the thing that it is")]
pub enum VersionPosition {
    /// A rule of this stage rejected it, by what the stage had measured.
    Rejected { stage: Stage, extent: EvidenceExtent },
    /// A person rejected it.
    RejectedByPeople(DecisionRemark),
    /// It was in control and was rolled back. `target`: the version that took over, if any. `measured`: the live task
    /// of a safety event.
    RolledBack {
        status: PostStatus,
        target: Option<CapabilityId>,
        cause: NoticeOrText,
        measured: Option<MeasuredInTask>,
    },
    /// It was returned to evaluation before it was in control. `stage` is absent if a person or a deadline did it,
    /// `cause` where the reasons of the stage say it.
    Returned { stage: Option<Stage>, cause: Option<NoticeOrText> },
    /// Another version replaced it; absent if the record does not name it.
    Superseded { by: Option<CapabilityId>, is_target: bool },
    /// It is in control.
    Active(ActiveTerms),
    /// It waits.
    Waiting(PendingStep),
}

/// How much a stage measured. What it does not measure is 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EvidenceExtent {
    /// Episode pairs.
    pub pairs: u64,
    /// Drills of the candidate.
    pub drills: u64,
    /// Sequences in shadow.
    pub sequences: u64,
}

/// How a version is active.
#[derive(Clone, Debug, PartialEq)]
pub struct ActiveTerms {
    /// Why the family's pointer moved to it.
    pub cause: ActivationCause,
    /// Whose approvals the activation used.
    pub approvers: Vec<Approver>,
    /// Whether one of them used break-glass.
    pub is_break_glass: bool,
    /// The people who reviewed a break-glass activation.
    pub reviewed_by: Vec<String>,
    /// The version that a rollback activates; absent if there is none.
    pub target: Option<CapabilityId>,
    /// The conditions of use in force.
    pub conditions: Vec<Condition>,
    /// Whether its provisional window is still open.
    pub is_provisional: bool,
    /// Whether its envelope is tightened.
    pub is_restricted: bool,
}

/// A person whose approval counts.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Approver {
    /// The person, by name.
    pub person: String,
    /// The role the person answered in.
    pub role: Role,
}

/// What a version waits for.
#[derive(Clone, Debug, PartialEq, Eq)]
#[allow(missing_docs, reason = "a field is named as the thing that it is")]
pub enum PendingStep {
    /// Approvers answer a request: distinct people needed, and those on record with an approval of the same evidence.
    Approval { needed: u32, approved_by: Vec<String>, until: WallTime },
    /// An operator resumes it: too few people answered by this time.
    Unanswered(WallTime),
    /// An operator resumes it: a person paused it.
    Resumption,
    /// The causes of the gate's decision end.
    Gate,
    /// The stage that runs ends.
    StageEnd(Stage),
    /// An engine starts this stage.
    StageStart(Stage),
}

/// Failed tasks of the pairs, by their cause; the most frequent first.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FailureCounts {
    /// Pairs.
    pub pairs: usize,
    /// Of the version.
    pub own: Vec<(FailureCause, usize)>,
    /// Of the version compared with.
    pub other: Vec<(FailureCause, usize)>,
}

/// Failed tasks of the twins that a version drove in shadow, by their cause; the most frequent first.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TwinFailures {
    /// Tasks of the twins.
    pub tasks: usize,
    /// Failed ones.
    pub own: Vec<(FailureCause, usize)>,
}

/// A reason against a version, with what it rests on.
#[derive(Clone, Debug, PartialEq)]
pub struct DecisiveReason {
    /// What was found, with its numbers.
    pub content: ReasonContent,
    /// The measurement; absent for what is looked up.
    pub measured: Option<ReasonMeasurement>,
}

/// A check that a version passed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PassedCheck {
    /// The check.
    pub of: Dimension,
    /// Its value, 0 to 1; absent for shadow, and where a restriction stands in its place.
    pub kappa: Option<f64>,
    /// Whether it passed under conditions.
    pub is_restricted: bool,
    /// Sequences it rests on; only of shadow.
    pub sequences: Option<u32>,
}

/// What operators have to know of a version beside its reasons.
#[derive(Clone, Debug, PartialEq)]
pub enum SummaryRemark {
    /// It used more than it declares.
    BeyondDeclaration(PermissionExcess),
    /// Its drills of a kind passed less often than those of the version compared with.
    FewerDrillsPassed(DrillComparison),
    /// Why its tasks failed in the pairs, physically.
    FailureCauses(FailureCounts),
    /// Why tasks of its twins failed in shadow.
    TwinFailures(TwinFailures),
    /// What its evidence covers of the start of a task.
    Covered(StartDomain),
    /// It carries an open concern.
    OpenConcern(Reason),
    /// The try that its sandbox counted as.
    Counted(CountedTry),
    /// Its break-glass activation waits for a review until then.
    ReviewUntil(WallTime),
    /// It is paused, on hold, restricted, or being rolled back: since when, by whom or by which rule, and what ends that.
    Limited(VersionStatus),
}
