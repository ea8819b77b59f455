//! Who sits here, and their signature under what they decided.
//!
//! A key is read for one signature and forgotten. Must not make identities: a person does that on the command line,
//! knowing that it is one.

use std::path::Path;

use crate::model::Operator;
use crate::prompt::Decision;
use holdpoint_approvals::{Identity, IdentityInfo};
use holdpoint_protocol::command::Command;

/// What went wrong, and what would help.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Problem {
    text: String,
    hint: Option<String>,
}

impl Problem {
    /// A problem in one sentence. Text after `Hint:` becomes the hint.
    pub fn new(text: impl Into<String>) -> Self {
        let text: String = text.into();
        match text.split_once("Hint:") {
            Some((text, hint)) => {
                Self { text: text.trim_end().to_owned(), hint: Some(hint.trim().to_owned()) }
            }
            None => Self { text, hint: None },
        }
    }

    /// With this hint in place of its own.
    pub fn hint(self, hint: &str) -> Self {
        Self { hint: Some(hint.to_owned()), ..self }
    }

    /// Both in one line.
    pub fn sentence(&self) -> String {
        match &self.hint {
            Some(hint) => format!("{}. Hint: {hint}", self.text),
            None => self.text.clone(),
        }
    }

    /// Both.
    pub fn into_parts(self) -> (String, Option<String>) {
        (self.text, self.hint)
    }
}

/// Everybody who could sit here; nobody where no identity was made yet.
pub fn list(folder: &Path) -> Result<Vec<Operator>, Problem> {
    if !folder.is_dir() {
        return Ok(Vec::new());
    }
    let known = Identity::list(folder).map_err(|error| Problem::new(error.to_string()))?;
    Ok(known.known.iter().map(operator).collect())
}

/// Somebody by name.
pub fn find(folder: &Path, name: &str) -> Result<Operator, Problem> {
    let made = format!("`holdpoint identity new {name}` makes one");
    Identity::find(folder, name)
        .map(|info| operator(&info))
        .map_err(|error| Problem::new(error.to_string()).hint(&made))
}

/// The engine's command for a decision, signed by who made it.
pub fn sign(folder: &Path, decision: &Decision) -> Result<Command, Problem> {
    let problem = |error: &dyn std::fmt::Display| Problem::new(error.to_string());
    let identity = Identity::load(folder, decision.by()).map_err(|error| problem(&error))?;
    let shown = Some(decision.shown().to_owned());
    let command = decision.over().answer(&identity, decision.answer(), decision.reason(), shown);
    command.map_err(|error| problem(&error))
}

fn operator(info: &IdentityInfo) -> Operator {
    Operator { name: info.name.clone(), role: info.role.name().to_owned() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_governance::approval::Role;

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
        assert_eq!(find(&keys, "mara").unwrap().role, "engineer");
        let stranger = find(&keys, "bob").unwrap_err().sentence();
        assert!(stranger.ends_with("Hint: `holdpoint identity new bob` makes one"), "{stranger}");
    }
}
