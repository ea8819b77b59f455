//! What people's answers on record came to when the gate was asked, in the ordinary way and at the emergency door.

use holdpoint_approvals::Approval;
use holdpoint_governance::approval::{
    self, ApprovalResult, Author, Authorship, Request, SignatureCheck, Subject, Vote,
};
use holdpoint_governance::composition::Kappas;
use holdpoint_governance::decision::MadeUnder;
use holdpoint_governance::gate;
use holdpoint_governance::metrics::observed::NotReplayable;
use holdpoint_governance::record::AuditRecord;
use holdpoint_governance::submission::Risk;
use holdpoint_governance::wall_time::WallTime;

use crate::ledger::Member;

use super::{Failed, Replayer, RulesInForce, VersionOnRecord, wall_of};

impl Replayer<'_> {
    /// What people had answered when the gate was asked; absent if nobody had to be, or nobody was asked yet.
    pub(super) fn answers(
        &self,
        of: &VersionOnRecord,
        record: &AuditRecord,
        under: &MadeUnder,
        kappas: &Kappas,
        (risk, frame): (Risk, &RulesInForce),
    ) -> Result<Option<ApprovalResult>, Failed> {
        let provenance = self.capability(&of.id)?.submission.provenance;
        let quorum = gate::people_needed(kappas, (risk, provenance), &frame.table, &frame.profile);
        if quorum == 0 {
            return Ok(None);
        }
        let ordinary = |said: &Approval| !said.break_glass;
        self.asked(of, record, frame, (risk, quorum), votes(of, record, under, ordinary))
    }

    /// What one person's word at the emergency door came to.
    pub(super) fn emergency(
        &self,
        of: &VersionOnRecord,
        record: &AuditRecord,
        under: &MadeUnder,
        (risk, frame): (Risk, &RulesInForce),
    ) -> Result<Option<ApprovalResult>, Failed> {
        let mut votes = votes(of, record, under, |said| said.break_glass);
        let last = votes.pop().ok_or(NotReplayable::EvidenceMissing)?;
        let tier = approval::quorum(&frame.profile.approval, risk, false);
        // As the door asks: one person is never enough in the ordinary way.
        self.asked(of, record, frame, (risk, tier.max(2)), vec![last])
    }

    /// Votes over what the last of them is over, counted when a record was written.
    fn asked(
        &self,
        of: &VersionOnRecord,
        record: &AuditRecord,
        frame: &RulesInForce,
        (risk, quorum): (Risk, u8),
        votes: Vec<Vote>,
    ) -> Result<Option<ApprovalResult>, Failed> {
        let Some(subject) = votes.last().map(|vote| vote.subject) else { return Ok(None) };
        let Member { capability, origin, .. } = self.member(&of.id)?;
        let author_key = origin.author_key.clone().unwrap_or_default();
        let now = wall_of(record);
        let request = Request {
            subject,
            risk,
            quorum,
            requester: origin.requester.clone(),
            // That an enrolled person has the name is told by the name.
            author: Author {
                name: capability.submission.author.clone(),
                authorship: if author_key.is_empty() { Authorship::Unverified } else { Authorship::Signed },
                key: author_key,
            },
            asked_by: None,
            until: now.plus_secs(frame.profile.approval.timeout_s),
        };
        // An answer to an earlier question was never put to this one.
        let votes: Vec<Vote> = votes.into_iter().filter(|vote| vote.subject == subject).collect();
        Ok(Some(approval::evaluate(&request, &votes, now, &frame.profile.approval)))
    }
}

/// From when on an answer did not count any more. Earlier versions counted in the engine's time.
fn until(said: &Approval, record: &AuditRecord) -> WallTime {
    let until = said.not_after();
    if until >= WallTime::SCRIPT_EPOCH {
        return until;
    }
    wall_of(record).plus_ms(said.not_after_ms.saturating_sub(record.at_ms))
}

/// The answers that were on record over the evidence of a decision, in order.
fn votes(
    of: &VersionOnRecord,
    record: &AuditRecord,
    under: &MadeUnder,
    counts: impl Fn(&Approval) -> bool,
) -> Vec<Vote> {
    let said = of.approvals.iter().filter(|entry| entry.at_ms <= record.at_ms);
    let said = said.map(|entry| (entry.signed.approval(), entry.signed.public_key()));
    let ours = said.filter(|(said, _)| said.evidence_digest == under.evidence && counts(said));
    let vote = |(said, key): (&Approval, &str)| Vote {
        person: said.who.clone(),
        key: key.to_owned(),
        role: said.role,
        answer: said.decision,
        reason: said.reason.clone(),
        subject: Subject {
            candidate: said.candidate_digest,
            row_version: said.row_version,
            evidence: said.evidence_digest,
            policy: said.policy_digest,
            profile: under.profile,
        },
        until: until(said, record),
        break_glass: said.break_glass,
        // Checked when it came in, and again by whoever verifies the chain.
        signature: SignatureCheck::Valid,
        nonce_used: false,
    };
    ours.map(vote).collect()
}
