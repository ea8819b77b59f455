//! A question that was open when the engine ended, taken up as it was.

use holdpoint_approvals::PersonState;
use holdpoint_governance::approval::{Answer, ApprovalOutcome, SignatureCheck, Vote};
use holdpoint_governance::gate::{GateOutcome, GateResult};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::wall_time::WallTime;

use super::{Approvals, NewQuestion, PendingQuestion, Purpose, activation_terms};
use crate::context::Context;
use crate::dossier::Dossiers;
use crate::fault::Fault;
use crate::origin;
use crate::people::asking::is_as_shown;
use crate::people::persons::unconfirmed;
use crate::record::Record;
use crate::stages::activation::gate;

impl Approvals {
    /// Takes a question up again that was open when the engine ended, with the answers that were given: the same
    /// question over the same evidence, until the same deadline. Tells how many answers it has; `None` if anything it
    /// was about has changed, so that people have to be asked anew.
    ///
    /// # Errors
    /// If the store cannot be read.
    pub fn take_up(
        &mut self,
        context: &Context,
        record: &Record,
        dossiers: &mut Dossiers,
        id: &CapabilityId,
    ) -> Result<Option<usize>, Fault> {
        let views = record.ledger().store().views()?;
        // The newest of those that an interrupted engine may have left.
        let asked = views.open_requests()?.into_iter().rfind(|request| request.version == *id);
        let (Some(asked), Some(dossier)) = (asked, dossiers.of(id)) else { return Ok(None) };
        let (_, _, member) = record.ledger().version(id)?;
        let provenance = record.capability(id)?.submission.provenance;
        let Some((quorum, review)) = activation_terms(context, dossier, provenance) else { return Ok(None) };
        let risk = origin::assessed_risk(dossier);
        let evidence = dossier.digest()?;
        let asked_ms = views.asked_ms(&asked.id)?.unwrap_or(u64::MAX);
        // In the engine's time, as earlier versions had it, no person's deadline is said: people are asked anew.
        let unchanged = asked.until >= WallTime::SCRIPT_EPOCH
            && asked.policy_digest == context.digest
            && asked.profile == context.profile.name
            && asked.evidence_digest == evidence
            && asked.row_version == member.row_version
            && asked.needed == u32::from(quorum);
        if !unchanged {
            return Ok(None);
        }
        // What is shown of it is what takes effect: what the gate adds is in no stage's evidence.
        let GateResult { decision, .. } = gate(context, record, dossiers, id, None)?;
        if *decision.outcome() != GateOutcome::AwaitApproval {
            return Ok(None);
        }
        dossiers.edit(id).take_gate(&decision);
        let mut prompt = PendingQuestion::new(
            context,
            record,
            id,
            NewQuestion {
                id: asked.id,
                purpose: Purpose::Activation,
                about: String::new(),
                asked_by: None,
                evidence,
                quorum,
                risk,
                review,
                asked: asked.until.minus_secs(context.profile.approval.timeout_s),
                until: asked.until,
            },
        )?;
        let subject = prompt.request.subject;
        let persons = record.ledger().store().persons()?;
        for entry in views.approvals(id)? {
            let said = entry.signed.approval().clone();
            let same = said.candidate_digest == subject.candidate
                && said.row_version == subject.row_version
                && said.evidence_digest == evidence
                && said.policy_digest == context.digest
                && said.profile == context.profile.name
                && entry.at_ms >= asked_ms;
            // Who may no longer decide has not decided, nor has whom nobody vouches for.
            let counts = |who: &&holdpoint_approvals::Person| {
                let lets_in = said.decision == Answer::Approve && !record.clock().is_scripted();
                same && who.state == PersonState::Enrolled
                    && !(lets_in && unconfirmed(context, &persons, &who.name).is_some())
            };
            let who = persons.named(&said.who).filter(counts);
            let Some(who) = who.map(holdpoint_approvals::Person::info) else { continue };
            // What was given over something else than is shown now is asked for again.
            let over_this = is_as_shown(context, record, dossiers, &prompt, &said)?;
            if entry.consumed_seq.is_some() || entry.signed.verify(&who).is_err() || !over_this {
                continue;
            }
            prompt.votes.push(Vote {
                person: said.who.clone(),
                key: entry.signed.public_key().to_owned(),
                role: who.role,
                answer: said.decision,
                reason: said.reason.clone(),
                subject,
                until: said.not_after(),
                break_glass: false,
                signature: SignatureCheck::Valid,
                nonce_used: false,
            });
            prompt.signed.push(entry.signed);
        }
        drop(views);
        let answers = prompt.votes.len();
        match prompt.result(context, record.wall_now()).outcome {
            ApprovalOutcome::Granted { .. } | ApprovalOutcome::NotNeeded => self.grant_later(id),
            ApprovalOutcome::Pending { .. } | ApprovalOutcome::TimedOut | ApprovalOutcome::Refused { .. } => {
            }
        }
        self.prompts.insert(id.clone(), prompt);
        Ok(Some(answers))
    }
}
