//! Who sits here, and their signature under what they decided.
//!
//! A key is read for one signature and forgotten. Must not make identities: [`super::MakeIdentity`] does.

use std::path::Path;

use crate::operator::Operator;
use crate::prompt::PromptAnswer;
use holdpoint_approvals::keyfile::{KeyError, Protection};
use holdpoint_approvals::{Identity, IdentityError, IdentityInfo, Passphrase, SealedError, SignedCall};
use holdpoint_governance::approval::Answer;
use holdpoint_protocol::command::Command;
use holdpoint_protocol::snapshot::SigningView;
use holdpoint_text::Problem;

/// Everybody who could sit here; nobody if no identity was made yet.
pub fn list(folder: &Path) -> Result<Vec<Operator>, IdentityError> {
    if !folder.is_dir() {
        return Ok(Vec::new());
    }
    Ok(Identity::list(folder)?.known.iter().map(|info| operator(folder, info)).collect())
}

pub fn find(folder: &Path, name: &str) -> Result<Operator, Problem> {
    let made = format!("`holdpoint identity new {name}` makes one");
    Identity::find(folder, name)
        .map(|info| operator(folder, &info))
        .map_err(|error| Problem::new(error.to_string()).with_hint(made))
}

/// The engine's command for a decision, signed by who made it.
///
/// The passphrase is asked for at every signature and kept nowhere: a console stands open for a whole shift, and who
/// walks past it must not be able to sign as who sits there. What stops something is signed by nobody and never asks.
pub fn sign(
    folder: &Path,
    decision: &PromptAnswer,
    passphrase: Option<Passphrase>,
) -> Result<Command, Problem> {
    let identity = opened(folder, decision.by(), passphrase)?;
    let command = match (decision.question(), decision.answer()) {
        (Some(question), answer) => question.answer(&identity, answer, decision.reason()),
        (None, Answer::Reject) => decision.over().refuse(&identity, decision.reason()),
        (None, Answer::Approve) => return Err(Problem::new("nothing was shown that could be approved")),
    };
    command.map_err(|error| Problem::of(&error))
}

/// Somebody's signature under a request that gives authority.
pub fn seal(
    folder: &Path,
    name: &str,
    signing: &SigningView,
    command: &Command,
    passphrase: Option<Passphrase>,
) -> Result<Box<SignedCall>, Problem> {
    let identity = opened(folder, name, passphrase)?;
    let seal = signing.sign(&identity, command).map_err(|error| Problem::of(&error))?;
    Ok(Box::new(seal))
}

/// Somebody's key, opened for one signature.
fn opened(folder: &Path, name: &str, passphrase: Option<Passphrase>) -> Result<Identity, Problem> {
    let kept = Identity::open(folder, name).map_err(|error| Problem::of(&error))?;
    if passphrase.is_some() != (kept.protection() == Protection::Passphrase) {
        let text = format!("the passphrase of {name} was set or removed meanwhile");
        return Err(Problem::new(text).with_hint(format!("`:as {name}`, then again")));
    }
    kept.unlock(passphrase.as_ref()).map_err(|error| match error {
        IdentityError::Key(KeyError::Sealed { problem: SealedError::Passphrase, .. }) => {
            Problem::new("wrong passphrase, nothing was signed")
        }
        other => Problem::of(&other),
    })
}

fn operator(folder: &Path, info: &IdentityInfo) -> Operator {
    // A key file that cannot be read is told when something is signed.
    let protection = Identity::protection(folder, &info.name).unwrap_or(Protection::None);
    Operator { name: info.name.clone(), role: info.role, protection }
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_governance::approval::Role;
    use holdpoint_text::Hint as _;

    #[test]
    fn people_are_found_by_name_and_strangers_get_a_hint() {
        let folder = tempfile::tempdir().unwrap();
        let keys = folder.path().join("identities");
        assert_eq!(list(&keys).unwrap(), []);
        std::fs::create_dir(&keys).unwrap();
        for name in ["mara", "alice"] {
            Identity::create(&keys, name, Role::Engineer).unwrap();
        }
        let names: Vec<String> = list(&keys).unwrap().into_iter().map(|known| known.name).collect();
        assert_eq!(names, ["alice", "mara"]);
        assert_eq!(find(&keys, "mara").unwrap().role, Role::Engineer);
        let stranger = find(&keys, "bob").unwrap_err().sentence();
        assert!(stranger.ends_with("Hint: `holdpoint identity new bob` makes one"), "{stranger}");
    }
}
