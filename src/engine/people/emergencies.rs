//! The emergency door (break-glass): what one person can let in alone, and the review that follows.
//!
//! Puts questions and says who may use the door; what a vote comes to is the rules'
//! ([`holdpoint_governance::approval`]), and what is let in is still the gate's.

use holdpoint_approvals::SignedApproval;
use holdpoint_governance::approval::{
    self, Answer, ApprovalResult, REVIEWERS, SignatureCheck, Subject, Vote,
};
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::lifecycle::{Review, Stage, State};
use holdpoint_governance::submission::Risk;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_protocol::command::{Refusal, Reply};
use holdpoint_protocol::snapshot::{PromptView, Purpose};
use holdpoint_registry::names::RequestState;
use holdpoint_registry::{ApprovalRequest, Change};
use holdpoint_text::is_visible;

use super::approvals::{Approvals, NewQuestion, PendingQuestion, closing_note, tier, view};
use super::asking::Shown;
use super::signers::signer;
use crate::context::Context;
use crate::dossier::{Dossier, Dossiers};
use crate::fault::Fault;
use crate::origin;
use crate::record::Record;

/// An emergency approval that the rules count, and until when it holds.
pub(crate) struct Emergency {
    pub(crate) signed: SignedApproval,
    /// What they were shown.
    pub(crate) shown: Shown,
    pub(crate) result: ApprovalResult,
    /// By when it has to be reviewed.
    pub(crate) until: WallTime,
}

/// Who broke the glass for a version, and why, as the store has it.
fn broken_by(record: &Record, id: &CapabilityId) -> Result<Option<SignedApproval>, Fault> {
    let kept = record.ledger().store().views()?.approvals(id)?;
    Ok(kept.into_iter().rev().map(|entry| entry.signed).find(|signed| signed.approval().break_glass))
}

/// What an emergency approval of a version has to be signed over now; absent if the door is not for it.
pub(super) fn door(
    context: &Context,
    record: &Record,
    dossiers: &Dossiers,
    id: &CapabilityId,
) -> Option<PendingQuestion> {
    let settings = context.profile.approval;
    let entry = record.ledger().family(&id.family).ok()?;
    let (_, standing, member) = entry.find(id)?;
    let stands = standing.state == State::Shadowed
        && !standing.flags.paused
        && matches!(standing.flags.running, None | Some(Stage::Activation));
    let dossier = dossiers.of(id)?;
    let waits = dossier.held || standing.flags.awaiting_approval;
    if !(settings.break_glass && stands && waits && entry.state.review.is_none()) {
        return None;
    }
    let evidence = dossier.digest().ok()?;
    let now = record.wall_now();
    let risk = origin::assessed_risk(dossier);
    let asked = NewQuestion {
        id: format!("{}-{}-{}-emergency", id.family, id.version, member.row_version),
        purpose: Purpose::Emergency,
        about: String::new(),
        asked_by: None,
        evidence,
        // One person is never enough in the ordinary way: it counts as an emergency or not at all.
        quorum: approval::quorum(&settings, risk, false).max(2),
        risk,
        review: true,
        asked: now,
        until: now.plus_secs(settings.break_glass_valid_s),
    };
    PendingQuestion::new(context, record, id, asked).ok()
}

/// Versions that one person may let in by the emergency door now.
pub(crate) fn views(context: &Context, record: &Record, dossiers: &Dossiers) -> Vec<PromptView> {
    let mut found = Vec::new();
    if !context.profile.approval.break_glass {
        return found;
    }
    for (_, entry) in record.ledger().families() {
        for member in &entry.members {
            let id = member.capability.id();
            if let Some(question) = door(context, record, dossiers, &id) {
                let mut shown = view(context, record, dossiers, &id, &question);
                shown.valid_until = question.request.until;
                shown.tier = tier(context.profile.name, 2, true);
                found.push(shown);
            }
        }
    }
    found
}

