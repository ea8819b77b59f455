//! The rows of view 6: monitors' questions, requests for approval, and versions that stand until a person resumes them.
//!
//! Owns their order. The views draw them, and the reducer opens the one under the cursor.

use super::action::Action;
use super::model::{ConsoleModel, ItemKey};
use holdpoint_governance::approval::Requester;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::version_status::VersionCondition;
use holdpoint_protocol::snapshot::{ApprovalRequestView, CandidateView, EscalationView};

/// A row of what waits for people.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum WaitingRow<'a> {
    /// A drift monitor's question: without an answer, a rollback at the deadline. These come first.
    MonitorQuestion(&'a EscalationView),
    /// An approval request: without an answer, the candidate stays on hold.
    Approval(&'a ApprovalRequestView),
    /// A paused, held or demoted version: without a person, it stays so. It has no deadline and comes last.
    Standing(&'a CandidateView),
}

impl WaitingRow<'_> {
    /// Its version.
    #[must_use]
    pub const fn version(&self) -> &CapabilityId {
        match self {
            Self::MonitorQuestion(question) => &question.version,
            Self::Approval(prompt) => &prompt.version,
            Self::Standing(candidate) => &candidate.version,
        }
    }

    /// What the cursor follows.
    #[must_use]
    pub fn item_key(&self) -> ItemKey {
        match self {
            Self::MonitorQuestion(question) => ItemKey::Question(question.version.clone()),
            Self::Approval(prompt) => ItemKey::Prompt(prompt.id.clone()),
            Self::Standing(candidate) => ItemKey::Version(candidate.version.clone()),
        }
    }
}

/// Whether no approval of this person counts: it is the requester or the author, or has approved.
#[must_use]
pub fn is_closed_to(prompt: &ApprovalRequestView, name: &str) -> bool {
    let has_requested = matches!(&prompt.requester, Requester::Person { name: by, .. } if by == name);
    has_requested || prompt.author == name || prompt.approved_by.iter().any(|by| by == name)
}

/// The word for a version that stands until a person acts, and the action that ends that; absent if it does not stand.
#[must_use]
pub const fn standing(condition: VersionCondition) -> Option<(&'static str, Action)> {
    match condition {
        VersionCondition::Paused | VersionCondition::PromotionPaused => Some(("paused", Action::Resume)),
        VersionCondition::Held => Some(("on hold", Action::Resume)),
        VersionCondition::Demoted => Some(("demoted", Action::Repeat)),
        VersionCondition::Queued
        | VersionCondition::Running
        | VersionCondition::AwaitingApproval
        | VersionCondition::Provisional
        | VersionCondition::Restricted
        | VersionCondition::Confirmed
        | VersionCondition::Leaving
        | VersionCondition::Superseded
        | VersionCondition::Rejected
        | VersionCondition::RolledBack => None,
    }
}

impl ConsoleModel {
    /// What waits for people: monitors' questions first, then requests, each kind the most urgent first, then versions that
    /// stand, the newest first.
    #[must_use]
    pub fn waiting_rows(&self) -> Vec<WaitingRow<'_>> {
        let Some(snapshot) = &self.engine_data.snapshot else { return Vec::new() };
        let mut questions: Vec<&EscalationView> = snapshot.questions.iter().collect();
        questions.sort_by_key(|question| question.deadline_ms);
        let mut prompts: Vec<&ApprovalRequestView> = snapshot.prompts.iter().collect();
        prompts.sort_by_key(|prompt| prompt.until);
        let stands = |candidate: &&CandidateView| standing(snapshot.status(candidate).condition).is_some();
        let versions = snapshot.candidates.iter().rev().filter(stands);
        let questions = questions.into_iter().map(WaitingRow::MonitorQuestion);
        let prompts = prompts.into_iter().map(WaitingRow::Approval);
        questions.chain(prompts).chain(versions.map(WaitingRow::Standing)).collect()
    }
}
