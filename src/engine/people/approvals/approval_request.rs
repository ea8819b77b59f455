//! One open approval request and its answers so far.

use std::collections::BTreeSet;

use holdpoint_approvals::SignedApproval;
use holdpoint_governance::approval::{
    self, ApprovalDecision, ApprovalOutcome, ApprovalResult, QuorumRequest, Subject, Vote,
};
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::submission::Risk;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::snapshot::RequestKind;

use crate::context::Context;
use crate::fault::EngineFault;
use crate::people::signers::rollback_target;
use crate::recorder::EngineRecorder;
use crate::version_origin;

/// Something that waits for people.
pub struct PendingApproval {
    pub(in crate::people) purpose: RequestKind,
    /// What a release or a review is about.
    pub(in crate::people) about: String,
    /// Its time is over and it stays open all the same: a review.
    pub(in crate::people) overdue: bool,
    pub(in crate::people) id: String,
    pub(in crate::people) request: QuorumRequest,
    pub(in crate::people) votes: Vec<Vote>,
    pub(in crate::people) signed: Vec<SignedApproval>,
    pub(in crate::people) evidence: Digest,
    pub(in crate::people) row_version: u64,
    pub(in crate::people) life_row_version: u64,
    pub(in crate::people) requested_at: WallTime,
    pub(in crate::people) replaces: Option<CapabilityId>,
    /// It takes people to override what a rule would not pass.
    pub(in crate::people) review: bool,
}

/// A new request about a version, with its quorum and deadline.
pub(in crate::people) struct NewApprovalRequest {
    pub(in crate::people) id: String,
    pub(in crate::people) purpose: RequestKind,
    pub(in crate::people) about: String,
    /// Who put this very question; absent for an activation.
    pub(in crate::people) asked_by: Option<String>,
    pub(in crate::people) evidence: Digest,
    pub(in crate::people) quorum: u8,
    /// Risk class of the version, as it was assessed.
    pub(in crate::people) risk: Risk,
    pub(in crate::people) review: bool,
    /// When it was asked.
    pub(in crate::people) requested_at: WallTime,
    /// From this time on every answer is too late.
    pub(in crate::people) until: WallTime,
}

impl PendingApproval {
    /// A question about a version as its row stands now, without answers.
    ///
    /// # Errors
    /// If there is no such version.
    pub(in crate::people) fn new(
        context: &Context,
        record: &EngineRecorder,
        id: &CapabilityId,
        new_request: NewApprovalRequest,
    ) -> Result<Self, EngineFault> {
        let candidate = record.capability(id)?;
        let (_, state, member) = record.version_table().version(id)?;
        let NewApprovalRequest {
            id: question,
            purpose,
            about,
            asked_by,
            evidence,
            quorum,
            risk,
            review,
            requested_at,
            until,
        } = new_request;
        let row_version = member.row_version;
        let subject = Subject {
            candidate: candidate.digest(),
            row_version,
            evidence,
            policy: context.digest,
            profile: context.profile_digest,
        };
        let persons = record.version_table().store().persons()?;
        let request = QuorumRequest {
            subject,
            risk,
            quorum,
            requester: member.origin.requester.clone(),
            author: version_origin::author(&persons, member),
            asked_by: asked_by.map(|name| version_origin::person(&persons, &name)),
            until,
        };
        let active = record.active_of(&id.family).map(|active| active.id());
        let replaces = match purpose {
            RequestKind::Activation | RequestKind::Emergency => active,
            RequestKind::Release | RequestKind::Review => rollback_target(record, id),
        };
        Ok(Self {
            purpose,
            about,
            overdue: false,
            id: question,
            request,
            votes: Vec::new(),
            signed: Vec::new(),
            evidence,
            row_version,
            life_row_version: state.row_version,
            requested_at,
            replaces,
            review,
        })
    }

    /// The version's row as the question names it: an answer over another one is void.
    #[must_use]
    pub const fn life_row_version(&self) -> u64 {
        self.life_row_version
    }

    /// The kind of request.
    #[must_use]
    pub const fn purpose(&self) -> RequestKind {
        self.purpose
    }

    /// Whether it is asked about the version as its row stands in the store, and its time stands likewise.
    #[must_use]
    pub const fn is_about(&self, row_version: u64, overdue: bool) -> bool {
        self.row_version == row_version && self.overdue == overdue
    }

