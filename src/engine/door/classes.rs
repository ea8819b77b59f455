//! Who may be at the door at a time: by what a connection does, so that none of them shuts the others out.
//!
//! A connection that asks for nothing holds no place that somebody else could want: beyond
//! [`IDLE_MAX`] the one that has been silent longest gives way. Who listens, who asks and who takes authority away have
//! places of their own, and what takes authority away has some more that nobody else gets. Stopping the cell needs
//! none: it is done before anything here is asked. All of this is against one's own user's programs, since nobody
//! else's are heard; one that connects faster than others can speak still keeps them from speaking.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use holdpoint_protocol::command::Command;
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio_util::sync::CancellationToken;

/// The most connections that are told events.
pub const OBSERVERS_MAX: usize = 64;

/// The most requests that are being answered.
pub const ASKING_MAX: usize = 32;

/// As many more, for what takes authority away.
pub const BRAKING_MAX: usize = 8;

/// The most stops that wait to be put on record; the arm stands for all of them.
pub const STOPS_MAX: usize = 16;

/// The most connections that ask for nothing.
pub const IDLE_MAX: usize = 64;

/// The places there are.
#[derive(Clone, Debug)]
pub(super) struct Classes {
    observers: Arc<Semaphore>,
    asking: Arc<Semaphore>,
    braking: Arc<Semaphore>,
    stops: Arc<Semaphore>,
    idle: Arc<Mutex<Idle>>,
}

impl Default for Classes {
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

/// Connections that ask for nothing, by when they began to.
#[derive(Debug, Default)]
struct Idle {
    next: u64,
    longest_first: BTreeMap<u64, CancellationToken>,
}

/// A connection asks for nothing as long as this lives.
#[derive(Debug)]
pub(super) struct Silent {
    idle: Arc<Mutex<Idle>>,
    place: u64,
    gives_way: CancellationToken,
}

impl Silent {
    /// Resolves when it has to give way.
    pub(super) async fn gives_way(&self) {
        self.gives_way.cancelled().await;
    }
}

impl Drop for Silent {
    fn drop(&mut self) {
        self.idle.lock().unwrap_or_else(PoisonError::into_inner).longest_first.remove(&self.place);
    }
}

impl Classes {
    /// A connection begins to wait for what its client wants.
    pub(super) fn silent(&self) -> Silent {
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
        Silent { idle: Arc::clone(&self.idle), place, gives_way }
    }

    /// The connection that has asked for nothing for longest gives way. Tells whether there was one.
    pub(super) fn make_room(&self) -> bool {
        let mut idle = self.idle.lock().unwrap_or_else(PoisonError::into_inner);
        let longest = idle.longest_first.pop_first();
        longest.is_some_and(|(_, longest)| {
            longest.cancel();
            true
        })
    }

    /// A place for one that is told events; `None` if there is none left.
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
        let classes = Classes::default();
        let mut silent: Vec<Silent> = (0..IDLE_MAX).map(|_| classes.silent()).collect();
        // The first one asks for something, and is silent again.
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
        let classes = Classes::default();
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
