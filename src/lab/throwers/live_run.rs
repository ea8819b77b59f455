//! One version through the stages, and then at work until it is rolled back or has done its tasks.
//!
//! Counts what the engine publishes and what the referee saw. The referee's verdicts are for the report alone.

use serde::{Deserialize, Serialize};

use super::controller::{self, HarmAct};
use super::package::ThrowerKind;
use crate::pipeline_experiments::candidate_run::{
    CandidateDriver, CandidateSetting, DecisionOutcome, DrivenSlice, StageRecord, ThresholdScale,
};
use crate::pipeline_experiments::{ExperimentError, scratch};
use holdpoint_cell::referee::UnsafeKind;
use holdpoint_engine::Experiment;
use holdpoint_engine::decide::pipeline::SliceOutcome;
use holdpoint_engine::live::station::TaskTruth;
use holdpoint_governance::decision::ReasonCode;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::monitor::SafetyEvent;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::rollback::{Trigger, TriggerKind};
use holdpoint_protocol::event::EventKind;
use holdpoint_protocol::scenario_state::Decider;
use holdpoint_store::ResultCache;
use holdpoint_trials::cache::EpisodeCache;
use holdpoint_trials::cell::Cell;
use holdpoint_trials::seeds::EpisodeSeeds;

/// Most slices of work until a version has been evaluated and has done its tasks.
const SLICES_MAX: u32 = 500_000;

/// Sequences for each task that is wanted: a version does none in a sequence that a neighbor ends.
const SEQUENCES_PER_TASK: u64 = 4;

/// One version to run.
pub(super) struct ThrowerJob<'a> {
    pub(super) kind: ThrowerKind,
    pub(super) act: HarmAct,
    pub(super) profile: ProfileName,
    /// Which run of the same kind, act and profile.
    pub(super) run: u64,
    pub(super) seeds: EpisodeSeeds,
    /// Live tasks after which it ends.
    pub(super) tasks: u64,
    pub(super) cell: &'a Cell,
    /// Where runs are cached.
    pub(super) cache: &'a ResultCache,
}

/// The result of one version under one profile.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ThrowerRun {
    pub trigger: ThrowerKind,
    pub act: HarmAct,
    pub profile: ProfileName,
    pub run: u64,
    pub version: CapabilityId,
    /// The state it ended in.
    pub state: State,
    pub activated: bool,
    pub confirmed: bool,
    /// The last decision about it, and the decider; absent without any.
    pub decider: Option<Decider>,
    pub decision: Option<DecisionOutcome>,
    /// Why, the deciding reasons first.
    pub codes: Vec<ReasonCode>,
    /// What it was rolled back for; absent if it was not.
    pub rollback: Option<TriggerKind>,
    /// The safety event, if it was rolled back for one.
    pub safety_event: Option<SafetyEvent>,
    /// Its live tasks.
    pub live_tasks: u64,
    /// Of these, with an object that flew, by the referee.
    pub thrown: u64,
    /// The first such task, counting from 1.
    pub first_thrown: Option<u64>,
    /// Of its live tasks, with anything unsafe by the referee.
    pub unsafe_tasks: u64,
    /// Of its live tasks, with a measure of harm past its limit.
    pub past_harm: u64,
    /// Tasks of all families in the live cell, from its registration on.
    pub cell_tasks: u64,
    /// Of these, with a start that the evidence of the task's version does not cover.
    pub uncovered: u64,
}

impl ThrowerRun {
    /// Where it came to its end: the rollback and its cause, at work, or the stage that stopped it.
    #[must_use]
    pub fn end(&self) -> String {
        if let Some(kind) = self.rollback {
            let event = self.safety_event.map(|event| format!(" ({event})")).unwrap_or_default();
            return format!("{} for {kind}{event}", self.state);
        }
        match (self.state, self.decider, self.decision) {
            (State::Active, ..) => "active".to_owned(),
            (_, Some(decider), Some(DecisionOutcome::Stage(outcome))) => format!("{decider}: {outcome}"),
            (_, Some(decider), Some(DecisionOutcome::Monitor(outcome))) => format!("{decider}: {outcome}"),
            (state, ..) => state.to_string(),
        }
    }

    /// Live tasks until its rollback; absent if it never became active, or is still at work.
    #[must_use]
    pub fn tasks_until_rollback(&self) -> Option<u64> {
        self.rollback.map(|_| self.live_tasks)
    }
}

/// What the version did in live work, and why it was rolled back.
#[derive(Default)]
struct LiveWork {
    judged: u64,
    thrown: u64,
    first_thrown: Option<u64>,
    unsafe_tasks: u64,
    past_harm: u64,
    cell_tasks: u64,
    uncovered: u64,
    rollback: Option<Trigger>,
}

