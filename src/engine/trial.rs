//! Where versions are tried out: episodes, pairs and drills by a crew of workers, cached if they can be.
//!
//! Runs what it is told and judges nothing; the stages ask and the rules in governance judge.

pub mod cache;
pub mod crew;
pub mod drills;
pub mod episodes;
pub mod evaluation;
pub mod lab;
pub mod measures;
pub mod outcome;
pub mod party;
pub mod reuse;
pub mod search;
pub mod seeds;
pub mod sequences;
pub mod stress;
pub mod trace;
pub mod undisturbed;
pub mod worker;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use holdpoint_registry::{KeptCells, Store};

use self::cache::EpisodeCache;
use self::crew::Crew;
use self::lab::Lab;
use self::outcome::ErrandOutcome;
use self::sequences::Team;
use self::undisturbed::Shelf;
use crate::cell::Cell;

/// How evaluations of one engine are run.
pub struct Trials {
    seed: u64,
    /// The most pairs or drills of one slice.
    part: usize,
    cancel: Arc<AtomicBool>,
    cache: EpisodeCache,
    crew: Crew<ErrandOutcome>,
    undisturbed: Arc<Shelf>,
}

impl Trials {
    /// With a run's seed and so many workers; whole slices until [`Trials::work_in_small_parts`].
    #[must_use]
    pub fn new(seed: u64, jobs: usize, cache: EpisodeCache, cancel: Arc<AtomicBool>) -> Self {
        Self {
            seed,
            part: usize::MAX,
            cancel,
            cache,
            crew: Crew::new(jobs),
            undisturbed: Arc::new(Shelf::new()),
        }
    }

    /// Seed of the run.
    #[must_use]
    pub const fn seed(&self) -> u64 {
        self.seed
    }

    /// The most episodes, pairs or drills of one slice.
    #[must_use]
    pub const fn part(&self) -> usize {
        self.part
    }

    /// From now on a slice is small, so that who asks is answered soon.
    pub fn work_in_small_parts(&mut self) {
        self.part = self.crew.jobs();
    }

    /// Set to interrupt running evaluations between episodes.
    #[must_use]
    pub fn cancel(&self) -> Arc<AtomicBool> {
        Arc::clone(&self.cancel)
    }

    /// Whether evaluations are being interrupted on purpose.
    #[must_use]
    pub fn is_cancelled(&self) -> bool {
        self.cancel.load(Ordering::Relaxed)
    }

    /// Where results of active versions are kept.
    #[must_use]
    pub const fn cells<'a>(&'a self, store: &'a Store) -> &'a KeptCells {
        self.cache.cells(store)
    }

    /// What an evaluation is run with.
    #[must_use]
    pub fn lab<'a>(&'a self, cell: &'a Cell, store: &'a Store) -> Lab<'a> {
        Lab {
            seed: self.seed,
            crew: &self.crew,
            undisturbed: &self.undisturbed,
            part: self.part,
            cancel: &self.cancel,
            cell,
            cells: self.cells(store),
            team: Team::default(),
        }
    }
}
