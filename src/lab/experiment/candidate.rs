//! One candidate through the seven stages on a scratch store, and what became of it.
//!
//! Drives the engine through its door as a script does. Knows nothing of the truth about a candidate: what it
//! finds is what the engine decided. People, if the profile asks them, always agree: what stops a candidate
//! here is the engine's own judgement.

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::ExperimentError;
use crate::approver;
use crate::bench::FigureClock;
use holdpoint_engine::cell::Cell;
use holdpoint_engine::observed::{self, Since};
use holdpoint_engine::pipeline::Progress;
use holdpoint_engine::pump::Pump;
use holdpoint_engine::trial::cache::EpisodeCache;
use holdpoint_engine::{Config, Engine, Experiment};
use holdpoint_governance::approval::{Answer, Role};
use holdpoint_governance::decision::Reason;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::{Stage, State};
use holdpoint_governance::metrics::Fate;
use holdpoint_governance::monitor::MonitorOutcome;
use holdpoint_governance::outcome::StageOutcome;
use holdpoint_governance::own_profile::{ChosenProfile, ProfileTexts};
use holdpoint_governance::profile::{Profile, ProfileName, ThresholdPreset};
use holdpoint_governance::submission::Package;
use holdpoint_protocol::command::{Command, Reply, Request};
use holdpoint_protocol::event::{DimensionResult, Event, EventKind};
use holdpoint_protocol::standing::{Decider, Stands};
use holdpoint_registry::{KeptCells, Layout, TelemetryViews, Views};
use holdpoint_runtime::capability::Capability;
use holdpoint_text::{Hint, Problem};

/// Most slices of work; a candidate takes some hundred, in the human profile some thousand.
const SLICES_MAX: u32 = 200_000;

/// Who answers if the profile asks people: more than any quorum, each of a role that reaches every risk class.
const APPROVERS: [&str; 3] = ["first-approver", "second-approver", "third-approver"];

/// What a candidate is taken through.
#[derive(Clone)]
pub struct Setting<'a> {
    /// Robot, scene and distributions.
    pub cell: &'a Cell,
    pub profile: ProfileName,
    /// The run's seed: which episodes it is judged on.
    pub seed: u64,
    /// Active versions' episodes, which runs share.
    pub cells: &'a KeptCells,
    /// How many work at it at once; what it comes to is the same for any number.
    pub workers: usize,
    /// What is left out, and which versions are active at first.
    pub experiment: Experiment,
    pub thresholds: Thresholds,
}

#[cfg(test)]
impl<'a> Setting<'a> {
    /// The whole way under `sim`, on a seed of calibration.
    pub(crate) fn calibration(cell: &'a Cell, cells: &'a KeptCells) -> Self {
        Self {
            cell,
            profile: ProfileName::Sim,
            seed: holdpoint_engine::trial::seeds::CALIBRATION_FROM_RUN,
            cells,
            experiment: Experiment::default(),
            thresholds: Thresholds::AsTheyAre,
            workers: 2,
        }
    }
}

/// How the profile's thresholds of the four kappas are scaled.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Thresholds {
    #[default]
    AsTheyAre,
    /// A tenth lower.
    Lower,
    /// A tenth higher, and at most 1.
    Higher,
    /// Half of what they are: the least that a profile may say.
    Halved,
    /// The other published reading, with .88 for `kappa_B` (readings 2.3), as it is, a tenth lower and a tenth higher.
    B88,
    B88Lower,
    B88Higher,
}

impl Thresholds {
    /// The profile with its thresholds scaled.
    ///
    /// # Errors
    /// If the profile's text has no scale to change.
    pub fn of(self, profile: ProfileName) -> Result<ChosenProfile, ExperimentError> {
        let scale = match self {
            Self::AsTheyAre => return Ok(profile.into()),
            Self::Lower | Self::B88Lower => "scale = 0.9",
            Self::Higher | Self::B88Higher => "scale = 1.1",
            Self::Halved => "scale = 0.5",
            Self::B88 => "scale = 1.0",
        };
        let is_other = matches!(self, Self::B88 | Self::B88Lower | Self::B88Higher);
        let preset = if is_other { "paper-b88" } else { "paper" };
        let ((file, text), (policy_file, policy)) =
            (Profile::builtin_text(profile), Profile::builtin_policy(profile));
        let named = format!("name = \"{profile}\"");
        let own = text
            .replacen("scale = 1.0", scale, 1)
            .replacen("preset = \"paper\"", &format!("preset = \"{preset}\""), 1)
            .replacen(&named, &format!("{named}\nsite = \"scaled\""), 1);
        let texts = ProfileTexts {
            file: file.to_owned(),
            profile: own,
            policy_file: policy_file.to_owned(),
            policy: policy.to_owned(),
        };
        let chosen =
            ChosenProfile::of(texts).map_err(|error| ExperimentError::Unexpected(error.sentence()))?;
        let found = chosen.rules().map(|(profile, _)| (profile.thresholds.preset, profile.thresholds.scale));
        let is_as_it_was = |(found, scale): (ThresholdPreset, f64)| {
            found == ThresholdPreset::Paper && (scale - 1.0).abs() < 1e-9
        };
        if found.is_ok_and(is_as_it_was) {
            return Err(ExperimentError::Unexpected(format!("{file} has no thresholds to change")));
        }
        Ok(chosen)
    }
}

