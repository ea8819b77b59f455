//! Limits connections by their class, so that no client shuts the others out.
//!
//! An idle connection takes no place from others: beyond [`IDLE_MAX`], the longest idle one is closed. Subscribers,
//! requests, and requests that take authority away have separate places, and the last class has some in reserve. A stop
//! of the cell needs no place: it takes effect before any check here. An account other than the engine's own has
//! [`ACCOUNT_CONNECTIONS_MAX`] connections, of which [`ACCOUNT_RECEIVERS_MAX`] receive events, so that it does not shut the
//! others out. All of these accounts leave [`OWNER_RECEIVERS_MIN`] places of receivers to the engine's own. Programs of the
//! engine's account have the limits of the classes alone. A program that connects faster than others can send still
//! blocks them.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio_util::sync::CancellationToken;

use super::accounts::ClientAccount;
use holdpoint_protocol::command::Command;

/// The most connections that receive events.
pub const OBSERVERS_MAX: usize = 64;

/// The most requests that are answered at a time.
pub const ASKING_MAX: usize = 32;

/// Additional places for requests that take authority away.
pub const BRAKING_MAX: usize = 8;

/// The most stops that wait to be recorded; the arm is at standstill for all of them.
pub const STOPS_MAX: usize = 16;

pub const IDLE_MAX: usize = 64;

/// The most connections of an account other than the engine's own.
pub const ACCOUNT_CONNECTIONS_MAX: usize = 16;

/// The most connections of such an account that receive events.
pub const ACCOUNT_RECEIVERS_MAX: usize = 4;

/// The places for connections that receive events that only the engine's own account takes.
pub const OWNER_RECEIVERS_MIN: usize = 16;

/// Why a connection must take authority away with its first request.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Crowding {
    /// The process has no descriptors left.
    Process,
    /// The account has its most connections.
    Account,
}

impl Crowding {
    /// The last message to a connection that asks for anything else.
    pub(super) fn text(self) -> String {
        let why = match self {
            Self::Process => "this process has no file descriptors left for more connections".to_owned(),
            Self::Account => {
                format!("this account has {ACCOUNT_CONNECTIONS_MAX} connections, the most allowed")
            }
        };
        format!("{why}; one that stops the cell or takes a version's authority away is heard")
    }
}

/// The places of each class.
#[derive(Clone, Debug)]
pub(super) struct ConnectionLimits {
    observers: Arc<Semaphore>,
    /// Of these places, those that other accounts may take.
    others_observers: Arc<Semaphore>,
    requests: Arc<Semaphore>,
    braking: Arc<Semaphore>,
    stops: Arc<Semaphore>,
    idle: Arc<Mutex<IdleConnections>>,
    accounts: AccountCounts,
    /// Those that receive events.
    receivers: AccountCounts,
}

/// A number for each account that has one.
type AccountCounts = Arc<Mutex<BTreeMap<u32, usize>>>;

impl Default for ConnectionLimits {
    fn default() -> Self {
        let places = |count| Arc::new(Semaphore::new(count));
        Self {
            observers: places(OBSERVERS_MAX),
            others_observers: places(OBSERVERS_MAX - OWNER_RECEIVERS_MIN),
            requests: places(ASKING_MAX),
            braking: places(BRAKING_MAX),
            stops: places(STOPS_MAX),
            idle: Arc::default(),
            accounts: Arc::default(),
            receivers: Arc::default(),
        }
    }
}

/// Idle connections, in the order in which they became idle.
#[derive(Debug, Default)]
struct IdleConnections {
    next: u64,
    longest_first: BTreeMap<u64, CancellationToken>,
}

/// A connection is idle as long as this lives.
#[derive(Debug)]
pub(super) struct IdleConnection {
    idle: Arc<Mutex<IdleConnections>>,
    place: u64,
    eviction: CancellationToken,
}

