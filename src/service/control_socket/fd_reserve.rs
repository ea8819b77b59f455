//! Limits connections by the file descriptors of the process. Some stay free for the store, for a stop mark, and for a
//! client that stops the cell while all others are in use.

use std::fs::{self, File};

use rustix::process::{Resource, getrlimit};

use super::connection_limits::{ASKING_MAX, IDLE_MAX, OBSERVERS_MAX};

/// Descriptors that the engine opens after its socket: its databases with their logs, readers of them, recordings, a mark.
const KEPT_FREE: usize = 20;

/// The fewest connections, however few descriptors there are.
const CONNECTIONS_MIN: usize = 4;

/// The most connections: the sum over all classes.
const CONNECTIONS_MAX: usize = OBSERVERS_MAX + ASKING_MAX + IDLE_MAX;

/// The most connections beyond that: each must take authority away at once, or the engine closes it.
pub(super) const CROWDED_MAX: usize = 4;

/// The most connections in the present state of the process.
pub(super) fn connections_max() -> usize {
    let limit = getrlimit(Resource::Nofile).current.and_then(|limit| usize::try_from(limit).ok());
    let open = fs::read_dir("/proc/self/fd").map_or(0, Iterator::count);
    room(limit, open)
}

/// `limit`: absent if there is none.
fn room(limit: Option<usize>, open: usize) -> usize {
    let free = limit.map_or(CONNECTIONS_MAX, |limit| limit.saturating_sub(open + KEPT_FREE + CROWDED_MAX));
    free.clamp(CONNECTIONS_MIN, CONNECTIONS_MAX)
}

/// A spare descriptor, to be freed when no others are left.
pub(super) fn spare() -> Option<File> {
    File::open("/dev/null").ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_descriptors_leave_few_connections_and_never_none() {
        assert_eq!(room(Some(40), 13), CONNECTIONS_MIN);
        assert_eq!(room(Some(64), 13), 27);
        assert_eq!(room(Some(10), 13), CONNECTIONS_MIN);
        assert_eq!((room(Some(1 << 20), 13), room(None, 13)), (CONNECTIONS_MAX, CONNECTIONS_MAX));
    }
}
