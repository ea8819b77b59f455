//! The operator's identity, and the signature under each decision.
//!
//! A key is read for one signature and forgotten. Must not make identities: [`super::MakeIdentity`] does.

use std::path::Path;

use crate::approval_screen::ApprovalAnswer;
use crate::operator::Operator;
use holdpoint_approvals::keyfile::{KeyError, Protection};
use holdpoint_approvals::{EncryptedKeyError, Identity, IdentityError, IdentityInfo, Passphrase, SignedCall};
use holdpoint_governance::approval::ApprovalDecision;
use holdpoint_protocol::command::Command;
use holdpoint_protocol::snapshot::SigningView;
use holdpoint_text::Problem;
use holdpoint_wording::console::effects as wording;

/// All identities of this console; empty if there are none yet.
pub fn list(folder: &Path) -> Result<Vec<Operator>, IdentityError> {
    if !folder.is_dir() {
        return Ok(Vec::new());
    }
    Ok(Identity::list(folder)?.known.iter().map(|info| operator(folder, info)).collect())
}

pub fn find(folder: &Path, name: &str) -> Result<Operator, Problem> {
    let made = wording::makes_an_identity(name);
    Identity::find(folder, name)
        .map(|info| operator(folder, &info))
        .map_err(|error| Problem::new(error.to_string()).with_hint(made))
}

/// Signs an operator's decision and returns the engine's command.
///
/// Each signature asks for the passphrase, which is not stored: a passer-by at an open console must not be able to
/// sign as the operator. A command that stops something needs no signature and never asks.
pub fn sign(
    folder: &Path,
    decision: &ApprovalAnswer,
    passphrase: Option<Passphrase>,
) -> Result<Command, Problem> {
    let identity = open_identity(folder, decision.by(), passphrase)?;
    let command = match (decision.question(), decision.answer()) {
        (Some(question), answer) => question.answer(&identity, answer, decision.reason()),
        (None, ApprovalDecision::Reject) => decision.over().refuse(&identity, decision.reason()),
        (None, ApprovalDecision::Approve) => {
            return Err(Problem::new(wording::NOTHING_SHOWN));
        }
    };
    command.map_err(|error| Problem::of(&error))
}

/// Signs a request that gives authority, with the key of a named person.
pub fn seal(
    folder: &Path,
    name: &str,
    signing: &SigningView,
    command: &Command,
    passphrase: Option<Passphrase>,
) -> Result<Box<SignedCall>, Problem> {
    let identity = open_identity(folder, name, passphrase)?;
    let seal = signing.sign(&identity, command).map_err(|error| Problem::of(&error))?;
    Ok(Box::new(seal))
}

/// Opens a named person's key for one signature.
fn open_identity(folder: &Path, name: &str, passphrase: Option<Passphrase>) -> Result<Identity, Problem> {
    let identity = Identity::open(folder, name).map_err(|error| Problem::of(&error))?;
    if passphrase.is_some() != (identity.protection() == Protection::Passphrase) {
        let text = wording::passphrase_changed(name);
        return Err(Problem::new(text).with_hint(wording::use_it_again(name)));
    }
    identity.unlock(passphrase.as_ref()).map_err(|error| match error {
        IdentityError::Key(KeyError::Sealed { problem: EncryptedKeyError::Passphrase, .. }) => {
            Problem::new(wording::WRONG_PASSPHRASE)
        }
        other => Problem::of(&other),
    })
}

fn operator(folder: &Path, info: &IdentityInfo) -> Operator {
    // An unreadable key file is reported when it has to sign.
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
        let hint = find(&keys, "bob").unwrap_err().hint().unwrap();
        assert_eq!(hint, wording::makes_an_identity("bob"));
    }
}