impl IdleConnection {
    /// Resolves when the connection must close.
    pub(super) async fn gives_way(&self) {
        self.eviction.cancelled().await;
    }
}

impl Drop for IdleConnection {
    fn drop(&mut self) {
        self.idle.lock().unwrap_or_else(PoisonError::into_inner).longest_first.remove(&self.place);
    }
}

/// A connection counts for its account as long as this lives.
#[derive(Debug)]
pub(super) struct AccountConnection {
    accounts: AccountCounts,
    uid: u32,
    /// How many connections the account had when this one began, with it.
    number: usize,
}

impl AccountConnection {
    fn begin(accounts: &AccountCounts, uid: u32) -> Self {
        let mut counts = accounts.lock().unwrap_or_else(PoisonError::into_inner);
        let count = counts.entry(uid).or_default();
        *count += 1;
        Self { accounts: Arc::clone(accounts), uid, number: *count }
    }

    /// How many connections the account then had beyond its limit.
    pub(super) const fn beyond_limit(&self) -> usize {
        self.number.saturating_sub(ACCOUNT_CONNECTIONS_MAX)
    }
}

impl Drop for AccountConnection {
    fn drop(&mut self) {
        let mut accounts = self.accounts.lock().unwrap_or_else(PoisonError::into_inner);
        let left = accounts.get(&self.uid).map_or(0, |count| count.saturating_sub(1));
        if left == 0 {
            accounts.remove(&self.uid);
        } else {
            accounts.insert(self.uid, left);
        }
    }
}

/// The place of a connection that receives events, as long as this lives.
#[derive(Debug)]
pub(super) struct ReceiverPlace {
    /// Of an account other than the engine's own.
    _other: Option<(AccountConnection, OwnedSemaphorePermit)>,
    _place: OwnedSemaphorePermit,
}

impl ConnectionLimits {
    pub(super) fn begin_connection(&self, uid: u32) -> AccountConnection {
        AccountConnection::begin(&self.accounts, uid)
    }

    /// A connection begins to wait for a request of its client.
    pub(super) fn begin_idle(&self) -> IdleConnection {
        let mut idle = self.idle.lock().unwrap_or_else(PoisonError::into_inner);
        if idle.longest_first.len() >= IDLE_MAX
            && let Some((_, longest)) = idle.longest_first.pop_first()
        {
            longest.cancel();
        }
        let place = idle.next;
        idle.next += 1;
        let eviction = CancellationToken::new();
        idle.longest_first.insert(place, eviction.clone());
        IdleConnection { idle: Arc::clone(&self.idle), place, eviction }
    }

    /// Closes the longest idle connection. Returns whether there was one.
    pub(super) fn make_room(&self) -> bool {
        let mut idle = self.idle.lock().unwrap_or_else(PoisonError::into_inner);
        let longest = idle.longest_first.pop_first();
        longest.is_some_and(|(_, longest)| {
            longest.cancel();
            true
        })
    }

    /// A place for a subscriber.
    ///
    /// # Errors
    /// The last message to a subscriber without a place.
    pub(super) fn observer(&self, account: ClientAccount) -> Result<ReceiverPlace, String> {
        let place = |of: &Arc<Semaphore>| {
            Arc::clone(of).try_acquire_owned().map_err(|_| {
                format!(
                    "{OBSERVERS_MAX} connections receive events, the most allowed: end one that watches it"
                )
            })
        };
        let other = if account.is_owner {
            None
        } else {
            let connection = AccountConnection::begin(&self.receivers, account.uid);
            if connection.number > ACCOUNT_RECEIVERS_MAX {
                return Err(format!(
                    "{ACCOUNT_RECEIVERS_MAX} connections of this account receive events, the most allowed: end one of them"
                ));
            }
            Some((connection, place(&self.others_observers)?))
        };
        Ok(ReceiverPlace { _other: other, _place: place(&self.observers)? })
    }

