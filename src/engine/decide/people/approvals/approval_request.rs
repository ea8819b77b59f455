//! One open approval request and its answers so far.

use std::collections::BTreeSet;

use holdpoint_approvals::SignedApproval;
use holdpoint_governance::approval::{
    self, ApprovalDecision, ApprovalOutcome, ApprovalResult, QuorumRequest, SignatureCheck, Subject, Vote,
};
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::submission::Risk;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::snapshot::RequestKind;
use holdpoint_store::{ApprovalEntry, ApprovalRequest, RequestState};

use crate::decide::people::signers::rollback_target;
use crate::decide::recorder::EngineRecorder;
use crate::fault::EngineFault;
use holdpoint_record::context::Context;
use holdpoint_record::version_origin;

/// A signed answer, which the store verified when it recorded it.
#[derive(Clone, Debug, PartialEq)]
pub(in crate::decide::people) struct RecordedAnswer {
    pub(in crate::decide::people) signed: SignedApproval,
    /// When it was recorded.
    pub(in crate::decide::people) at: WallTime,
}

impl RecordedAnswer {
    /// A stored answer; a script's has only the engine's time.
    pub(in crate::decide::people) fn of(record: &EngineRecorder, entry: ApprovalEntry) -> Self {
        let at =
            entry.wall_ms.map_or_else(|| record.version_table().wall().now(entry.at_ms), WallTime::from_ms);
        Self { signed: entry.signed, at }
    }
}

/// An open request: its row in the store, what the rule counts, and the answers.
pub struct PendingApproval {
    /// The row without the text of the evidence.
    pub(in crate::decide::people) row: ApprovalRequest,
    pub(crate) kind: RequestKind,
    /// The subject of a release or a review.
    pub(in crate::decide::people) about: String,
    /// Whether its deadline has passed while it stays open: a review.
    pub(in crate::decide::people) overdue: bool,
    pub(in crate::decide::people) quorum: QuorumRequest,
    /// In the order of the record.
    pub(in crate::decide::people) answers: Vec<RecordedAnswer>,
    /// The version's row as the request names it: an answer over another one is void.
    pub(crate) life_row_version: u64,
    pub(in crate::decide::people) requested_at: WallTime,
    pub(in crate::decide::people) replaces: Option<CapabilityId>,
    /// Whether people override what a rule would not pass.
    pub(in crate::decide::people) review: bool,
}

/// The row of a new request about a version as it is now.
///
/// # Errors
/// If there is no such version.
pub(in crate::decide::people) fn new_row(
    context: &Context,
    record: &EngineRecorder,
    version: &CapabilityId,
    (evidence, quorum, until): (Digest, u8, WallTime),
) -> Result<ApprovalRequest, EngineFault> {
    let row_version = record.version_table().version(version)?.2.row_version;
    let now_ms = record.wall_now().ms();
    Ok(ApprovalRequest {
        // A request that is made again has another deadline, so it is another request.
        id: format!("{}-{}-{row_version}-{}-{now_ms}", version.family, version.version, evidence.short()),
        version: version.clone(),
        row_version,
        evidence_digest: evidence,
        policy_digest: context.digest,
        profile: context.profile.name,
        needed: u32::from(quorum),
        until,
        state: RequestState::Open,
        json: "{}".to_owned(),
    })
}

/// The rule's form of an answer. The signature is valid: the store stores no other.
pub(in crate::decide::people) fn vote(context: &Context, kind: RequestKind, answer: &SignedApproval) -> Vote {
    let approval = answer.approval();
    let profile =
        if approval.profile == context.profile.name { context.profile_digest } else { context.digest };
    Vote {
        person: approval.who.clone(),
        key: answer.public_key().to_owned(),
        role: approval.role,
        answer: approval.decision,
        reason: approval.reason.clone(),
        subject: Subject {
            candidate: approval.candidate_digest,
            row_version: approval.row_version,
            evidence: approval.evidence_digest,
            policy: approval.policy_digest,
            profile,
        },
        until: approval.not_after(),
        break_glass: approval.break_glass && kind == RequestKind::Emergency,
        signature: SignatureCheck::Valid,
        nonce_used: false,
    }
}

