//! The accounts that may connect to a socket, and the role of each. A role replaces no signature.

use std::collections::BTreeMap;
use std::sync::Arc;

use holdpoint_protocol::account_role::AccountRole;

/// The roles of other accounts, by user id. An account without an entry is an observer.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct AccountRoles(BTreeMap<u32, AccountRole>);

impl AccountRoles {
    /// Gives an account a role. Returns whether it had none before.
    pub fn give(&mut self, uid: u32, role: AccountRole) -> bool {
        self.0.insert(uid, role).is_none()
    }

    fn of(&self, uid: u32) -> AccountRole {
        self.0.get(&uid).copied().unwrap_or_default()
    }
}

/// The accounts that may connect to a socket.
#[derive(Clone, Debug)]
pub(super) enum AllowedAccounts {
    /// The engine's own account, at the socket in the store.
    Owner {
        /// Its user id.
        uid: u32,
    },
    /// Members of the group of the console socket. The kernel refuses all others.
    ConsoleGroup {
        /// The user id of the engine's own account.
        owner: u32,
        roles: Arc<AccountRoles>,
    },
}

/// An account that is connected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct ClientAccount {
    pub(super) uid: u32,
    pub(super) role: AccountRole,
    pub(super) is_owner: bool,
}

impl AllowedAccounts {
    /// The account of a peer; `None` if it may not connect here.
    pub(super) fn of(&self, uid: u32) -> Option<ClientAccount> {
        match self {
            Self::Owner { uid: own } | Self::ConsoleGroup { owner: own, .. } if *own == uid => {
                Some(ClientAccount { uid, role: AccountRole::Administrator, is_owner: true })
            }
            Self::Owner { .. } => None,
            Self::ConsoleGroup { roles, .. } => {
                Some(ClientAccount { uid, role: roles.of(uid), is_owner: false })
            }
        }
    }
}

impl ClientAccount {
    /// Why it may not do what needs this role; `None` if it may.
    pub(super) fn refusal(self, needed: AccountRole) -> Option<String> {
        let Self { uid, role, .. } = self;
        (role < needed).then(|| {
            format!("this needs an account with the role {needed}; account {uid} has the role {role}")
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_protocol::command::Command;

    fn group(given: &[(u32, AccountRole)]) -> AllowedAccounts {
        let mut roles = AccountRoles::default();
        assert!(given.iter().all(|(uid, role)| roles.give(*uid, *role)), "an account has one role");
        AllowedAccounts::ConsoleGroup { owner: 7, roles: Arc::new(roles) }
    }

    fn role(accounts: &AllowedAccounts, uid: u32) -> Option<AccountRole> {
        accounts.of(uid).map(|account| account.role)
    }

    #[test]
    fn owners_alone_use_their_own_socket() {
        let owner = AllowedAccounts::Owner { uid: 7 };
        assert_eq!(
            (role(&owner, 7), role(&owner, 0), role(&owner, 8)),
            (Some(AccountRole::Administrator), None, None)
        );
        assert!(owner.of(7).is_some_and(|account| account.is_owner));
    }

    #[test]
    fn an_account_without_a_role_is_an_observer() {
        let accounts = group(&[(8, AccountRole::Operator), (7, AccountRole::Observer)]);
        let roles = [7, 8, 9, 0].map(|uid| role(&accounts, uid));
        let (operator, observer) = (Some(AccountRole::Operator), Some(AccountRole::Observer));
        assert_eq!(roles, [Some(AccountRole::Administrator), operator, observer, observer]);
        assert_eq!(accounts.of(9).map(|account| account.is_owner), Some(false));
        assert!(!AccountRoles(BTreeMap::from([(8, AccountRole::Operator)])).give(8, AccountRole::Observer));
    }

    #[test]
    fn every_account_may_stop_and_an_observer_changes_nothing_else() {
        let accounts = group(&[(8, AccountRole::Operator), (9, AccountRole::Administrator)]);
        let stop = Command::Stop { by: String::new(), reason: String::new() };
        let commands = [stop, Command::Snapshot, Command::Pace { times: None }, Command::Shutdown];
        for (uid, may) in [(6, [true, true, false, false]), (8, [true, true, true, false]), (9, [true; 4])] {
            let account = accounts.of(uid).unwrap();
            let found = commands
                .each_ref()
                .map(|command| account.refusal(AccountRole::needed_for(command)).is_none());
            assert_eq!(found, may, "{uid}");
        }
    }
}
