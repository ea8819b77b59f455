//! The roles of the Unix accounts that connect to an engine, and the commands that each role may send.
//!
//! A role limits an account and grants no person anything: signatures are required of every account. Which account has
//! which role is a setting of the engine.

use std::fmt;
use std::str::FromStr;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::command::{AuthorityEffect, Command};

/// The role of an account at an engine; each one includes those before it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum AccountRole {
    /// Watches, and stops the cell.
    #[default]
    Observer,
    /// Sends every command but those of an administrator.
    Operator,
    /// Sends every command, as the engine's own account does.
    Administrator,
}

impl AccountRole {
    /// All roles.
    pub const ALL: [Self; 3] = [Self::Observer, Self::Operator, Self::Administrator];

    /// The name, as on the command line and on the socket.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Observer => "observer",
            Self::Operator => "operator",
            Self::Administrator => "administrator",
        }
    }

    /// The role that a command needs. A stop needs none: an account that can connect can stop the cell.
    #[must_use]
    pub fn needed_for(command: &Command) -> Self {
        match command {
            Command::Stop { .. } => Self::Observer,
            // Without an engine no account can stop the cell over the socket.
            Command::Shutdown | Command::Person { .. } => Self::Administrator,
            _ => match command.authority_effect() {
                AuthorityEffect::Reads => Self::Observer,
                AuthorityEffect::TakesAway
                | AuthorityEffect::Gives
                | AuthorityEffect::SignedItself
                | AuthorityEffect::Neither => Self::Operator,
            },
        }
    }
}

impl fmt::Display for AccountRole {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for AccountRole {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        Self::ALL.into_iter().find(|role| role.name() == text).ok_or_else(|| {
            let allowed = Self::ALL.map(Self::name).join(", ");
            format!("{text:?} is no role of an account; allowed: {allowed}")
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_role_has_one_name_everywhere() {
        for role in AccountRole::ALL {
            assert_eq!(role.name().parse::<AccountRole>(), Ok(role));
            assert_eq!(serde_json::to_value(role).unwrap(), role.name());
        }
        let refused = "root".parse::<AccountRole>().unwrap_err();
        assert!(AccountRole::ALL.iter().all(|role| refused.contains(role.name())), "{refused}");
    }

    #[test]
    fn every_role_may_stop_and_only_an_administrator_may_end_the_engine() {
        let stop = Command::Stop { by: String::new(), reason: String::new() };
        let pace = Command::Pace { times: None };
        let needed = [&stop, &Command::Snapshot, &Command::VerifyAudit, &pace, &Command::Shutdown]
            .map(AccountRole::needed_for);
        let (observer, operator) = (AccountRole::Observer, AccountRole::Operator);
        assert_eq!(needed, [observer, observer, observer, operator, AccountRole::Administrator]);
        assert!(observer < operator && operator < AccountRole::Administrator);
        assert_eq!(AccountRole::default(), observer);
    }
}
