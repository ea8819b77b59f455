//! What a person signs under a request: the one place that says what that signature is bound to.

use super::command::Command;
use super::snapshot::SigningView;
use holdpoint_approvals::{ApprovalError, CallClaim, Identity, Nonce, SignedCall};

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
