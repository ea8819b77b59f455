//! Counts of what a thread has simulated: the cost of an evaluation, the same on every machine.

use std::cell::Cell;

/// What one thread has simulated since it began.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct WorkCount {
    /// Episodes set up.
    pub episodes: u64,
    /// Worlds that continued from a copy of another.
    pub forks: u64,
    /// Ticks of physics, including those that close the hand on an object before an episode.
    pub ticks: u64,
}

impl WorkCount {
    const NONE: Self = Self { episodes: 0, forks: 0, ticks: 0 };

    /// What has been simulated since an earlier reading.
    #[must_use]
    pub const fn since(self, earlier: Self) -> Self {
        Self {
            episodes: self.episodes.wrapping_sub(earlier.episodes),
            forks: self.forks.wrapping_sub(earlier.forks),
            ticks: self.ticks.wrapping_sub(earlier.ticks),
        }
    }
}

thread_local! {
    static COUNT: Cell<WorkCount> = const { Cell::new(WorkCount::NONE) };
}

/// What this thread has simulated.
#[must_use]
pub fn on_this_thread() -> WorkCount {
    COUNT.get()
}

pub(crate) fn note(change: fn(&mut WorkCount)) {
    let mut count = COUNT.get();
    change(&mut count);
    COUNT.set(count);
}
