//! The request signature: the one place that defines its content.

use super::command::Command;
use super::snapshot::SigningView;
use holdpoint_approvals::{ApprovalError, CallClaim, Identity, Nonce, SignedCall};

impl SigningView {
    /// Signs a request for this command as `who`.
    ///
    /// # Errors
    /// [`ApprovalError`] if the system returns no random number for the nonce, or the command has no JSON form.
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
