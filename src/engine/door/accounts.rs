//! Whose programs are heard at a socket, and what each account may ask for.

use holdpoint_protocol::command::Authority;

/// Whose programs may connect to a socket.
#[derive(Clone, Copy, Debug)]
pub(super) enum Accounts {
    /// The engine's own account, at the socket in the store.
    Owner {
        /// Its number.
        uid: u32,
    },
    /// Members of the group of the seats' socket. The kernel lets no others connect to it.
    Seats,
}

/// What an account is to the engine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Account {
    Owner,
    Seat,
}

/// What each account may ask for: everything, today. What has to be signed has to be signed by everybody.
const ALLOWED: [(Account, &[Authority]); 2] = [(Account::Owner, &EVERYTHING), (Account::Seat, &EVERYTHING)];

const EVERYTHING: [Authority; 5] =
    [Authority::Reads, Authority::TakesAway, Authority::Gives, Authority::SignedItself, Authority::Neither];

impl Accounts {
    /// What the account of a peer is; `None` if it is not heard here.
    pub(super) const fn of(self, uid: u32) -> Option<Account> {
        match self {
            Self::Owner { uid: own } if own == uid => Some(Account::Owner),
            Self::Owner { .. } => None,
            Self::Seats => Some(Account::Seat),
        }
    }
}

impl Account {
    /// Whether it may ask for what does this to authority.
    pub(super) fn may(self, authority: Authority) -> bool {
        ALLOWED.iter().any(|(account, allowed)| *account == self && allowed.contains(&authority))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_owner_is_heard_at_its_socket_alone_and_a_stop_is_everybodys() {
        let owner = Accounts::Owner { uid: 7 };
        assert_eq!((owner.of(7), owner.of(0), owner.of(8)), (Some(Account::Owner), None, None));
        assert_eq!(Accounts::Seats.of(8), Some(Account::Seat));
        for account in [Account::Owner, Account::Seat] {
            assert!(account.may(Authority::TakesAway), "{account:?}");
        }
    }
}
