//! Re-runs the closed evaluations of a store from their revealed keys, and compares each result with the record.
//!
//! A copy of the store without its secret and the same build are enough. Owns the order of the work, its limit and the report.
//! Decides nothing and writes nothing.

mod cast;
mod recorded_evaluation;
mod repeated_run;

use serde::Serialize;

use holdpoint_cell::CellError;
use holdpoint_governance::evidence::EvidenceBinding;
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::metrics::store_metrics::{NotReplayable, ReplayOutcome};
use holdpoint_governance::record::RecordKind;
use holdpoint_record::context::ContextRecord;
use holdpoint_store::{EvidenceEntry, EvidenceKind, RecordViews, StoreError};
use holdpoint_trials::cell::Cell;
use holdpoint_trials::fault::TrialFault;

use self::recorded_evaluation::{RecordedEvaluation, RecordedKeys};
use self::repeated_run::{RepeatedRun, RerunWorkers};
use super::history::History;
use super::replay::{Replayer, RulesInForce, VersionRecords};

/// What a re-run needs beside the store.
pub struct RerunSettings<'a> {
    /// The cell that runs the episodes.
    pub cell: Cell,
    /// Its digest at the site of the store, as evidence names it.
    pub environment: Digest,
    /// Profiles that are known without the record.
    pub frames: Vec<RulesInForce>,
    /// Episodes at once.
    pub jobs: usize,
    /// The most evaluations that are re-run, in the order of registration.
    pub most: u64,
    /// Receives the version, its pairs and drills so far, and their budget.
    pub tell: &'a dyn Fn(&CapabilityId, u64, u64),
}

/// A decision that was made again.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct RerunDecision {
    /// The record of the decision, or of the evidence that settled a concern.
    pub record: u64,
    /// The version it is about.
    pub version: CapabilityId,
    /// Episodes, drills and sequences that were run for it; 0 if it rests on no evaluation of its own.
    pub runs: u64,
    /// The comparison with the record.
    #[serde(flatten)]
    pub replay: ReplayOutcome,
}

/// The decisions of a store, made again.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct StoreRerun {
    /// The last record that counts.
    pub to_record: u64,
    /// Evaluations that were re-run.
    pub evaluations: u64,
    /// Each decision of a stage, and each evidence on a concern, by version.
    pub decisions: Vec<RerunDecision>,
}

impl StoreRerun {
    /// Whether a decision differs from its record.
    #[must_use]
    pub fn has_difference(&self) -> bool {
        self.decisions.iter().any(|one| matches!(one.replay, ReplayOutcome::Differs { .. }))
    }

    /// Whether every decision was made again and equals its record.
    #[must_use]
    pub fn is_equal(&self) -> bool {
        self.decisions.iter().all(|one| one.replay == ReplayOutcome::Equal)
    }
}

/// Why an evaluation was not re-run.
enum Obstacle {
    Not(NotReplayable),
    Fault(TrialFault),
}

impl From<NotReplayable> for Obstacle {
    fn from(why: NotReplayable) -> Self {
        Self::Not(why)
    }
}

impl From<TrialFault> for Obstacle {
    fn from(fault: TrialFault) -> Self {
        Self::Fault(fault)
    }
}

impl From<StoreError> for Obstacle {
    fn from(error: StoreError) -> Self {
        Self::Fault(error.into())
    }
}

impl From<CellError> for Obstacle {
    fn from(error: CellError) -> Self {
        Self::Fault(error.into())
    }
}

impl From<serde_json::Error> for Obstacle {
    fn from(error: serde_json::Error) -> Self {
        Self::Fault(error.into())
    }
}

