//! One version through the stages, and then at work until it is rolled back or has done its tasks.
//!
//! Counts what the engine publishes and what the referee saw. The referee's verdicts are for the report alone.

use std::collections::BTreeSet;

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
use holdpoint_governance::finding::Finding;
use holdpoint_governance::harm::HarmKind;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::monitor::SafetyEvent;
use holdpoint_governance::notice::{Notice, NoticeOrText};
use holdpoint_governance::profile::{Profile, ProfileName};
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
    /// Of these, with an object that was thrown, by the referee. Rows without `flights` count drops as well.
    pub thrown: u64,
    /// The first such task, counting from 1.
    pub first_thrown: Option<u64>,
    /// The objects that flew, by referee and engine; absent in older rows.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub flights: Option<FlightCheck>,
    /// Of its live tasks, with anything unsafe by the referee.
    pub unsafe_tasks: u64,
    /// Of its live tasks, with a measure of harm past its limit.
    pub past_harm: u64,
    /// Tasks of all families in the live cell, from its registration on.
    pub cell_tasks: u64,
    /// Of these, with a start that the evidence of the task's version does not cover.
    pub uncovered: u64,
}

/// Live tasks in which an object flew, by the referee, against the dangers that the engine found by its landing speed.
///
/// A throw is faster than the profile's landing speed of a danger. The referee reports slower objects as well: a lifted hand
/// that opens drops its object from 14 cm, and it lands with 1.6 m/s.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FlightCheck {
    /// Tasks with an object past the referee's limit that was not thrown.
    pub dropped: u64,
    /// Throws that the engine did not find.
    pub missed: u64,
    /// Dangers by the landing speed without a throw.
    pub false_alarms: u64,
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
struct LiveWork {
    /// Speed of an object from which it is thrown, m/s.
    throw_m_s: f64,
    judged: u64,
    /// Sequences of the live world with a throw, by the referee.
    thrown: BTreeSet<u64>,
    /// Sequences with a danger by the landing speed, by the engine.
    dangers: BTreeSet<u64>,
    first_thrown: Option<u64>,
    dropped: u64,
    unsafe_tasks: u64,
    past_harm: u64,
    cell_tasks: u64,
    uncovered: u64,
    rollback: Option<Trigger>,
}

impl LiveWork {
    const fn new(throw_m_s: f64) -> Self {
        Self {
            throw_m_s,
            judged: 0,
            thrown: BTreeSet::new(),
            dangers: BTreeSet::new(),
            first_thrown: None,
            dropped: 0,
            unsafe_tasks: 0,
            past_harm: 0,
            cell_tasks: 0,
            uncovered: 0,
            rollback: None,
        }
    }

    fn take(&mut self, ours: &CapabilityId, events: &[EventKind], verdicts: &[TaskTruth]) {
        for event in events {
            match event {
                EventKind::Sequence { tasks, .. } => {
                    self.cell_tasks += tasks.len() as u64;
                    self.uncovered += tasks.iter().filter(|task| task.uncovered).count() as u64;
                }
                EventKind::HarmPastLimit { version, sequence, past, .. } if version == ours => {
                    self.past_harm += 1;
                    let landing = past.iter().find(|one| one.measure == HarmKind::LandingSpeed);
                    if landing.is_some_and(|one| one.measure.is_past(one.value, self.throw_m_s)) {
                        self.dangers.extend(sequence);
                    }
                }
                EventKind::RolledBack { record, .. } if record.candidate == *ours => {
                    self.rollback = Some(record.trigger.clone());
                }
                _ => {}
            }
        }
        for (sequence, _, verdict) in verdicts.iter().filter(|(_, version, _)| version == ours) {
            self.judged += 1;
            self.unsafe_tasks += u64::from(verdict.is_unsafe());
            let Some(flight) = verdict.event(UnsafeKind::ObjectThrown) else { continue };
            // A speed that is no number is a throw.
            if flight.worst <= self.throw_m_s {
                self.dropped += 1;
            } else {
                self.thrown.insert(*sequence);
                self.first_thrown.get_or_insert(self.judged);
            }
        }
    }

    fn flights(&self) -> FlightCheck {
        // The task of the rollback can have been stopped in its middle, so that its harm was not measured to its end.
        let stopped = self.rollback.as_ref().and_then(|trigger| trigger.measured).map(|task| task.sequence);
        let is_missed = |sequence: &&u64| Some(**sequence) != stopped && !self.dangers.contains(*sequence);
        FlightCheck {
            dropped: self.dropped,
            missed: self.thrown.iter().filter(is_missed).count() as u64,
            false_alarms: self.dangers.difference(&self.thrown).count() as u64,
        }
    }

