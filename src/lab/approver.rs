//! People who answer without a screen: a named identity of the store signs over an open question.

use std::borrow::Cow;

use holdpoint_approvals::{ApprovalError, Identity, IdentityError};
use holdpoint_engine::Engine;
use holdpoint_governance::approval::{Answer, Role};
use holdpoint_protocol::command::Command;
use holdpoint_protocol::snapshot::PromptView;
use holdpoint_text::Hint;

/// Why nobody could answer.
#[derive(Debug, thiserror::Error)]
pub enum ApproverError {
    /// The identity cannot be read or made.
    #[error(transparent)]
    Identity(#[from] IdentityError),
    /// No random number can be had.
    #[error(transparent)]
    Random(#[from] ApprovalError),
}

impl Hint for ApproverError {
    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Identity(error) => error.hint(),
            Self::Random(error) => error.hint(),
        }
    }
}

/// The command by which `who` decides on `prompt`. An identity that the store does not know is made.
///
/// # Errors
/// [`ApproverError`].
pub fn answer(
    engine: &Engine,
    prompt: &PromptView,
    who: &str,
    answer: Answer,
    reason: &str,
) -> Result<Command, ApproverError> {
    let folder = engine.layout().identities();
    let identity = match Identity::load(&folder, who) {
        Ok(identity) => identity,
        Err(_) => Identity::create(&folder, who, Role::Engineer)?,
    };
    Ok(prompt.answer(&identity, answer, reason, None)?)
}
