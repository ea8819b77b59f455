//! The status of a version in a snapshot: the facts for [`VersionStatus::of`], of which the queue of candidates is one.
//!
//! Also how far a version's stage is. Reads a snapshot and nothing else. Owns no sentence.

use holdpoint_governance::lifecycle::{Stage, State};
use holdpoint_governance::version_status::{
    Obstacle, RecordedChanges, RunningWork, StatusFacts, VersionCondition, VersionStatus,
};

use super::{CandidateView, ProgressView, Snapshot};
use crate::work_unit::PartCount;

/// How far a version's stage is; absent if it has left the pipeline, despite an older count.
#[must_use]
pub const fn current_progress(candidate: &CandidateView) -> Option<&ProgressView> {
    let rests = matches!(candidate.state, State::Demoted) && candidate.flags.running.is_none();
    if candidate.state.is_terminal() || rests { None } else { candidate.progress.as_ref() }
}

/// How far the re-evaluation of an active, inconclusive version is. Its confirmation counts as sandbox, this as
/// shadow.
#[must_use]
pub fn re_evaluation(version: &CandidateView) -> Option<&ProgressView> {
    current_progress(version)
        .filter(|progress| version.state == State::Active && progress.stage == Stage::Shadow)
}

/// Whether a stage of a version is running. A new stage has no count yet.
#[must_use]
pub const fn is_at_work(candidate: &CandidateView) -> bool {
    let has_begun = current_progress(candidate).is_some()
        || (candidate.flags.running.is_some() && !candidate.flags.paused);
    has_begun && !candidate.parked
}

/// Whether a stage of a version has begun and waits for that of another one.
#[must_use]
pub const fn waits_its_turn(candidate: &CandidateView) -> bool {
    let condition = VersionCondition::of(candidate.state, &candidate.flags, candidate.held);
    candidate.parked && matches!(condition, VersionCondition::Running)
}

/// What runs of a version that is at work.
fn running_work(of: &CandidateView) -> RunningWork {
    let stage = of.progress.as_ref().map(|progress| progress.stage).or(of.flags.running);
    match stage {
        _ if re_evaluation(of).is_some() => RunningWork::ReEvaluation,
        // Fresh evidence about an active version counts as sandbox.
        _ if of.state == State::Active => RunningWork::Confirmation,
        Some(Stage::Validation) | None => RunningWork::Validation,
        Some(Stage::Sandbox) => RunningWork::Sandbox,
        Some(Stage::Shadow) => RunningWork::Shadow,
        Some(Stage::Activation) => RunningWork::Activation,
    }
}

impl ProgressView {
    /// The count of the unit that runs, against its own budget.
    #[must_use]
    pub fn unit_count(&self) -> PartCount {
        self.part.unwrap_or(PartCount { done: self.done, budget: self.budget })
    }
}

impl Snapshot {
    /// The status of a candidate: the engine's, or without one, as of an older engine, what the snapshot alone shows.
    #[must_use]
    pub fn status(&self, candidate: &CandidateView) -> VersionStatus {
        let given = candidate.status.clone();
        given.unwrap_or_else(|| self.status_by(candidate, &RecordedChanges::default()))
    }

    /// The status of a candidate by its row, this snapshot and the record.
    #[must_use]
    pub fn status_by(&self, candidate: &CandidateView, recorded: &RecordedChanges) -> VersionStatus {
        let obstacle = self.obstacle(candidate);
        let CandidateView { state, flags, held, reasons, .. } = candidate;
        VersionStatus::of(&StatusFacts {
            state: *state,
            flags,
            held: *held,
            reasons,
            obstacle: obstacle.as_ref(),
            recorded,
        })
    }

    /// Why a candidate stands still although no person holds it; absent if it does not, or has left evaluation.
    fn obstacle(&self, candidate: &CandidateView) -> Option<Obstacle> {
        if matches!(candidate.state, State::Active | State::Superseded | State::Rejected | State::RolledBack)
        {
            return None;
        }
        if self.holding.is_some() {
            return Some(Obstacle::EngineHalted);
        }
        if self.stopped.is_some() {
            return Some(Obstacle::CellStopped);
        }
        if is_at_work(candidate) {
            return None;
        }
        let family = self.families.iter().find(|family| family.family == candidate.version.family);
        let compares = !matches!(candidate.state, State::Registered | State::Shadowed);
        if compares && family.is_some_and(|family| family.active.is_none()) {
            return Some(Obstacle::NoActiveVersion);
        }
        // A demoted version waits for a person, not for a place in the queue.
        if candidate.state == State::Demoted {
            return None;
        }
        if let Some(review) = family.and_then(|family| family.review.as_ref()) {
            return Some(Obstacle::ReviewOf { version: review.version.clone() });
        }
        let mut others = self.candidates.iter().filter(|other| other.version != candidate.version);
        let other = others.find(|other| is_at_work(other))?;
        Some(Obstacle::Behind { version: other.version.clone(), work: running_work(other) })
    }
}
