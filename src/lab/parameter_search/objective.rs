//! The search's data about a set of parameters: whether the task was done, and how long it took.
//!
//! Owns the conditions, the episodes and the score. Must not look at anything else in a record: no limit, no
//! watcher, no attempt counted, no disturbance (`tests/tidy.rs` holds this folder to it).
//!
//! The conditions are the *canonical* ones: object, mass, friction, start and target vary; sensors are exact, nothing
//! is late and nothing pushes. A learner on a calm bench sees these. There every baseline nearly always succeeds, so
//! success alone gives a flat objective. A reward at the end of a task is worth more the earlier it comes, and a
//! learner that discounts is trained on that: hence *most tasks done, ties broken by the shorter time*. On the flat
//! part only the time remains. The search reduces it by giving up what the bench never needs: settling, second looks,
//! slow contact, clearance. No fault is planted; unrewarded behavior is lost.
//!
//! Episodes run as all others do, in the simulated cell under guard and watcher of the profile `sim`. A run that these
//! break off counts as not done; the search gets no other data of it.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use holdpoint_body::RATE_HZ;
use holdpoint_sim::SimCells;
use serde::{Deserialize, Serialize};

use super::settings::RefineError;
use holdpoint_governance::ids::Digest;
use holdpoint_governance::policy::PolicyTable;
use holdpoint_governance::profile::{Profile, ProfileName};
use holdpoint_runtime::capability::Capability;
use holdpoint_runtime::task::TaskRecord;
use holdpoint_runtime::terms::SkillTerms;
use holdpoint_trials::cell::{Cell, Conditions};
use holdpoint_trials::episodes::{batch, cache_key};
use holdpoint_trials::seeds::practice_seed;
use holdpoint_trials::worker_pool::WorkerPool;

/// The conditions that the search trains in.
pub const CONDITIONS: Conditions = Conditions::Canonical;

/// Index of the first episode that the search never trains on; the training episodes are below it.
pub const FRESH_FROM: u64 = 5_000;

/// Longer than any task may take, s: a mean time divided by it is below one failure.
const TIME_SCALE_SECS: f64 = 120.0;

/// The result of a number of episodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Score {
    pub episodes: u32,
    /// Those in which the work was done.
    pub successes: u32,
    /// Duration of those, ticks of 1/240 s, summed up: whole numbers are kept and compared exactly.
    pub ticks: u64,
}

impl Score {
    /// Rate of the episodes in which the work was done.
    #[must_use]
    pub fn success(&self) -> f64 {
        f64::from(self.successes) / f64::from(self.episodes.max(1))
    }

    /// Mean duration of the episodes in which the work was done, s.
    #[must_use]
    pub fn time_secs(&self) -> Option<f64> {
        (self.successes > 0).then(|| self.ticks as f64 / f64::from(RATE_HZ) / f64::from(self.successes))
    }

    /// The minimized value: episodes not done, and below one of these the mean time.
    #[must_use]
    pub fn cost(&self) -> f64 {
        let time = self.time_secs().map_or(1.0, |secs| (secs / TIME_SCALE_SECS).min(1.0));
        f64::from(self.episodes - self.successes.min(self.episodes)) + time
    }
}

impl std::fmt::Display for Score {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}/{} done", self.successes, self.episodes)?;
        match self.time_secs() {
            Some(secs) => write!(f, " in {secs:.2} s"),
            None => Ok(()),
        }
    }
}

/// Simulates sets of parameters.
pub struct Objective<'a> {
    cell: Cell,
    terms: SkillTerms,
    policy: Digest,
    seed: u32,
    worker_pool: WorkerPool<TaskRecord>,
    cancel: &'a AtomicBool,
}

impl<'a> Objective<'a> {
    /// The built-in cell under the profile `sim`.
    ///
    /// # Errors
    /// If an embedded file does not parse.
    pub fn new(seed: u32, jobs: usize, cancel: &'a AtomicBool) -> Result<Self, RefineError> {
        let cell = Cell::of(&SimCells, None)?;
        let profile = Profile::builtin(ProfileName::Sim)?;
        let table = Arc::new(PolicyTable::builtin(&profile)?);
        let policy = table.digest;
        let terms = SkillTerms::new(&profile, table, cell.geometry.clone(), cell.zones.clone());
        Ok(Self { cell, terms, policy, seed, worker_pool: WorkerPool::new(jobs), cancel })
    }

    /// The key of a cached score: everything that determines it.
    #[must_use]
    pub fn key(&self, version: &Capability, from: u64, episodes: u32) -> Digest {
        let first = practice_seed(self.seed, from);
        let under = cache_key(&self.cell, &self.terms, version, CONDITIONS, first);
        let parts: [&[u8]; 4] =
            [under.bytes(), self.policy.bytes(), &episodes.to_le_bytes(), self.cell.computed_by().as_bytes()];
        Digest::of_parts("holdpoint.refine.score.v1", &parts)
    }

    /// Simulates the episodes from index `from` on. None if it was interrupted.
    ///
    /// # Errors
    /// If a worker failed.
    pub fn score(
        &self,
        version: &Capability,
        from: u64,
        episodes: u32,
    ) -> Result<Option<Score>, RefineError> {
        let seeds = (from..from + u64::from(episodes)).map(|index| practice_seed(self.seed, index));
        let party = (version, &self.terms);
        let found = batch(&self.worker_pool, self.cancel, &self.cell, party, CONDITIONS, seeds);
        let records = match found {
            Ok(records) => records,
            Err(_) if self.cancel.load(Ordering::Acquire) => return Ok(None),
            Err(fault) => return Err(fault.into()),
        };
        let done = records.iter().filter(|record| record.success);
        let mut score = Score { episodes, successes: 0, ticks: 0 };
        for record in done {
            score.successes += 1;
            // A task ends after some thousand ticks at most.
            #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss)]
            let ticks = libm::round(record.time_secs * f64::from(RATE_HZ)) as u64;
            score.ticks += ticks;
        }
        Ok(Some(score))
    }
}

/// The objective of the baseline and of the result, on the same episodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct ObjectivePair {
    pub before: Score,
    pub after: Score,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::parameter_search::search::FRESH_FACTOR;
    use crate::parameter_search::settings::EPISODES_MAX;
    use holdpoint_trials::seeds::PRACTICE_FROM;

    /// (better, worse): episodes, successes, ticks.
    #[test]
    fn objective_ranks_by_success_and_then_by_time() {
        for (better, worse) in [
            ((10, 10, 9_000), (10, 9, 900)),
            ((10, 10, 900), (10, 10, 901)),
            ((10, 1, 7_200), (10, 0, 0)),
            // The longest tasks there can be are still better than one more failure.
            ((500, 500, 500 * 7_200), (500, 499, 499)),
            // The mean counts, not the sum.
            ((10, 9, 900), (10, 9, 909)),
        ] {
            let score = |(episodes, successes, ticks)| Score { episodes, successes, ticks };
            assert!(score(better).cost() < score(worse).cost(), "{better:?} {worse:?}");
        }
    }

    #[test]
    fn practice_and_fresh_episodes_are_disjoint_calibration_seeds() {
        assert!(practice_seed(0, 0) >= PRACTICE_FROM.max(1_000_000));
        assert!(u64::from(EPISODES_MAX) <= FRESH_FROM);
        let fresh = FRESH_FROM + u64::from(EPISODES_MAX * FRESH_FACTOR);
        assert!(fresh <= holdpoint_trials::seeds::BLOCK);
    }
}