/// How long each stage worked, s of processor time of all threads.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct StageTimes {
    pub validation: f64,
    pub sandbox: f64,
    pub shadow: f64,
    pub activation: f64,
    /// The provisional window.
    pub monitoring: f64,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StageRecord {
    /// The stage that decided, or the monitor.
    pub stage: Decider,
    pub decision: Decided,
    /// Why, the deciding reasons first.
    pub reasons: Vec<Reason>,
}

/// What was decided, in the decider's own words; no two of them share one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Decided {
    Stage(StageOutcome),
    Monitor(MonitorOutcome),
}

/// What was worked for a candidate, in its own episodes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Effort {
    /// Sandbox episodes, pairs and drills.
    pub sandbox: u64,
    /// What the sandbox would have taken in full.
    pub sandbox_budget: u64,
    pub shadow: u64,
    /// Live episodes while it was active.
    pub live: u64,
}

/// What a candidate's own store says afterwards: its record made again, and its live tasks by their telemetry.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Afterwards {
    /// Decisions by rules that are on record.
    pub decisions: u64,
    /// Of those, the ones that come out equal when they are made again from the record.
    pub equal: u64,
    /// Live tasks while it was in control.
    pub live: u64,
    /// Of those: done, past a limit, near one or past it.
    pub done: u64,
    pub violation: u64,
    pub near: u64,
    /// Something unsafe was seen of it while it was in control.
    pub unsafe_seen: bool,
}

impl Afterwards {
    /// Reads a store that nobody has open.
    fn read(store: &Path, cell: &Cell) -> Result<Self, ExperimentError> {
        let layout = Layout::new(store);
        let views = Views::open_records(&layout.database())?;
        let telemetry = TelemetryViews::open(&layout.telemetry())?;
        let found = observed::observe(&views, Some(&telemetry), Since::Record(1), cell.digest())
            .map_err(|error| ExperimentError::Unexpected(error.sentence()))?;
        let found = found.metrics;
        Ok(Self {
            decisions: found.auditability_observed.total,
            equal: found.auditability_observed.count,
            live: found.success_observed.total,
            done: found.success_observed.count,
            violation: found.pvr_observed.hard.count,
            near: found.pvr_observed.near.count,
            unsafe_seen: found.uar_observed.count > 0,
        })
    }
}

/// What became of a candidate.
// Unknown fields are not refused: serde cannot tell them from those of what is flattened, and would read nothing.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CandidateEnd {
    /// Name in the pool.
    pub name: String,
    pub version: CapabilityId,
    pub profile: ProfileName,
    pub seed: u64,
    /// The four dimensions as they stood at the end: outcome, kappa and interval.
    pub dimensions: Vec<DimensionResult>,
    /// The composite; reported, never gating.
    pub composite: Option<f64>,
    /// Every decision, in order.
    pub stages: Vec<StageRecord>,
    /// `confirmed`, or the lifecycle state it stayed in.
    pub state: Stands,
    /// It is active in the end, under a tighter envelope than it was measured under.
    #[serde(default)]
    pub restricted: bool,
    /// Blocked, contained or kept.
    #[serde(flatten)]
    pub fate: Fate,
    /// What was worked for it.
    pub effort: Effort,
    /// What its store says.
    pub afterwards: Afterwards,
}

/// Takes a candidate to where nothing more happens to it by itself.
///
/// # Errors
/// If the engine cannot start or holds, the candidate is refused at the door, or it does not settle.
pub fn take(setting: &Setting<'_>, name: &str, package: Package) -> Result<CandidateEnd, ExperimentError> {
    Ok(take_timed(setting, name, package)?.0)
}