    /// A place for a request while it is answered; `None` if there is none left.
    pub(super) fn request(&self, command: &Command) -> Option<OwnedSemaphorePermit> {
        let place = |of: &Arc<Semaphore>| Arc::clone(of).try_acquire_owned().ok();
        if matches!(command, Command::Stop { .. }) {
            return place(&self.stops);
        }
        let reserve = || command.takes_authority_away().then(|| place(&self.braking)).flatten();
        place(&self.requests).or_else(reserve)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_protocol::account_role::AccountRole;

    #[test]
    fn longest_idle_connection_is_closed() {
        let classes = ConnectionLimits::default();
        let mut idle: Vec<IdleConnection> = (0..IDLE_MAX).map(|_| classes.begin_idle()).collect();
        // The first one makes a request, and is idle again.
        drop(idle.remove(0));
        idle.push(classes.begin_idle());
        assert!(idle.iter().all(|one| !one.eviction.is_cancelled()));
        let newest = classes.begin_idle();
        let gone: Vec<usize> =
            idle.iter().enumerate().filter(|(_, one)| one.eviction.is_cancelled()).map(|(i, _)| i).collect();
        assert_eq!((gone, newest.eviction.is_cancelled()), (vec![0], false));
    }

    #[test]
    fn an_account_beyond_its_limit_takes_no_place_of_another() {
        let classes = ConnectionLimits::default();
        let mut crowd: Vec<AccountConnection> =
            (0..ACCOUNT_CONNECTIONS_MAX + 2).map(|_| classes.begin_connection(8)).collect();
        let beyond: Vec<usize> = crowd.iter().map(AccountConnection::beyond_limit).collect();
        assert_eq!(beyond.get(ACCOUNT_CONNECTIONS_MAX - 1..), Some(&[0, 1, 2][..]));
        assert_eq!(classes.begin_connection(9).beyond_limit(), 0);
        // Ended connections count no more.
        crowd.truncate(ACCOUNT_CONNECTIONS_MAX - 1);
        assert_eq!(classes.begin_connection(8).beyond_limit(), 0);
        drop(crowd);
        assert!(classes.accounts.lock().unwrap().is_empty());
    }

    /// Four accounts took all places, and the engine's own console could not attach.
    #[test]
    fn receivers_of_other_accounts_leave_places_to_the_engines_own() {
        let classes = ConnectionLimits::default();
        let account = |uid| ClientAccount { uid, role: AccountRole::Observer, is_owner: uid == 7 };
        let taken = |uid| -> Vec<ReceiverPlace> {
            std::iter::from_fn(|| classes.observer(account(uid)).ok()).collect()
        };
        let one = taken(8);
        assert_eq!(one.len(), ACCOUNT_RECEIVERS_MAX);
        let others: Vec<ReceiverPlace> = (100..200).flat_map(taken).collect();
        assert_eq!(one.len() + others.len(), OBSERVERS_MAX - OWNER_RECEIVERS_MIN);
        assert!(classes.observer(account(9)).is_err());
        assert_eq!(taken(7).len(), OWNER_RECEIVERS_MIN);
        // Ended connections count no more.
        drop((one, others));
        assert_eq!(taken(8).len(), ACCOUNT_RECEIVERS_MAX);
        assert!(classes.receivers.lock().unwrap().is_empty());
    }

    #[test]
    fn requests_that_stop_have_reserved_places() {
        let classes = ConnectionLimits::default();
        let command = Command::Snapshot;
        let taken: Vec<_> = std::iter::from_fn(|| classes.request(&command)).collect();
        assert_eq!(taken.len(), ASKING_MAX);
        let brakes: Vec<_> = std::iter::from_fn(|| classes.request(&Command::Shutdown)).collect();
        assert_eq!(brakes.len(), BRAKING_MAX);
        let stop = Command::Stop { by: String::new(), reason: String::new() };
        assert!(classes.request(&stop).is_some());
        drop(taken);
        assert!(classes.request(&command).is_some());
    }
}
