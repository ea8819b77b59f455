//! The search: CMA-ES in the unit box, every point simulated once.
//!
//! Owns the evaluator between optimizer and simulation: it rounds, remembers, counts, and keeps the best. The optimizer
//! is `basin`'s bounded CMA-ES (Hansen 2016, with the adaptive penalty at the box of `pycma`), driven by one seed. It
//! requests one point after the other and sees the cost alone, so the path does not depend on the number of workers. A
//! resumed search repeats the path through the journal. Must not judge a candidate.

use std::cell::RefCell;
use std::path::Path;

use basin::{
    BoundedCmaEs, BoxBounds, ConstraintDescription, ConstraintSet, ConstraintSolveError, Constraints,
    CostFunction, DenseMatrix, Executor, PopulationProgress,
};

use super::journal::Journal;
use super::objective::{FRESH_FROM, Objective, Score};
use super::package::PackageDraft;
use super::settings::{RefineError, SearchSettings};
use holdpoint_runtime::capability::Capability;

/// The first standard deviation, as a fraction of each range: large enough to leave the baseline, and small enough that
/// part of the first generation still succeeds.
const SIGMA: f64 = 0.1;

/// Fresh episodes for each training episode: the result is measured once, not searched.
pub const FRESH_FACTOR: u32 = 4;

/// How far a search is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SearchProgress {
    /// The generation that is evaluated, from 1; the last one while fresh episodes run.
    pub generation: u32,
    /// Generations there will be.
    pub generations: u32,
    /// Whether this evaluation ended a generation.
    pub generation_ended: bool,
    pub baseline: Score,
    /// The best score so far.
    pub best: Score,
    /// Episodes with a known result, journal entries included.
    pub episodes_done: u64,
    /// Of these, episodes simulated by this process.
    pub episodes_simulated: u64,
    /// Episodes in total.
    pub episodes_total: u64,
}

#[derive(Clone, Debug, PartialEq)]
pub struct SearchResult {
    /// The values of the parameters.
    pub values: Vec<f64>,
    pub score: Score,
    /// The baseline's score on the same episodes.
    pub baseline: Score,
}

struct SearchState {
    journal: Journal,
    baseline: Option<Score>,
    best: Option<(Vec<f64>, Score)>,
    /// Points that the optimizer requested.
    requested: u32,
    evaluations: u32,
    episodes_done: u64,
    episodes_simulated: u64,
}

/// The evaluator between the optimizer and the simulation.
pub struct Evaluator<'a> {
    objective: &'a Objective<'a>,
    draft: &'a PackageDraft<'a>,
    generations: u32,
    episodes: u32,
    seed: u32,
    count: RefCell<SearchState>,
    on_progress: RefCell<&'a mut dyn FnMut(&SearchProgress)>,
}

impl<'a> Evaluator<'a> {
    /// An evaluator that continues from a journal.
    pub fn new(
        objective: &'a Objective<'a>,
        draft: &'a PackageDraft<'a>,
        journal: Journal,
        settings: &SearchSettings<'_>,
        on_progress: &'a mut dyn FnMut(&SearchProgress),
    ) -> Self {
        let count = SearchState {
            journal,
            baseline: None,
            best: None,
            requested: 0,
            evaluations: 0,
            episodes_done: 0,
            episodes_simulated: 0,
        };
        let SearchSettings { generations, episodes, seed, .. } = *settings;
        Self {
            objective,
            draft,
            generations,
            episodes,
            seed,
            count: RefCell::new(count),
            on_progress: RefCell::new(on_progress),
        }
    }

    /// Searches to the end.
    ///
    /// # Errors
    /// [`RefineError::Interrupted`], [`RefineError::NothingBetter`], or the error of a step.
    pub fn search(&self) -> Result<SearchResult, RefineError> {
        let baseline = self.score(self.draft.baseline(), 0, self.episodes)?;
        self.count.borrow_mut().baseline = Some(baseline);
        self.report_progress(false);
        let space = self.draft.space();
        let (low, high) = (vec![0.0; space.axes().len()], vec![1.0; space.axes().len()]);
        let solver = BoundedCmaEs::<Vec<f64>, DenseMatrix>::new(u64::from(self.seed), SIGMA);
        let start = PopulationProgress::from_point(space.start());
        let run = Executor::new(BoundedProblem { evaluator: self, low, high }, solver, start)
            // The start of the run is the first generation.
            .max_iter(u64::from(self.generations) - 1)
            .run();
        match run {
            Ok(_) => {}
            Err(ConstraintSolveError::Evaluation(error)) => return Err(error),
            Err(other) => return Err(RefineError::Optimizer(other.to_string())),
        }
        let count = self.count.borrow();
        match &count.best {
            Some((values, score)) => Ok(SearchResult { values: values.clone(), score: *score, baseline }),
            None => Err(RefineError::NothingBetter {
                parent: self.draft.baseline().id(),
                evaluations: count.evaluations,
            }),
        }
    }

