//! Limits connections by their class, so that no client shuts the others out.
//!
//! An idle connection takes no place from others: beyond [`IDLE_MAX`], the longest idle one is closed. Subscribers,
//! requests, and requests that take authority away have separate places, and the last class has some in reserve. A stop
//! of the cell needs no place: it takes effect before any check here. Only programs of the user's own account can connect,
//! so these limits protect against those. A program that connects faster than others can send still blocks them.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use holdpoint_protocol::command::Command;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio_util::sync::CancellationToken;

/// The most connections that receive events.
pub const OBSERVERS_MAX: usize = 64;

/// The most requests that are answered at a time.
pub const ASKING_MAX: usize = 32;

/// Additional places for requests that take authority away.
pub const BRAKING_MAX: usize = 8;

/// The most stops that wait to be recorded; the arm is at standstill for all of them.
pub const STOPS_MAX: usize = 16;

/// The most idle connections.
pub const IDLE_MAX: usize = 64;

/// The places of each class.
#[derive(Clone, Debug)]
pub(super) struct ConnectionLimits {
    observers: Arc<Semaphore>,
    asking: Arc<Semaphore>,
    braking: Arc<Semaphore>,
    stops: Arc<Semaphore>,
    idle: Arc<Mutex<IdleConnections>>,
}

impl Default for ConnectionLimits {
    fn default() -> Self {
        let places = |count| Arc::new(Semaphore::new(count));
        Self {
            observers: places(OBSERVERS_MAX),
            asking: places(ASKING_MAX),
            braking: places(BRAKING_MAX),
            stops: places(STOPS_MAX),
            idle: Arc::default(),
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
    gives_way: CancellationToken,
}

impl IdleConnection {
    /// Resolves when the connection must close.
    pub(super) async fn gives_way(&self) {
        self.gives_way.cancelled().await;
    }
}

impl Drop for IdleConnection {
    fn drop(&mut self) {
        self.idle.lock().unwrap_or_else(PoisonError::into_inner).longest_first.remove(&self.place);
    }
}

impl ConnectionLimits {
    /// A connection begins to wait for a request of its client.
    pub(super) fn silent(&self) -> IdleConnection {
        let mut idle = self.idle.lock().unwrap_or_else(PoisonError::into_inner);
        if idle.longest_first.len() >= IDLE_MAX
            && let Some((_, longest)) = idle.longest_first.pop_first()
        {
            longest.cancel();
        }
        let place = idle.next;
        idle.next += 1;
        let gives_way = CancellationToken::new();
        idle.longest_first.insert(place, gives_way.clone());
        IdleConnection { idle: Arc::clone(&self.idle), place, gives_way }
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

    /// A place for a subscriber; `None` if there is none left.
    pub(super) fn observer(&self) -> Option<OwnedSemaphorePermit> {
        Arc::clone(&self.observers).try_acquire_owned().ok()
    }

    /// A place for a request while it is answered; `None` if there is none left.
    pub(super) fn request(&self, command: &Command) -> Option<OwnedSemaphorePermit> {
        let place = |of: &Arc<Semaphore>| Arc::clone(of).try_acquire_owned().ok();
        if matches!(command, Command::Stop { .. }) {
            return place(&self.stops);
        }
        let kept = || command.takes_authority_away().then(|| place(&self.braking)).flatten();
        place(&self.asking).or_else(kept)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn who_was_silent_longest_gives_way() {
        let classes = ConnectionLimits::default();
        let mut silent: Vec<IdleConnection> = (0..IDLE_MAX).map(|_| classes.silent()).collect();
        // The first one makes a request, and is idle again.
        drop(silent.remove(0));
        silent.push(classes.silent());
        assert!(silent.iter().all(|one| !one.gives_way.is_cancelled()));
        let newest = classes.silent();
        let gone: Vec<usize> = silent
            .iter()
            .enumerate()
            .filter(|(_, one)| one.gives_way.is_cancelled())
            .map(|(i, _)| i)
            .collect();
        assert_eq!((gone, newest.gives_way.is_cancelled()), (vec![0], false));
    }

    #[test]
    fn what_takes_authority_away_has_places_of_its_own() {
        let classes = ConnectionLimits::default();
        let ask = Command::Snapshot;
        let taken: Vec<_> = std::iter::from_fn(|| classes.request(&ask)).collect();
        assert_eq!(taken.len(), ASKING_MAX);
        let brakes: Vec<_> = std::iter::from_fn(|| classes.request(&Command::Shutdown)).collect();
        assert_eq!(brakes.len(), BRAKING_MAX);
        let stop = Command::Stop { by: String::new(), reason: String::new() };
        assert!(classes.request(&stop).is_some());
        drop(taken);
        assert!(classes.request(&ask).is_some());
    }
}