    /// Whether the person's last answer was the same and has not run out: a repeat would add nothing.
    #[must_use]
    pub fn has_answered(&self, who: &str, answer: ApprovalDecision, now: WallTime) -> bool {
        let last = self.votes.iter().rev().find(|vote| vote.person == who);
        last.is_some_and(|last| last.answer == answer && now < last.until)
    }

    #[must_use]
    pub fn last_voter(&self) -> Option<String> {
        self.signed.last().map(|signed| signed.approval().who.clone())
    }

    /// The signed approvals that counted: of each person the first that has not run out. The other answers are
    /// dropped, because the store does not accept them as approvals.
    #[must_use]
    pub fn into_counted(self, result: &ApprovalResult, now: WallTime) -> Vec<SignedApproval> {
        let ApprovalOutcome::Granted { people, .. } = &result.outcome else { return Vec::new() };
        let mut left: BTreeSet<&str> = people.iter().map(String::as_str).collect();
        let mut signed = self.signed;
        signed.retain(|signed| {
            let approval = signed.approval();
            let counts = approval.decision == ApprovalDecision::Approve && now < approval.not_after();
            counts && left.remove(approval.who.as_str())
        });
        signed
    }

    /// The result so far.
    #[must_use]
    pub fn result(&self, context: &Context, now: WallTime) -> ApprovalResult {
        approval::evaluate(&self.request, &self.votes, now, &context.profile.approval)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_approvals::{Approval, Identity, Nonce};
    use holdpoint_governance::approval::{Author, Authorship, Requester, Role};
    use holdpoint_governance::profile::ProfileName;

    /// One answer that had run out was used all the same, the store refused it, and the engine held.
    #[test]
    fn uncounted_approvals_are_dropped() {
        let folder = tempfile::tempdir().unwrap();
        let digest = Digest::of_parts("test", &[b"question"]);
        let signed = |who: &Identity, decision: ApprovalDecision, not_after_ms: u64| {
            who.sign(Approval {
                who: String::new(),
                role: Role::Engineer,
                decision,
                reason: "a test".to_owned(),
                version: "align@1.1.0".parse().unwrap(),
                candidate_digest: digest,
                row_version: 1,
                evidence_digest: digest,
                policy_digest: digest,
                profile: ProfileName::Human,
                store_id: "a store".to_owned(),
                nonce: Nonce::random().unwrap(),
                not_after_ms,
                break_glass: false,
                shown: None,
            })
            .unwrap()
        };
        let [ana, ben, eve] =
            ["ana", "ben", "eve"].map(|name| Identity::create(folder.path(), name, Role::Engineer).unwrap());
        let answers = vec![
            signed(&ana, ApprovalDecision::Approve, 100),
            signed(&eve, ApprovalDecision::Approve, 9_000),
            signed(&ana, ApprovalDecision::Approve, 9_000),
            signed(&ben, ApprovalDecision::Approve, 9_000),
            signed(&ben, ApprovalDecision::Approve, 9_500),
        ];
        let subject =
            Subject { candidate: digest, row_version: 1, evidence: digest, policy: digest, profile: digest };
        let question = PendingApproval {
            purpose: RequestKind::Activation,
            about: String::new(),
            overdue: false,
            id: "question".to_owned(),
            request: QuorumRequest {
                subject,
                risk: Risk::Low,
                quorum: 2,
                requester: Requester::Script,
                author: Author {
                    name: "eve".to_owned(),
                    authorship: Authorship::Unverified,
                    key: String::new(),
                },
                asked_by: None,
                until: WallTime::from_ms(10_000),
            },
            votes: Vec::new(),
            signed: answers.clone(),
            evidence: digest,
            row_version: 1,
            life_row_version: 1,
            requested_at: WallTime::default(),
            replaces: None,
            review: false,
        };
        let people = ["ana", "ben"].map(ToOwned::to_owned).into_iter().collect();
        let outcome =
            ApprovalOutcome::Granted { people, until: WallTime::from_ms(9_000), break_glass: false };
        let result = ApprovalResult { outcome, reasons: Vec::new() };
        assert_eq!(
            question.into_counted(&result, WallTime::from_ms(5_000)),
            [answers[2].clone(), answers[3].clone()]
        );
    }
}