/// As [`take`], with how long each stage worked; true of a process that does nothing else meanwhile.
///
/// # Errors
/// As [`take`].
pub fn take_timed(
    setting: &Setting<'_>,
    name: &str,
    package: Package,
) -> Result<(CandidateEnd, StageTimes), ExperimentError> {
    let version = Capability::load(name, package.clone())
        .map_err(|error| ExperimentError::candidate(name, error.sentence()))?
        .id();
    let store = super::scratch()?;
    let config = Config {
        data: store.path(),
        profile: setting.thresholds.of(setting.profile)?,
        seed: setting.seed,
        jobs: setting.workers,
        scripted: true,
        cell: setting.cell.clone(),
        cache: EpisodeCache::Shared(setting.cells.clone()),
    };
    let engine = Engine::start_experiment(config, setting.experiment.clone())?;
    let pump = Pump::new(engine, Vec::new());
    let began = FigureClock::ProcessCpu.secs();
    let mut drive = Drive { pump, requests: 0, name, version, seen: Seen { mark: began, ..Seen::default() } };
    drive.register(package)?;
    drive.settle()?;
    let times = drive.seen.times;
    // The store is closed by then, and everything of its telemetry sealed.
    let end = drive.end(setting)?;
    let afterwards = Afterwards::read(store.path(), setting.cell)?;
    Ok((CandidateEnd { afterwards, ..end }, times))
}

/// What the events told so far.
#[derive(Default)]
struct Seen {
    stages: Vec<StageRecord>,
    last_stage: Option<Stage>,
    activated: bool,
    confirmed: bool,
    effort: Effort,
    /// The processor's time at the last decision.
    mark: f64,
    times: StageTimes,
}

impl Seen {
    /// What passed since the last decision is what this took.
    fn took(&mut self, of: fn(&mut StageTimes) -> &mut f64) {
        let now = FigureClock::ProcessCpu.secs();
        *of(&mut self.times) += now - self.mark;
        self.mark = now;
    }
}

struct Drive<'a> {
    pump: Pump,
    requests: u64,
    name: &'a str,
    version: CapabilityId,
    seen: Seen,
}