/// Makes every decision of a store again: re-runs its evaluations, and applies the rules to the recorded evidence.
///
/// # Errors
/// If the store cannot be read, or a trial cell or a worker fails.
pub fn rerun(views: &dyn RecordViews, settings: RerunSettings<'_>) -> Result<StoreRerun, TrialFault> {
    let RerunSettings { cell, environment, frames, jobs, most, tell } = settings;
    let to_record = views.head()?.seq;
    let history = History::read(views, to_record)?;
    let replayer = Replayer::new(views, &history, frames, environment);
    let context = views.context()?.and_then(|(_, _, json)| serde_json::from_str(&json).ok());
    let keys = RecordedKeys::read(views, to_record)?;
    let workers = RerunWorkers::new(jobs)?;
    let store =
        StoreUnderRerun { views, replayer: &replayer, keys, context, cell, environment, workers, tell };
    let mut report = StoreRerun { to_record, evaluations: 0, decisions: Vec::new() };
    for (_, id, _) in &history.registered {
        let of = VersionRecords::read(views, id)?;
        let name = id.to_string();
        let decided = history.decisions.iter();
        for record in decided.filter(|one| one.kind == RecordKind::Decision && one.subject == name) {
            let entry = of.evidence.iter().rev().find(|entry| entry.seq < record.seq);
            let replay = replayer.decision(&of, record);
            store.decide((&of, record.seq), entry, replay, most, &mut report)?;
        }
        let settled = of.evidence.iter().filter(|entry| entry.kind == EvidenceKind::Monitor);
        for entry in settled.filter(|entry| entry.seq <= to_record) {
            if let Some(replay) = replayer.replay_concern(entry) {
                store.decide((&of, entry.seq), Some(entry), replay, most, &mut report)?;
            }
        }
    }
    Ok(report)
}

/// The store whose evaluations are re-run.
struct StoreUnderRerun<'a> {
    views: &'a dyn RecordViews,
    replayer: &'a Replayer<'a>,
    keys: RecordedKeys,
    /// The context of the last engine, if it is readable.
    context: Option<ContextRecord>,
    cell: Cell,
    environment: Digest,
    workers: RerunWorkers,
    tell: &'a dyn Fn(&CapabilityId, u64, u64),
}

impl StoreUnderRerun<'_> {
    /// Adds a decision to the report. `entry`: the evidence it rests on; `replay`: what the rules give on that evidence.
    fn decide(
        &self,
        (of, record): (&VersionRecords, u64),
        entry: Option<&EvidenceEntry>,
        replay: ReplayOutcome,
        most: u64,
        report: &mut StoreRerun,
    ) -> Result<(), TrialFault> {
        let mut decision = RerunDecision { record, version: of.id.clone(), runs: 0, replay };
        let evaluation = entry.and_then(|entry| Some((entry.seq, RecordedEvaluation::of(entry)?)));
        if let Some((seq, evaluation)) = evaluation {
            let repeated = if report.evaluations < most {
                self.repeat(of, seq, &evaluation)
            } else {
                Err(NotReplayable::BeyondLimit.into())
            };
            let is_equal = decision.replay == ReplayOutcome::Equal;
            match repeated {
                Ok(RepeatedRun { runs, difference }) => {
                    report.evaluations += 1;
                    decision.runs = runs;
                    if let Some(what) = difference {
                        decision.replay = ReplayOutcome::Differs { what };
                    }
                }
                Err(Obstacle::Not(why)) if is_equal => {
                    decision.replay = ReplayOutcome::NotReplayed { why };
                }
                Err(Obstacle::Not(_)) => {}
                Err(Obstacle::Fault(fault)) => return Err(fault),
            }
        }
        report.decisions.push(decision);
        Ok(())
    }

    /// Re-runs an evaluation whose evidence is in the record `seq`.
    fn repeat(
        &self,
        of: &VersionRecords,
        seq: u64,
        evaluation: &RecordedEvaluation,
    ) -> Result<RepeatedRun, Obstacle> {
        let binding = evaluation.binding().ok_or(NotReplayable::EvidenceMissing)?;
        if self.context.as_ref().is_some_and(|context| !context.omitted.is_none()) {
            return Err(NotReplayable::PartsOmitted.into());
        }
        if binding.environment != self.environment {
            return Err(self.other_environment(&binding).into());
        }
        if evaluation.is_ended_by_time() {
            return Err(NotReplayable::EndedByTime.into());
        }
        let seeds = self.keys.seeds(&of.id, seq, evaluation)?;
        let cast = self.cast(of, seq, evaluation, seeds)?;
        self.run(&cast, seeds, evaluation)
    }

    /// Why evidence of another environment is not made again here: by its build, or else by its cell.
    fn other_environment(&self, binding: &EvidenceBinding) -> NotReplayable {
        let named = self.context.as_ref().filter(|context| context.environment == Some(binding.environment));
        match named {
            Some(context) if context.computed_by == self.cell.computed_by() => NotReplayable::OtherCell,
            Some(_) | None => NotReplayable::OtherBuild,
        }
    }
}