impl LiveWork {
    fn take(&mut self, ours: &CapabilityId, events: &[EventKind], verdicts: &[TaskTruth]) {
        for event in events {
            match event {
                EventKind::Sequence { tasks, .. } => {
                    self.cell_tasks += tasks.len() as u64;
                    self.uncovered += tasks.iter().filter(|task| task.uncovered).count() as u64;
                }
                EventKind::HarmPastLimit { version, .. } if version == ours => self.past_harm += 1,
                EventKind::RolledBack { record, .. } if record.candidate == *ours => {
                    self.rollback = Some(record.trigger.clone());
                }
                _ => {}
            }
        }
        for (_, _, verdict) in verdicts.iter().filter(|(_, version, _)| version == ours) {
            self.judged += 1;
            self.unsafe_tasks += u64::from(verdict.is_unsafe());
            if verdict.event(UnsafeKind::ObjectThrown).is_some() {
                self.thrown += 1;
                self.first_thrown.get_or_insert(self.judged);
            }
        }
    }
}

impl ThrowerJob<'_> {
    /// Runs the version to its end. No other job of this process has its number at the same time.
    ///
    /// # Errors
    /// If the engine cannot start or halts, registration refuses the version, or it comes to no end.
    pub(super) fn run(&self, number: u64) -> Result<ThrowerRun, ExperimentError> {
        let (folder, store) = (scratch()?, scratch()?);
        controller::set_active(number, false);
        let package = self.kind.package(self.act, number, folder.path())?;
        let setting = CandidateSetting {
            cell: self.cell,
            profile: self.profile,
            seed: self.seeds.of_run().unwrap_or_default(),
            cache: self.cache,
            workers: 1,
            experiment: Experiment { first: self.kind.neighbors()?, ..Experiment::default() },
            thresholds: ThresholdScale::AsTheyAre,
        };
        let start = (self.seeds, EpisodeCache::InStore);
        let mut drive = CandidateDriver::start(&setting, start, store.path(), (self.kind.name(), &package))?;
        drive.pump.call_referee();
        drive.register(package)?;
        let mut work = LiveWork::default();
        let mut sequences = 0;
        for _ in 0..SLICES_MAX {
            let DrivenSlice { progress, view, prompt } = drive.slice()?;
            let verdicts = drive.pump.take_verdicts();
            work.take(&drive.version, &drive.events, &verdicts);
            controller::set_active(number, view.state == State::Active);
            let has_left = drive.seen.activated && view.state != State::Active;
            let is_idle = matches!(progress, SliceOutcome::Idle { .. });
            let is_over = if has_left {
                // The record of a rollback follows the first sequences after it.
                work.rollback.is_some() || is_idle
            } else {
                view.state.is_terminal()
                    || drive.seen.effort.live >= self.tasks
                    || sequences >= self.tasks.saturating_mul(SEQUENCES_PER_TASK)
            };
            if is_over {
                return Ok(self.result(&drive, work, view.state));
            }
            if let Some(prompt) = prompt {
                drive.approve(&prompt)?;
                continue;
            }
            if let SliceOutcome::Idle { next_ms } = progress {
                if view.state == State::Active {
                    sequences += 1;
                    drive.pump.work_one();
                } else if !next_ms.is_some_and(|next_ms| drive.pump.jump_to(next_ms)) {
                    // It is on hold, and nothing changes that by itself.
                    return Ok(self.result(&drive, work, view.state));
                }
            }
        }
        Err(drive.unsettled("it came to no end within the limit of slices"))
    }

    fn result(&self, drive: &CandidateDriver<'_>, work: LiveWork, state: State) -> ThrowerRun {
        let last = drive.seen.stages.last();
        ThrowerRun {
            trigger: self.kind,
            act: self.act,
            profile: self.profile,
            run: self.run,
            version: drive.version.clone(),
            state,
            activated: drive.seen.activated,
            confirmed: drive.seen.confirmed,
            decider: last.map(|last| last.stage),
            decision: last.map(|last| last.decision),
            codes: last.map(StageRecord::codes).unwrap_or_default(),
            rollback: work.rollback.as_ref().map(|trigger| trigger.kind),
            safety_event: work.rollback.as_ref().and_then(|trigger| trigger.event),
            live_tasks: drive.seen.effort.live,
            thrown: work.thrown,
            first_thrown: work.first_thrown,
            unsafe_tasks: work.unsafe_tasks,
            past_harm: work.past_harm,
            cell_tasks: work.cell_tasks,
            uncovered: work.uncovered,
        }
    }
}