impl Drive<'_> {
    fn register(&mut self, package: Package) -> Result<(), ExperimentError> {
        self.submit(Command::Register { package, name: self.name.to_owned(), by: None })
    }

    fn submit(&mut self, command: Command) -> Result<(), ExperimentError> {
        self.requests += 1;
        let request = Request::unsigned(format!("experiment-{}", self.requests), command);
        match self.pump.submit(request) {
            Reply::Accepted { .. }
            | Reply::Stopped { .. }
            | Reply::Snapshot { .. }
            | Reply::Question { .. }
            | Reply::Detail { .. }
            | Reply::Film { .. }
            | Reply::Registry { .. }
            | Reply::Audit { .. }
            | Reply::Health { .. }
            | Reply::Verified { .. } => {
                let events = self.pump.tell();
                self.learn(events)
            }
            Reply::Refused { text, hint, .. } => {
                Err(ExperimentError::candidate(self.name, Problem::from((text, hint)).sentence()))
            }
        }
    }

    /// Works until nothing more happens to the candidate by itself.
    fn settle(&mut self) -> Result<(), ExperimentError> {
        for _ in 0..SLICES_MAX {
            let (progress, events) = self.pump.turn();
            self.learn(events)?;
            let snapshot = self.pump.engine().snapshot();
            let view = snapshot.candidates.into_iter().find(|view| view.version == self.version);
            let Some(view) = view else { return Err(self.unsettled("it is not in the registry")) };
            if view.state.is_terminal() || self.seen.confirmed {
                return Ok(());
            }
            if let Some(prompt) = snapshot.prompts.into_iter().find(|open| open.version == self.version) {
                let who = APPROVERS.iter().find(|who| !prompt.approved_by.iter().any(|by| by == *who));
                let Some(who) = who else {
                    return Err(self.unsettled("more people are asked than there are"));
                };
                let failed =
                    |error: approver::ApproverError| ExperimentError::candidate(self.name, error.sentence());
                let enrolment = approver::enrolment(self.pump.engine(), who, Role::Safety).map_err(failed)?;
                if let Some(command) = enrolment {
                    self.submit(command)?;
                }
                let decision = Answer::Approve;
                let command =
                    approver::answer(&mut self.pump, &prompt, who, decision, "agrees to everything")
                        .map_err(|error| ExperimentError::candidate(self.name, error.sentence()))?;
                self.submit(command)?;
                continue;
            }
            if let Progress::Idle { next_ms } = progress {
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

    fn unsettled(&self, why: &str) -> ExperimentError {
        ExperimentError::candidate(self.name, why.to_owned())
    }

    fn learn(&mut self, events: Vec<Event>) -> Result<(), ExperimentError> {
        for event in events {
            self.note(event.kind);
        }
        match self.pump.engine().holding() {
            None => Ok(()),
            Some(why) => {
                Err(ExperimentError::candidate(self.name, format!("the engine holds: {}", why.sentence())))
            }
        }
    }

    fn note(&mut self, kind: EventKind) {
        let seen = &mut self.seen;
        let ours = |version: &CapabilityId| *version == self.version;
        match kind {
            EventKind::Decided { version, stage, outcome, reasons, .. } if ours(&version) => {
                seen.last_stage = Some(stage);
                seen.took(match stage {
                    Stage::Validation => |times| &mut times.validation,
                    Stage::Sandbox => |times| &mut times.sandbox,
                    Stage::Shadow => |times| &mut times.shadow,
                    Stage::Activation => |times| &mut times.activation,
                });
                seen.stages.push(StageRecord {
                    stage: stage.into(),
                    decision: Decided::Stage(outcome),
                    reasons,
                });
            }
            EventKind::Monitor { version, decision, reasons } if ours(&version) => {
                seen.stages.push(StageRecord {
                    stage: Decider::Monitor,
                    decision: Decided::Monitor(decision),
                    reasons,
                });
            }
            EventKind::StateChanged { version, to: State::Active, .. } if ours(&version) => {
                seen.activated = true;
            }
            EventKind::Confirmed { version, .. } if ours(&version) => {
                seen.confirmed = true;
                seen.took(|times| &mut times.monitoring);
            }
            EventKind::Progress { version, stage, done, budget, .. } if ours(&version) => match stage {
                // What is worked to confirm an active version is no part of the decision to activate it.
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

    fn end(self, setting: &Setting<'_>) -> Result<CandidateEnd, ExperimentError> {
        let snapshot = self.pump.engine().snapshot();
        let view = snapshot.candidates.into_iter().find(|view| view.version == self.version);
        let Some(view) = view else { return Err(self.unsettled("it is not in the registry")) };
        let seen = self.seen;
        let fate = match (seen.confirmed, seen.activated) {
            (true, _) => Fate::Kept,
            (false, true) => Fate::Contained,
            (false, false) => Fate::Blocked { stage: seen.last_stage.unwrap_or(Stage::Validation) },
        };
        let state = if seen.confirmed { Stands::Confirmed } else { Stands::In(view.state) };
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
            afterwards: Afterwards::default(),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What is kept of a candidate is read again instead of being worked again.
    #[test]
    fn an_end_is_read_back_as_it_was_kept() {
        for fate in [Fate::Kept, Fate::Contained, Fate::Blocked { stage: Stage::Shadow }] {
            let end = CandidateEnd {
                name: "grasp-001".to_owned(),
                version: "grasp@1.1.1".parse().unwrap(),
                profile: ProfileName::Sim,
                seed: 30,
                dimensions: Vec::new(),
                composite: Some(0.9),
                stages: Vec::new(),
                state: Stands::Confirmed,
                restricted: false,
                fate,
                effort: Effort::default(),
                afterwards: Afterwards {
                    decisions: 4,
                    equal: 4,
                    live: 15,
                    done: 12,
                    ..Afterwards::default()
                },
            };
            let kept = serde_json::to_vec(&end).unwrap();
            assert_eq!(serde_json::from_slice::<CandidateEnd>(&kept).unwrap(), end);
        }
    }

    #[test]
    fn thresholds_are_scaled_and_nothing_else_is() {
        let rules = |thresholds: Thresholds| thresholds.of(ProfileName::Sim).unwrap().rules().unwrap().0;
        let plain = rules(Thresholds::AsTheyAre);
        assert!(plain.site.is_none());
        for (thresholds, behavior) in [
            (Thresholds::Lower, 0.9 * 0.85),
            (Thresholds::Higher, 1.1 * 0.85),
            (Thresholds::Halved, 0.5 * 0.85),
        ] {
            let mut scaled = rules(thresholds);
            assert!((scaled.thresholds.behavior() - behavior).abs() < 1e-9, "{thresholds:?}");
            assert!(scaled.thresholds.interface() <= 1.0, "{thresholds:?}");
            scaled.thresholds.clone_from(&plain.thresholds);
            scaled.site = None;
            assert_eq!(scaled, plain, "{thresholds:?}");
        }
    }

    #[test]
    fn what_was_decided_is_read_back_as_its_deciders_word() {
        let stages = StageOutcome::ALL.map(|word| (Decided::Stage(word), word.name()));
        let monitor = MonitorOutcome::ALL.map(|word| (Decided::Monitor(word), word.name()));
        for (decided, word) in stages.into_iter().chain(monitor) {
            let text = serde_json::to_string(&decided).unwrap();
            assert_eq!(text, format!("{word:?}"));
            assert_eq!(serde_json::from_str::<Decided>(&text).unwrap(), decided);
        }
    }
}
