//! The accounts that may connect to a socket, and the requests each of them may make.

use holdpoint_protocol::command::AuthorityEffect;

/// The accounts that may connect to a socket.
#[derive(Clone, Copy, Debug)]
pub(super) enum AllowedAccounts {
    /// The engine's own account, at the socket in the store.
    Owner {
        /// Its user id.
        uid: u32,
    },
    /// Members of the group of the console socket. The kernel refuses all others.
    ConsoleGroup,
}

/// The relation of an account to the engine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum ClientAccount {
    Owner,
    Console,
}

/// The requests that each account may make: all of them. Signature requirements apply to every account.
const ALLOWED: [(ClientAccount, &[AuthorityEffect]); 2] =
    [(ClientAccount::Owner, &EVERYTHING), (ClientAccount::Console, &EVERYTHING)];

const EVERYTHING: [AuthorityEffect; 5] = [
    AuthorityEffect::Reads,
    AuthorityEffect::TakesAway,
    AuthorityEffect::Gives,
    AuthorityEffect::SignedItself,
    AuthorityEffect::Neither,
];

impl AllowedAccounts {
    /// The account of a peer; `None` if it may not connect here.
    pub(super) const fn of(self, uid: u32) -> Option<ClientAccount> {
        match self {
            Self::Owner { uid: own } if own == uid => Some(ClientAccount::Owner),
            Self::Owner { .. } => None,
            Self::ConsoleGroup => Some(ClientAccount::Console),
        }
    }
}

impl ClientAccount {
    /// Whether it may make requests with this effect on authority.
    pub(super) fn may(self, authority: AuthorityEffect) -> bool {
        ALLOWED.iter().any(|(account, allowed)| *account == self && allowed.contains(&authority))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn owners_use_their_own_socket_and_every_account_may_stop() {
        let owner = AllowedAccounts::Owner { uid: 7 };
        assert_eq!((owner.of(7), owner.of(0), owner.of(8)), (Some(ClientAccount::Owner), None, None));
        assert_eq!(AllowedAccounts::ConsoleGroup.of(8), Some(ClientAccount::Console));
        for account in [ClientAccount::Owner, ClientAccount::Console] {
            assert!(account.may(AuthorityEffect::TakesAway), "{account:?}");
        }
    }
}
