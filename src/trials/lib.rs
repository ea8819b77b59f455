//! Runs episodes, pairs, drills, sequences and re-runs of versions in trial cells, on a worker pool, with cached results
//! where possible.
//!
//! Owns the cell of every measurement with its site, its look for a screen and its embedded versions, the seeds, the trials
//! and their traces.
//! It judges nothing: the stages request runs, and the rules in governance judge them. Must not know a stage, a record, a
//! person or the live arm.

pub mod cache;
pub mod cell;
pub mod cell_frame;
pub mod drills;
pub mod embedded;
pub mod episodes;
pub mod evaluation;
pub mod fault;
pub mod job_outcome;
pub mod live_start;
pub mod mode_metrics;
pub mod pair_spot;
pub mod past_limit;
pub mod reuse;
pub mod scene_stops;
pub mod search;
pub mod seeds;
pub mod sequences;
pub mod site;
pub mod solo_mode;
pub mod stress;
pub mod tick_time;
pub mod trace;
pub mod trial_lab;
pub mod trial_subject;
pub mod undisturbed_run;
pub mod unoffered_sensor;
pub mod worker;
pub mod worker_pool;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use holdpoint_store::{OpenStore, ResultCache};

use self::cache::EpisodeCache;
use self::job_outcome::JobOutcome;
use self::seeds::SeedSource;
use self::sequences::TrialTeam;
use self::trial_lab::TrialLab;
use self::undisturbed_run::UndisturbedCache;
use self::worker_pool::WorkerPool;
use crate::cell::Cell;
use crate::fault::TrialFault;

/// How one engine runs evaluations.
pub struct Trials {
    /// The most pairs or drills of one slice.
    part: usize,
    cancel: Arc<AtomicBool>,
    cache: EpisodeCache,
    worker_pool: WorkerPool<JobOutcome>,
    undisturbed: Arc<UndisturbedCache>,
}

impl Trials {
    /// With `jobs` workers; whole slices until [`Trials::work_in_small_parts`].
    #[must_use]
    pub fn new(jobs: usize, cache: EpisodeCache, cancel: Arc<AtomicBool>) -> Self {
        Self {
            part: usize::MAX,
            cancel,
            cache,
            worker_pool: WorkerPool::new(jobs),
            undisturbed: Arc::new(UndisturbedCache::new()),
        }
    }

    /// How many work at a time.
    #[must_use]
    pub const fn jobs(&self) -> usize {
        self.worker_pool.jobs()
    }

    /// The most episodes, pairs or drills of one slice.
    #[must_use]
    pub const fn part(&self) -> usize {
        self.part
    }

    /// From now on slices are small, so that requests are answered soon.
    pub fn work_in_small_parts(&mut self) {
        self.part = self.worker_pool.jobs();
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

    /// Drops the jobs that were announced and have not begun: their evaluation ended.
    ///
    /// # Errors
    /// If no thread starts.
    pub fn drop_announced(&self) -> Result<(), TrialFault> {
        self.worker_pool.expect(Vec::new())
    }

    /// The cached results of active versions.
    #[must_use]
    pub fn result_cache<'a>(&'a self, store: &'a dyn OpenStore) -> &'a ResultCache {
        self.cache.result_cache(store)
    }

    /// The inputs of an evaluation with these seeds.
    #[must_use]
    pub fn lab<'a>(&'a self, cell: &'a Cell, store: &'a dyn OpenStore, seeds: SeedSource) -> TrialLab<'a> {
        TrialLab {
            seeds,
            worker_pool: &self.worker_pool,
            undisturbed: &self.undisturbed,
            part: self.part,
            cancel: &self.cancel,
            cell,
            cache: self.result_cache(store),
            team: TrialTeam::default(),
            anchor: None,
        }
    }
}

#[cfg(test)]
pub(crate) const MANIFESTS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/../../manifests");
