//! Drives an engine with one candidate, slice by slice, and with others after it; approvers always agree.

use std::path::Path;

use holdpoint::bench::FigureClock;
use holdpoint::headless::scripted_approver;
use holdpoint_engine::decide::pipeline::SliceOutcome;
use holdpoint_engine::{Config, Engine};
use holdpoint_governance::approval::{ApprovalDecision, Role};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{Stage, State};
use holdpoint_governance::metrics::Fate;
use holdpoint_governance::submission::Package;
use holdpoint_protocol::command::{Command, Reply, Request};
use holdpoint_protocol::event::{Event, EventKind};
use holdpoint_protocol::scenario_state::{Decider, ScenarioState};
use holdpoint_protocol::snapshot::{ApprovalRequestView, CandidateView};
use holdpoint_runtime::capability::Capability;
use holdpoint_service::pump::Pump;
use holdpoint_text::{Hint, Problem};
use holdpoint_trials::cache::EpisodeCache;
use holdpoint_trials::seeds::EpisodeSeeds;

use super::{
    CandidateEnd, CandidateSetting, DecisionOutcome, EpisodeEffort, PostRunCheck, StageRecord, StageTimes,
};
use crate::pipeline_experiments::ExperimentError;
use crate::wording::packages;

/// Most slices of work; a candidate takes some hundred, in the human profile some thousand.
const SLICES_MAX: u32 = 200_000;

/// The approvers if the profile asks them: more than any quorum, each of a role that reaches every risk class.
const APPROVERS: [&str; 3] = ["first-approver", "second-approver", "third-approver"];

/// The data of the events so far.
#[derive(Default)]
pub(crate) struct EventSummary {
    pub(crate) stages: Vec<StageRecord>,
    last_stage: Option<Stage>,
    pub(crate) activated: bool,
    pub(crate) confirmed: bool,
    pub(crate) effort: EpisodeEffort,
    /// The CPU time at the last decision.
    mark: f64,
    pub(crate) times: StageTimes,
}

impl EventSummary {
    /// Of a candidate that begins now.
    fn beginning() -> Self {
        Self { mark: FigureClock::ProcessCpu.secs(), ..Self::default() }
    }

    pub(crate) fn fate(&self) -> Fate {
        match (self.confirmed, self.activated) {
            (true, _) => Fate::Kept,
            (false, true) => Fate::Contained,
            (false, false) => Fate::Blocked { stage: self.last_stage.unwrap_or(Stage::Validation) },
        }
    }

    /// `confirmed`, or this lifecycle state.
    pub(crate) const fn state(&self, state: State) -> ScenarioState {
        if self.confirmed { ScenarioState::Confirmed } else { ScenarioState::In(state) }
    }

    /// The time since the last decision belongs to this one.
    fn record_stage_time(&mut self, of: fn(&mut StageTimes) -> &mut f64) {
        let now = FigureClock::ProcessCpu.secs();
        *of(&mut self.times) += now - self.mark;
        self.mark = now;
    }
}

/// An engine on a store, and the candidate that it evaluates.
pub(crate) struct CandidateDriver<'a> {
    pub(crate) pump: Pump,
    requests: u64,
    name: &'a str,
    pub(crate) version: CapabilityId,
    pub(crate) seen: EventSummary,
    /// The events of the last request or slice.
    pub(crate) events: Vec<EventKind>,
}

/// A slice of work: its outcome, the candidate after it, and the candidate's open approval request.
pub(crate) struct DrivenSlice {
    pub(crate) progress: SliceOutcome,
    pub(crate) view: CandidateView,
    pub(crate) prompt: Option<ApprovalRequestView>,
}

