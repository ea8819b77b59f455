//! What people sign, answers to questions and requests: the one place that says what a signature is bound to.

use super::command::Command;
use super::snapshot::{PromptView, SigningView};
use holdpoint_approvals::{Approval, ApprovalError, CallClaim, Identity, Nonce, SignedCall};
use holdpoint_governance::approval::Answer;

impl PromptView {
    /// The command by which `who` decides on this question, for the reason given. `shown` is what was on the screen;
    /// absent if there was no screen.
    ///
    /// # Errors
    /// [`ApprovalError`] if the machine gives no random number for the nonce.
    pub fn answer(
        &self,
        who: &Identity,
        decision: Answer,
        reason: &str,
        shown: Option<String>,
    ) -> Result<Command, ApprovalError> {
        self.sign(who, decision, reason, shown, false)
    }

    /// The command by which `who` lets this version in alone, in an emergency (break-glass).
    ///
    /// # Errors
    /// As [`PromptView::answer`].
    pub fn break_glass(
        &self,
        who: &Identity,
        reason: &str,
        shown: Option<String>,
    ) -> Result<Command, ApprovalError> {
        self.sign(who, Answer::Approve, reason, shown, true)
    }

    fn sign(
        &self,
        who: &Identity,
        decision: Answer,
        reason: &str,
        shown: Option<String>,
        break_glass: bool,
    ) -> Result<Command, ApprovalError> {
        let signed = who.sign(Approval {
            who: who.info().name.clone(),
            role: who.info().role,
            decision,
            reason: reason.to_owned(),
            version: self.version.clone(),
            candidate_digest: self.candidate,
            row_version: self.row_version,
            evidence_digest: self.evidence,
            policy_digest: self.policy,
            profile: self.profile,
            store_id: self.store_id.clone(),
            nonce: Nonce::random()?,
            not_after_ms: self.valid_until_ms,
            break_glass,
        })?;
        Ok(Command::Decide { signed: Box::new(signed), shown })
    }
}

impl SigningView {
    /// The signature of `who` under a request for this command.
    ///
    /// # Errors
    /// [`ApprovalError`] if the machine gives no random number for the nonce, or the command has no JSON form.
    pub fn sign(&self, who: &Identity, command: &Command) -> Result<SignedCall, ApprovalError> {
        who.sign_call(CallClaim {
            who: who.info().name.clone(),
            role: who.info().role,
            call: command.digest().map_err(|error| ApprovalError::NoForm(error.to_string()))?,
            store_id: self.store_id.clone(),
            life: self.life.clone(),
            nonce: Nonce::random()?,
            not_after_ms: self.until_ms,
        })
    }
}