/// Holds an emergency approval against everything it has to be. Changes nothing.
///
/// # Errors
/// If the version cannot be read.
pub(crate) fn check(
    context: &Context,
    record: &Record,
    dossiers: &Dossiers,
    approvals: &Approvals,
    signed: SignedApproval,
) -> Result<Result<Emergency, Reply>, Fault> {
    let refuse = |code, text: String, hint: Option<&str>| {
        Ok(Err(Reply::Refused { code, text, hint: hint.map(ToOwned::to_owned) }))
    };
    let identity = match signer(context, record, &signed) {
        Ok(identity) => identity,
        Err(refused) => return Ok(Err(refused)),
    };
    let said = signed.approval().clone();
    let (id, settings) = (&said.version, context.profile.approval);
    if !settings.break_glass {
        let text = format!("the profile {} has no emergency door", context.profile.name.name());
        return refuse(Refusal::NotAllowed, text, Some("people approve it, or it waits"));
    }
    if said.decision != Answer::Approve || !is_visible(&said.reason) {
        let text = "the emergency door takes an approval with a reason".to_owned();
        return refuse(Refusal::BadInput, text, None);
    }
    let Some(question) = door(context, record, dossiers, id) else {
        let text = format!("{id} is nothing that people or the calendar hold back after shadow");
        return refuse(
            Refusal::NotNow,
            text,
            Some("the emergency door replaces no stage and no measurement"),
        );
    };
    let profile = if said.profile == context.profile.name { context.profile_digest } else { context.digest };
    let subject = Subject {
        candidate: said.candidate_digest,
        row_version: said.row_version,
        evidence: said.evidence_digest,
        policy: said.policy_digest,
        profile,
    };
    let vote = Vote {
        person: said.who.clone(),
        key: signed.public_key().to_owned(),
        role: identity.role,
        answer: said.decision,
        reason: said.reason.clone(),
        subject,
        until: said.not_after(),
        break_glass: said.break_glass,
        signature: SignatureCheck::Valid,
        nonce_used: false,
    };
    let result = approval::evaluate(&question.request, &[vote], record.wall_now(), &settings);
    if !result.is_emergency() {
        let why = result.reasons.last().map_or_else(String::new, |reason| reason.text.clone());
        return refuse(Refusal::NotAllowed, format!("{id} is not let in: {why}"), None);
    }
    let shown = match approvals.shown_now(context, record, dossiers, &question, signed.approval())? {
        Ok(Some(shown)) => shown,
        Ok(None) => {
            return refuse(Refusal::BadInput, "it is signed over nothing that was shown".to_owned(), None);
        }
        Err(refused) => return Ok(Err(refused)),
    };
    let until = said.not_after().min(question.request.until);
    Ok(Ok(Emergency { signed, shown, result, until }))
}

impl Approvals {
    /// Asks two people to review an emergency activation, in place of what was asked about the version before.
    ///
    /// # Errors
    /// If the question cannot be written.
    pub(crate) fn ask_review(
        &mut self,
        context: &Context,
        record: &mut Record,
        dossiers: &Dossiers,
        id: &CapabilityId,
        review: Review,
    ) -> Result<(), Fault> {
        let mut changes = Vec::new();
        if let Some(old) = self.close(id) {
            changes = closing_note(context, id, &old, RequestState::Void, "").before;
        }
        let risk = dossiers.of(id).map_or(Risk::High, origin::assessed_risk);
        let candidate = record.capability(id)?;
        let row_version = record.ledger().version(id)?.2.row_version;
        let now = record.wall_now();
        let overdue = review.until <= now;
        let broken = broken_by(record, id)?;
        let (by, reason) = broken.as_ref().map_or_else(
            || ("engine".to_owned(), "its approval is not in the store".to_owned()),
            |signed| (signed.approval().who.clone(), signed.approval().reason.clone()),
        );
        let claim = broken.map_or_else(|| candidate.digest(), |signed| signed.approval().claim_digest());
        let evidence = Digest::of_parts("holdpoint.review.v1", &[claim.bytes(), candidate.digest().bytes()]);
        let about = if overdue {
            format!("{by} let it in alone ({reason}); nobody reviewed it in time, and it was taken off")
        } else {
            format!("{by} let it in alone ({reason}); unreviewed by its deadline, it is taken off")
        };
        let prompt_id = format!("{}-{}-{row_version}-review-{}", id.family, id.version, now.ms());
        let asked = NewQuestion {
            id: prompt_id.clone(),
            purpose: Purpose::Review,
            about,
            asked_by: Some(by),
            evidence,
            quorum: REVIEWERS,
            risk,
            review: true,
            asked: now,
            until: review.until,
        };
        let question = PendingQuestion { overdue, ..PendingQuestion::new(context, record, id, asked)? };
        let empty = Dossier::default();
        changes.push(Change::PutApprovalRequest(Box::new(ApprovalRequest {
            id: prompt_id,
            version: id.clone(),
            row_version,
            evidence_digest: evidence,
            policy_digest: context.digest,
            profile: context.profile.name,
            needed: u32::from(REVIEWERS),
            until: review.until,
            state: RequestState::Open,
            json: serde_json::to_string(dossiers.of(id).unwrap_or(&empty))?,
        })));
        record.write(changes, Vec::new())?;
        self.open(context, record, dossiers, id, question);
        Ok(())
    }
}