impl PendingApproval {
    /// A request of this row, without answers.
    ///
    /// # Errors
    /// If there is no such version.
    pub(in crate::decide::people) fn new(
        context: &Context,
        record: &EngineRecorder,
        row: ApprovalRequest,
        kind: RequestKind,
        risk: Risk,
    ) -> Result<Self, EngineFault> {
        let version = &row.version;
        let candidate = record.capability(version)?;
        let (_, lifecycle, member) = record.version_table().version(version)?;
        let subject = Subject {
            candidate: candidate.digest(),
            row_version: row.row_version,
            evidence: row.evidence_digest,
            policy: context.digest,
            profile: context.profile_digest,
        };
        let persons = record.version_table().store().persons()?;
        let quorum = QuorumRequest {
            subject,
            risk,
            quorum: u8::try_from(row.needed).unwrap_or(u8::MAX),
            requester: member.origin.requester.clone(),
            author: version_origin::author(&persons, member),
            asked_by: None,
            until: row.until,
        };
        let replaces = match kind {
            RequestKind::Activation | RequestKind::Emergency => {
                record.active_of(&version.family).map(|active| active.id())
            }
            RequestKind::Release | RequestKind::Review => rollback_target(record, version),
        };
        Ok(Self {
            kind,
            about: String::new(),
            overdue: false,
            quorum,
            answers: Vec::new(),
            life_row_version: lifecycle.row_version,
            requested_at: record.wall_now(),
            replaces,
            review: false,
            row: ApprovalRequest { json: "{}".to_owned(), ..row },
        })
    }

    /// The request as one that a person made, about this.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub(in crate::decide::people) fn asked_by(
        mut self,
        record: &EngineRecorder,
        name: &str,
        about: String,
    ) -> Result<Self, EngineFault> {
        let persons = record.version_table().store().persons()?;
        self.quorum.asked_by = Some(version_origin::person(&persons, name));
        self.about = about;
        Ok(self)
    }

    /// Whether it is about the version as its row is in the store, and its deadline has or has not passed likewise.
    #[must_use]
    pub const fn is_about(&self, row_version: u64, overdue: bool) -> bool {
        self.row.row_version == row_version && self.overdue == overdue
    }

    /// Whether the person's last answer was the same and has not expired: a repeat would add nothing.
    #[must_use]
    pub fn has_answered(&self, who: &str, decision: ApprovalDecision, now: WallTime) -> bool {
        let last =
            self.answers.iter().rev().map(|answer| answer.signed.approval()).find(|last| last.who == who);
        last.is_some_and(|last| last.decision == decision && now < last.not_after())
    }

    #[must_use]
    pub fn last_voter(&self) -> Option<String> {
        self.answers.last().map(|answer| answer.signed.approval().who.clone())
    }

    /// The signed approvals that counted: of each person the first that has not expired. The other answers are
    /// dropped, because the store does not accept them as approvals.
    #[must_use]
    pub fn into_counted(self, result: &ApprovalResult, now: WallTime) -> Vec<SignedApproval> {
        let ApprovalOutcome::Granted { people, .. } = &result.outcome else { return Vec::new() };
        let mut left: BTreeSet<&str> = people.iter().map(String::as_str).collect();
        let mut answers: Vec<SignedApproval> = self.answers.into_iter().map(|answer| answer.signed).collect();
        answers.retain(|answer| {
            let approval = answer.approval();
            let counts = approval.decision == ApprovalDecision::Approve && now < approval.not_after();
            counts && left.remove(approval.who.as_str())
        });
        answers
    }

    /// The answers as the rule counts them.
    pub(in crate::decide::people) fn votes(&self, context: &Context) -> Vec<Vote> {
        self.answers.iter().map(|answer| vote(context, self.kind, &answer.signed)).collect()
    }

    /// The result so far.
    #[must_use]
    pub fn result(&self, context: &Context, now: WallTime) -> ApprovalResult {
        approval::evaluate(&self.quorum, &self.votes(context), now, &context.profile.approval)
    }

    /// Its row in another state.
    #[must_use]
    pub fn row_as(&self, state: RequestState) -> ApprovalRequest {
        ApprovalRequest { state, ..self.row.clone() }
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
        let folder = crate::quick_folder::quick_folder();
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
        let answers = [
            signed(&ana, ApprovalDecision::Approve, 100),
            signed(&eve, ApprovalDecision::Approve, 9_000),
            signed(&ana, ApprovalDecision::Approve, 9_000),
            signed(&ben, ApprovalDecision::Approve, 9_000),
            signed(&ben, ApprovalDecision::Approve, 9_500),
        ];
        let subject =
            Subject { candidate: digest, row_version: 1, evidence: digest, policy: digest, profile: digest };
        let pending = PendingApproval {
            row: ApprovalRequest {
                id: "request".to_owned(),
                version: "align@1.1.0".parse().unwrap(),
                row_version: 1,
                evidence_digest: digest,
                policy_digest: digest,
                profile: ProfileName::Human,
                needed: 2,
                until: WallTime::from_ms(10_000),
                state: RequestState::Open,
                json: "{}".to_owned(),
            },
            kind: RequestKind::Activation,
            about: String::new(),
            overdue: false,
            quorum: QuorumRequest {
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
            answers: answers
                .iter()
                .map(|signed| RecordedAnswer { signed: signed.clone(), at: WallTime::default() })
                .collect(),
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
            pending.into_counted(&result, WallTime::from_ms(5_000)),
            [answers[2].clone(), answers[3].clone()]
        );
    }
}