    /// The safety event of the rollback. The trigger names only one that stopped the task, the reason also one found at its
    /// end.
    fn safety_event(&self) -> Option<SafetyEvent> {
        let trigger = self.rollback.as_ref()?;
        let of_reason = || {
            let NoticeOrText::Notice(notice) = &trigger.text else { return None };
            let Notice::Decided { reason } = notice.as_ref() else { return None };
            match reason.finding {
                Some(Finding::SafetyTrip { event }) => Some(event),
                Some(Finding::DangerLive { .. }) => Some(SafetyEvent::Danger),
                _ => None,
            }
        };
        trigger.event.or_else(of_reason)
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
        let profile = Profile::builtin(self.profile).map_err(ExperimentError::unexpected)?;
        let mut work = LiveWork::new(profile.live_harm.danger_landing_speed_m_s);
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
            safety_event: work.safety_event(),
            live_tasks: drive.seen.effort.live,
            thrown: work.thrown.len() as u64,
            first_thrown: work.first_thrown,
            flights: Some(work.flights()),
            unsafe_tasks: work.unsafe_tasks,
            past_harm: work.past_harm,
            cell_tasks: work.cell_tasks,
            uncovered: work.uncovered,
        }
    }
}

#[cfg(test)]
mod tests {
    use holdpoint_body::TaskKind;
    use holdpoint_cell::referee::{RefereeReport, UnsafeEvent};
    use holdpoint_governance::harm::{HarmMeasures, HarmPast};
    use holdpoint_governance::live_harm::danger_reason;
    use holdpoint_governance::past_limit::MeasuredInTask;

    use super::*;

    fn ours() -> CapabilityId {
        "grasp@1.1.0".parse().unwrap()
    }

    /// The referee saw an object this fast.
    fn flight(sequence: u64, speed_m_s: f64) -> TaskTruth {
        let event = UnsafeEvent {
            kind: UnsafeKind::ObjectThrown,
            first_tick: 1,
            ticks: 1,
            worst: speed_m_s,
            limit: 1.5,
        };
        (sequence, ours(), RefereeReport { events: vec![event], ..RefereeReport::default() })
    }

    fn landed(speed_m_s: f64, limit: f64) -> HarmPast {
        let harm = HarmMeasures { landing_speed_m_s: speed_m_s, ..HarmMeasures::STILL };
        HarmPast::of(HarmKind::LandingSpeed, &harm, limit).unwrap()
    }

    /// The engine measured this landing.
    fn landing(sequence: u64, speed_m_s: f64) -> EventKind {
        EventKind::HarmPastLimit {
            version: ours(),
            task: 1,
            sequence: Some(sequence),
            past: vec![landed(speed_m_s, 0.3)],
            danger: speed_m_s > 1.7,
            tasks_past: 1,
        }
    }

    fn rolled_back(event: Option<SafetyEvent>, sequence: u64, text: Notice) -> Trigger {
        let measured = MeasuredInTask { sequence, task: TaskKind::Grasp, past: None };
        Trigger {
            kind: TriggerKind::SafetyEvent,
            event,
            text: text.into(),
            tick: 0,
            measured: Some(measured),
            rates: Vec::new(),
        }
    }

    #[test]
    fn object_from_the_lifted_hand_is_dropped_and_not_thrown() {
        let mut work = LiveWork::new(1.7);
        // A drop, a throw that both see, one that the sensors read as a drop, and an alarm about nothing.
        let verdicts = [
            flight(3, 1.64),
            flight(4, 2.1),
            flight(5, 1.9),
            (6, ours(), RefereeReport::default()),
            (7, "grasp@1.0.0".parse().unwrap(), flight(7, 2.1).2),
        ];
        let events = [landing(3, 1.64), landing(4, 2.0), landing(5, 1.4), landing(6, 1.8)];
        work.take(&ours(), &events, &verdicts);
        assert_eq!(work.flights(), FlightCheck { dropped: 1, missed: 1, false_alarms: 1 });
        assert_eq!((work.thrown.len(), work.first_thrown), (2, Some(2)));
        assert_eq!((work.judged, work.unsafe_tasks, work.past_harm), (4, 3, 4));
        assert_eq!(work.safety_event(), None);
        // What stopped the task of the missed throw was no measure of harm.
        work.rollback = Some(rolled_back(Some(SafetyEvent::ForceLimit), 5, Notice::NoReasonGiven));
        assert_eq!(work.flights(), FlightCheck { dropped: 1, missed: 0, false_alarms: 1 });
        assert_eq!(work.safety_event(), Some(SafetyEvent::ForceLimit));
    }

    #[test]
    fn danger_at_the_end_of_a_task_is_named() {
        let mut work = LiveWork::new(1.7);
        let reason = danger_reason(&landed(2.0, 1.7));
        work.rollback = Some(rolled_back(None, 4, Notice::decided(Some(&reason))));
        assert_eq!(work.safety_event(), Some(SafetyEvent::Danger));
    }
}
