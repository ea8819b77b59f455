//! Replays recorded approvals as of the gate's decision, in a regular activation and in break-glass.

use holdpoint_approvals::Approval;
use holdpoint_governance::approval::{
    self, ApprovalResult, Author, Authorship, QuorumRequest, SignatureCheck, Subject, Vote,
};
use holdpoint_governance::composition::Kappas;
use holdpoint_governance::decision::DecisionContext;
use holdpoint_governance::gate;
use holdpoint_governance::metrics::store_metrics::NotReplayable;
use holdpoint_governance::record::AuditRecord;
use holdpoint_governance::submission::Risk;
use holdpoint_governance::wall_time::WallTime;

use holdpoint_record::version_table::VersionEntry;

use super::{ReplayFailure, Replayer, RulesInForce, VersionRecords, wall_of};

impl Replayer<'_> {
    /// The result of approvals at the gate; absent if none were required, or none requested yet.
    pub(super) fn answers(
        &self,
        of: &VersionRecords,
        record: &AuditRecord,
        under: &DecisionContext,
        kappas: &Kappas,
        (risk, frame): (Risk, &RulesInForce),
    ) -> Result<Option<ApprovalResult>, ReplayFailure> {
        let provenance = self.capability(&of.id)?.submission.provenance;
        let quorum = gate::people_needed(kappas, (risk, provenance), &frame.table, &frame.profile);
        if quorum == 0 {
            return Ok(None);
        }
        let ordinary = |approval: &Approval| !approval.break_glass;
        self.approval_result(of, record, frame, (risk, quorum), votes(of, record, under, ordinary))
    }

    /// The result of one person's break-glass.
    pub(super) fn break_glass_result(
        &self,
        of: &VersionRecords,
        record: &AuditRecord,
        under: &DecisionContext,
        (risk, frame): (Risk, &RulesInForce),
    ) -> Result<Option<ApprovalResult>, ReplayFailure> {
        let mut votes = votes(of, record, under, |approval| approval.break_glass);
        let last = votes.pop().ok_or(NotReplayable::EvidenceMissing)?;
        let tier = approval::quorum(&frame.profile.approval, risk, false);
        // As break-glass does: one person never suffices for a regular activation.
        self.approval_result(of, record, frame, (risk, tier.max(2)), vec![last])
    }

    /// Votes on the subject of the last one, counted when a record was written.
    fn approval_result(
        &self,
        of: &VersionRecords,
        record: &AuditRecord,
        frame: &RulesInForce,
        (risk, quorum): (Risk, u8),
        votes: Vec<Vote>,
    ) -> Result<Option<ApprovalResult>, ReplayFailure> {
        let Some(subject) = votes.last().map(|vote| vote.subject) else { return Ok(None) };
        let VersionEntry { capability, origin, .. } = self.member(&of.id)?;
        let author_key = origin.author_key.clone().unwrap_or_default();
        let now = wall_of(record);
        let request = QuorumRequest {
            subject,
            risk,
            quorum,
            requester: origin.requester.clone(),
            // The name alone shows that the author is enrolled.
            author: Author {
                name: capability.submission.author.clone(),
                authorship: if author_key.is_empty() { Authorship::Unverified } else { Authorship::Signed },
                key: author_key,
            },
            asked_by: None,
            until: now.plus_secs(frame.profile.approval.timeout_s),
        };
        // An answer to an earlier request does not apply to this one.
        let votes: Vec<Vote> = votes.into_iter().filter(|vote| vote.subject == subject).collect();
        Ok(Some(approval::evaluate(&request, &votes, now, &frame.profile.approval)))
    }
}

/// When an answer stopped counting. Earlier versions counted in the engine's time.
fn until(approval: &Approval, record: &AuditRecord) -> WallTime {
    let until = approval.not_after();
    if until >= WallTime::SCRIPT_EPOCH {
        return until;
    }
    wall_of(record).plus_ms(approval.not_after_ms.saturating_sub(record.at_ms))
}

/// The recorded answers on the evidence of a decision, in order.
fn votes(
    of: &VersionRecords,
    record: &AuditRecord,
    under: &DecisionContext,
    counts: impl Fn(&Approval) -> bool,
) -> Vec<Vote> {
    let answers = of.approvals.iter().filter(|entry| entry.at_ms <= record.at_ms);
    let answers = answers.map(|entry| (entry.signed.approval(), entry.signed.public_key()));
    let ours = answers.filter(|(approval, _)| approval.evidence_digest == under.evidence && counts(approval));
    let vote = |(approval, key): (&Approval, &str)| Vote {
        person: approval.who.clone(),
        key: key.to_owned(),
        role: approval.role,
        answer: approval.decision,
        reason: approval.reason.clone(),
        subject: Subject {
            candidate: approval.candidate_digest,
            row_version: approval.row_version,
            evidence: approval.evidence_digest,
            policy: approval.policy_digest,
            profile: under.profile,
        },
        until: until(approval, record),
        break_glass: approval.break_glass,
        // Verified when it was received, and again by verification of the chain.
        signature: SignatureCheck::Valid,
        nonce_used: false,
    };
    ours.map(vote).collect()
}