    /// Measures a version on episodes the search never saw.
    ///
    /// # Errors
    /// If it was interrupted or a worker failed.
    pub fn fresh(&self, version: &Capability) -> Result<Score, RefineError> {
        let score = self.score(version, FRESH_FROM, self.episodes * FRESH_FACTOR)?;
        self.report_progress(false);
        Ok(score)
    }

    /// The candidate with these values.
    ///
    /// # Errors
    /// As [`PackageDraft::candidate`].
    pub fn candidate(&self, values: &[f64], summary: &str) -> Result<Capability, RefineError> {
        self.draft.candidate(values, summary)
    }

    /// Sets of parameters evaluated so far, the baseline included.
    #[must_use]
    pub fn evaluations(&self) -> u32 {
        self.count.borrow().evaluations
    }

    /// Adds the path of the evaluations to an interruption.
    #[must_use]
    pub fn with_journal(&self, error: RefineError, path: &Path) -> RefineError {
        match error {
            RefineError::Interrupted { evaluations, .. } => {
                RefineError::Interrupted { evaluations, journal: path.to_owned() }
            }
            other => other,
        }
    }

    /// Points of a generation: the samples, and the mean.
    fn points(&self) -> u32 {
        let samples = BoundedCmaEs::<Vec<f64>, DenseMatrix>::default_lambda(self.draft.space().axes().len());
        u32::try_from(samples).unwrap_or(u32::MAX).saturating_add(1)
    }

    fn score(&self, version: &Capability, from: u64, episodes: u32) -> Result<Score, RefineError> {
        let key = self.objective.key(version, from, episodes);
        let cached = self.count.borrow().journal.get(&key);
        let score = match cached {
            Some(score) => score,
            None => {
                let Some(score) = self.objective.score(version, from, episodes)? else {
                    let evaluations = self.evaluations();
                    return Err(RefineError::Interrupted { evaluations, journal: std::path::PathBuf::new() });
                };
                let mut count = self.count.borrow_mut();
                count.journal.put(key, score)?;
                count.episodes_simulated += u64::from(episodes);
                score
            }
        };
        let mut count = self.count.borrow_mut();
        count.episodes_done += u64::from(episodes);
        if from < FRESH_FROM {
            count.evaluations += 1;
        }
        Ok(score)
    }

    /// The cost of a point that the optimizer requests.
    fn cost(&self, point: &[f64]) -> Result<f64, RefineError> {
        let values = self.draft.space().values(point);
        let candidate = self.draft.candidate(&values, "")?;
        let score = self.score(&candidate, 0, self.episodes)?;
        let ended = {
            let mut count = self.count.borrow_mut();
            count.requested += 1;
            let to_beat = count.best.as_ref().map(|(_, score)| *score).or(count.baseline);
            if to_beat.is_none_or(|to_beat| score.cost() < to_beat.cost()) {
                count.best = Some((values, score));
            }
            count.requested.is_multiple_of(self.points())
        };
        self.report_progress(ended);
        Ok(score.cost())
    }

    fn report_progress(&self, generation_ended: bool) {
        let count = self.count.borrow();
        let Some(baseline) = count.baseline else { return };
        let points = self.points();
        let per_point = u64::from(self.episodes);
        let generation =
            if generation_ended { count.requested / points } else { count.requested / points + 1 };
        let progress = SearchProgress {
            generation: generation.min(self.generations),
            generations: self.generations,
            generation_ended,
            baseline,
            best: count.best.as_ref().map_or(baseline, |(_, score)| *score),
            episodes_done: count.episodes_done,
            episodes_simulated: count.episodes_simulated,
            episodes_total: per_point
                * (1 + u64::from(points) * u64::from(self.generations) + 2 * u64::from(FRESH_FACTOR)),
        };
        drop(count);
        (self.on_progress.borrow_mut())(&progress);
    }
}

/// The evaluator with the unit box, in the optimizer's interface.
struct BoundedProblem<'e, 'a> {
    evaluator: &'e Evaluator<'a>,
    low: Vec<f64>,
    high: Vec<f64>,
}

impl Constraints for BoundedProblem<'_, '_> {
    type Set = ConstraintSet<BoxBounds<Vec<f64>>>;
    fn constraints(&self) -> <Self::Set as ConstraintDescription>::Borrowed<'_> {
        ConstraintSet::new().with_bounds(BoxBounds::new(Some(&self.low), Some(&self.high)))
    }
}

impl CostFunction for BoundedProblem<'_, '_> {
    type Param = Vec<f64>;
    type Output = f64;
    type Error = RefineError;
    fn cost(&self, point: &Vec<f64>) -> Result<f64, RefineError> {
        self.evaluator.cost(point)
    }
}