impl<'a> CandidateDriver<'a> {
    /// Starts an engine on a new store for a candidate.
    ///
    /// # Errors
    /// If the candidate does not load, or the engine cannot start.
    pub(crate) fn start(
        setting: &CandidateSetting<'_>,
        (seeds, cache): (EpisodeSeeds, EpisodeCache),
        store: &Path,
        (name, package): (&'a str, &Package),
    ) -> Result<Self, ExperimentError> {
        let version = Capability::load(name, package.clone())
            .map_err(|error| ExperimentError::candidate(name, error.sentence()))?
            .id();
        let config = Config {
            data: store,
            profile: setting.thresholds.of(setting.profile)?,
            seeds,
            jobs: setting.workers,
            scripted: true,
            cell: setting.cell.clone(),
            cache,
        };
        Ok(Self::new(Engine::start_experiment(config, setting.experiment.clone())?, name, version))
    }

    pub(crate) fn new(engine: Engine, name: &'a str, version: CapabilityId) -> Self {
        let pump = Pump::new(engine, Vec::new());
        Self { pump, requests: 0, name, version, seen: EventSummary::beginning(), events: Vec::new() }
    }

    /// Turns to another candidate, on the same store.
    pub(crate) fn turn_to(&mut self, name: &'a str, version: CapabilityId) {
        (self.name, self.version, self.seen) = (name, version, EventSummary::beginning());
    }

    pub(crate) fn register(&mut self, package: Package) -> Result<(), ExperimentError> {
        self.submit(Command::Register { package, name: self.name.to_owned(), by: None })
    }

    fn submit(&mut self, command: Command) -> Result<(), ExperimentError> {
        self.requests += 1;
        let request = Request::unsigned(format!("experiment-{}", self.requests), command);
        match self.pump.submit(request) {
            Reply::Refused { text, hint, .. } => {
                Err(ExperimentError::candidate(self.name, Problem::from((text, hint)).sentence()))
            }
            _ => {
                let events = self.pump.deliver_events();
                self.learn(events)
            }
        }
    }

    /// Runs until nothing more happens to the candidate by itself.
    pub(crate) fn run_until_settled(&mut self) -> Result<(), ExperimentError> {
        for _ in 0..SLICES_MAX {
            let DrivenSlice { progress, view, prompt } = self.slice()?;
            if view.state.is_terminal() || self.seen.confirmed {
                return Ok(());
            }
            if let Some(prompt) = prompt {
                self.approve(&prompt)?;
                continue;
            }
            if let SliceOutcome::Idle { next_ms } = progress {
                let moved = next_ms.is_some_and(|next_ms| self.pump.jump_to(next_ms));
                if !moved {
                    return if view.flags.provisional {
                        Err(self.unsettled("it stays provisional"))
                    } else {
                        Ok(())
                    };
                }
            }
        }
        Err(self.unsettled("it was not settled within the limit of slices"))
    }

    /// Runs a slice.
    ///
    /// # Errors
    /// If the engine holds, or does not know the candidate.
    pub(crate) fn slice(&mut self) -> Result<DrivenSlice, ExperimentError> {
        let (progress, events) = self.pump.turn();
        self.learn(events)?;
        let snapshot = self.pump.engine().snapshot();
        let view = snapshot.candidates.into_iter().find(|view| view.version == self.version);
        let Some(view) = view else { return Err(self.unsettled("it is not in the registry")) };
        let prompt = snapshot.prompts.into_iter().find(|open| open.version == self.version);
        Ok(DrivenSlice { progress, view, prompt })
    }

    /// The next approver agrees.
    ///
    /// # Errors
    /// If all have approved, or the engine does not take the answer.
    pub(crate) fn approve(&mut self, prompt: &ApprovalRequestView) -> Result<(), ExperimentError> {
        let who = APPROVERS.iter().find(|who| !prompt.approved_by.iter().any(|by| by == *who));
        let Some(who) = who else {
            return Err(self.unsettled("more people are asked than there are"));
        };
        let failed =
            |error: scripted_approver::ApproverError| ExperimentError::candidate(self.name, error.sentence());
        let enrolment =
            scripted_approver::enrolment(self.pump.engine(), who, Role::Safety).map_err(failed)?;
        if let Some(command) = enrolment {
            self.submit(command)?;
        }
        let decision = ApprovalDecision::Approve;
        let command = scripted_approver::answer(&mut self.pump, prompt, who, decision, packages::APPROVAL)
            .map_err(|error| ExperimentError::candidate(self.name, error.sentence()))?;
        self.submit(command)
    }

    pub(crate) fn unsettled(&self, why: &str) -> ExperimentError {
        ExperimentError::candidate(self.name, why.to_owned())
    }

    fn learn(&mut self, events: Vec<Event>) -> Result<(), ExperimentError> {
        self.events = events.into_iter().map(|event| event.kind).collect();
        for kind in self.events.clone() {
            self.note(kind);
        }
        match self.pump.engine().holding() {
            None => Ok(()),
            Some(why) => {
                Err(ExperimentError::candidate(self.name, format!("the engine halted: {}", why.sentence())))
            }
        }
    }

    fn note(&mut self, kind: EventKind) {
        let seen = &mut self.seen;
        let ours = |version: &CapabilityId| *version == self.version;
        match kind {
            EventKind::Decided { version, stage, outcome, reasons, .. } if ours(&version) => {
                seen.last_stage = Some(stage);
                seen.record_stage_time(match stage {
                    Stage::Validation => |times| &mut times.validation,
                    Stage::Sandbox => |times| &mut times.sandbox,
                    Stage::Shadow => |times| &mut times.shadow,
                    Stage::Activation => |times| &mut times.activation,
                });
                seen.stages.push(StageRecord {
                    stage: stage.into(),
                    decision: DecisionOutcome::Stage(outcome),
                    reasons,
                });
            }
            EventKind::Monitor { version, decision, reasons } if ours(&version) => {
                seen.stages.push(StageRecord {
                    stage: Decider::Monitor,
                    decision: DecisionOutcome::Monitor(decision),
                    reasons,
                });
            }
            EventKind::StateChanged { version, to: State::Active, .. } if ours(&version) => {
                seen.activated = true;
            }
            EventKind::Confirmed { version, .. } if ours(&version) => {
                seen.confirmed = true;
                seen.record_stage_time(|times| &mut times.monitoring);
            }
            EventKind::Progress { version, stage, done, budget, .. } if ours(&version) => match stage {
                // Episodes that confirm an active version are no part of the decision to activate it.
                Stage::Sandbox if !seen.activated => {
                    seen.effort.sandbox = done;
                    seen.effort.sandbox_budget = budget;
                }
                Stage::Shadow => seen.effort.shadow = done,
                Stage::Validation | Stage::Sandbox | Stage::Activation => {}
            },
            EventKind::Sequence { tasks, .. } => {
                seen.effort.live += tasks.iter().filter(|task| ours(&task.version)).count() as u64;
            }
            _ => {}
        }
    }

    /// Takes what was seen of the candidate, with its present view.
    pub(crate) fn take_outcome(&mut self) -> Result<(CandidateView, EventSummary), ExperimentError> {
        let snapshot = self.pump.engine().snapshot();
        let view = snapshot.candidates.into_iter().find(|view| view.version == self.version);
        let Some(view) = view else { return Err(self.unsettled("it is not in the registry")) };
        Ok((view, std::mem::take(&mut self.seen)))
    }

    pub(crate) fn end(mut self, setting: &CandidateSetting<'_>) -> Result<CandidateEnd, ExperimentError> {
        let (view, seen) = self.take_outcome()?;
        let (fate, state) = (seen.fate(), seen.state(view.state));
        Ok(CandidateEnd {
            name: self.name.to_owned(),
            version: self.version,
            profile: setting.profile,
            seed: setting.seed,
            dimensions: view.dimensions,
            composite: view.composite,
            stages: seen.stages,
            state,
            restricted: view.state == State::Active && view.flags.restricted,
            fate,
            effort: seen.effort,
            afterwards: PostRunCheck::default(),
        })
    }
}
