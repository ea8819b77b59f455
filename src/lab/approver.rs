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
    Ok(prompt.answer(&identity(engine, who)?, answer, reason, None)?)
}

/// The command by which `who` lets in alone what `door` is about. An identity that the store does not know is made.
///
/// # Errors
/// [`ApproverError`].
pub fn break_glass(
    engine: &Engine,
    door: &PromptView,
    who: &str,
    reason: &str,
) -> Result<Command, ApproverError> {
    Ok(door.break_glass(&identity(engine, who)?, reason, None)?)
}

fn identity(engine: &Engine, who: &str) -> Result<Identity, IdentityError> {
    let folder = engine.layout().identities();
    match Identity::load(&folder, who) {
        Err(IdentityError::Unknown { .. }) => Identity::create(&folder, who, Role::Engineer),
        known => known,
    }
}
