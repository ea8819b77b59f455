//! People who answer without a screen: a named identity of the store signs over an open question.

use crate::approvals::{ApprovalDecision, Identity, Role};
use crate::cli::CliError;
use crate::engine::Engine;
use crate::engine::command::Command;
use crate::engine::snapshot::PromptView;

/// The role of identities that are made for a script.
const ROLE: &str = "engineer";

/// The command by which `who` decides on `prompt`. An identity that the store does not know is made.
///
/// # Errors
/// Where the identity cannot be read or made, or no random number can be had.
pub fn answer(
    engine: &Engine,
    prompt: &PromptView,
    who: &str,
    decision: ApprovalDecision,
    reason: &str,
) -> Result<Command, CliError> {
    let folder = engine.layout().identities();
    let identity = match Identity::load(&folder, who) {
        Ok(identity) => identity,
        Err(_) => {
            let role = Role::new(ROLE).map_err(CliError::usage)?;
            Identity::create(&folder, who, role).map_err(CliError::usage)?
        }
    };
    prompt.answer(&identity, decision, reason, None).map_err(CliError::internal)
}
