//! The arms: the rules that decide whether a candidate replaces the active version, and whether it stays active.
//!
//! The paper's three, three that others use, its ablation, and the whole pipeline with its thresholds moved. A stage
//! that an arm leaves out cannot change its result. A variant therefore re-runs only from that stage on, and the place
//! of the fork is on record ([`Fork`]).

use holdpoint_engine::Experiment;
use holdpoint_governance::ablation::{AblatedParts, AblationPart};
use holdpoint_governance::ids::Digest;
use holdpoint_governance::lifecycle::{Stage, State};
use holdpoint_governance::metrics::Fate;
use holdpoint_governance::monitor::MonitorOutcome;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::stats::{PairedCounts, binary_pairs};
use holdpoint_protocol::scenario_state::ScenarioState;
use holdpoint_runtime::capability::Capability;
use holdpoint_trials::worker::Worker;
use serde::{Deserialize, Serialize};

use super::PaperSetup;
use super::active_families::ActiveFamilies;
use super::candidate_stream::PlantedCandidate;
use super::held_out::{HeldOutSequence, evaluate};
use crate::pipeline_experiments::ExperimentError;
use crate::pipeline_experiments::candidate_run::{CandidateEnd, DecisionOutcome, ThresholdScale};
use crate::pipeline_experiments::per_candidate::{CandidateJob, run_or_reuse};
use holdpoint_text::Hint;

holdpoint_governance::closed_set! {
    /// How upgrades are decided.
    Arm, "arm", {
        /// No upgrade.
        Static = "static",
        /// Every upgrade, at once.
        Naive = "naive",
        /// An upgrade that succeeds more often than the version before in advance trials.
        SuccessGate = "success-gate",
        /// Every upgrade, taken back if the first live sequences show more errors or more latency.
        Canary = "canary",
        /// Validation and sandbox once, and nothing later: no shadow, no monitor, no rollback.
        OfflineOnly = "offline-only",
        /// Validation alone.
        CompatOnly = "compat-only",
        /// All stages but the sandbox.
        NoSandbox = "no-sandbox",
        /// All stages but shadow.
        NoShadow = "no-shadow",
        /// All stages, without `kappa_R`.
        NoRecovery = "no-recovery-compat",
        /// All stages before activation, and no monitor.
        NoMonitor = "no-online-monitoring",
        /// All stages; the monitor may restrict, and nothing is rolled back.
        NoRollback = "no-rollback",
        /// All seven stages.
        Governed = "governed",
        /// All seven stages, with the thresholds of the four kappas a tenth lower.
        Relaxed = "thresholds-90",
        /// All seven stages, with the thresholds a tenth higher, and at most 1.
        Strict = "thresholds-110",
    }
}

holdpoint_governance::closed_set! {
    /// From which stage on an arm ran a candidate for itself alone.
    Fork, "parting", {
        /// It needs no run: the arm decides without looking.
        NoWork = "no-work",
        /// By its own rules, from the start.
        Own = "own",
        /// Nowhere: the whole pipeline's run is this arm's.
        Whole = "whole-pipeline",
        /// After validation.
        Validation = "after-validation",
        /// After the sandbox.
        Sandbox = "after-sandbox",
        /// After activation.
        Activation = "after-activation",
        /// Where the monitor requested a rollback.
        Rollback = "at-rollback",
    }
}

/// Sequences that a canary is looked at in, and trials of the success gate.
const OWN_SEQUENCES: u64 = 50;

/// Rounds of held-out episodes that arms with rules of their own look at: above those of any evaluation.
const OWN_ROUND: u32 = 100;

/// One-sided level at which a canary shows more errors.
const CANARY_ALPHA: f64 = 0.05;

/// How much longer the tasks of a canary may take, as a factor of the version before.
const CANARY_LATENCY_MAX: f64 = 1.2;

/// The result of an arm for a candidate.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ArmAction {
    /// It was active at some time.
    pub activated: bool,
    /// It is active at the end of the round.
    pub in_force: bool,
    /// It is restricted to a tighter envelope.
    pub restricted: bool,
    /// The stage that stopped it, of arms that have stages.
    pub stopped_at: Option<Stage>,
    pub fork: Fork,
    /// Episodes run for the decision.
    pub episodes: u64,
}

impl ArmAction {
    const fn refused(fork: Fork) -> Self {
        Self { activated: false, in_force: false, restricted: false, stopped_at: None, fork, episodes: 0 }
    }

    const fn installed(fork: Fork) -> Self {
        Self { activated: true, in_force: true, restricted: false, stopped_at: None, fork, episodes: 0 }
    }
}

/// The round and the active versions that a candidate meets.
pub struct ArmContext<'a> {
    pub setup: &'a PaperSetup,
    pub upgrade: &'a PlantedCandidate,
    pub version: &'a Capability,
    pub before: &'a ActiveFamilies,
    pub seed: u64,
    pub round: u32,
    /// Workers for one decision.
    pub workers: usize,
}

impl ArmContext<'_> {
    /// The candidate through the engine's stages with parts left out.
    ///
    /// # Errors
    /// If it does not come to an end.
    fn end(&self, parts: &[AblationPart]) -> Result<CandidateEnd, ExperimentError> {
        self.end_by(parts, ThresholdScale::AsTheyAre)
    }

    /// The same, with the thresholds scaled.
    fn end_by(
        &self,
        parts: &[AblationPart],
        thresholds: ThresholdScale,
    ) -> Result<CandidateEnd, ExperimentError> {
        let first = self.before.versions();
        let job = CandidateJob {
            name: &self.upgrade.name,
            package: &self.upgrade.package,
            profile: ProfileName::Sim,
            seed: self.seed,
            experiment: Experiment { omitted: AblatedParts::of(parts), first },
            thresholds,
            workers: self.workers,
        };
        run_or_reuse(&self.setup.cell, &self.setup.cache, &job)
    }

    /// The same sequences by the active versions and with the candidate among them.
    fn own_pairs(
        &self,
        worker: &mut Worker,
    ) -> Result<Vec<(HeldOutSequence, HeldOutSequence)>, ExperimentError> {
        let round = OWN_ROUND + self.round;
        let with = self.before.with(self.version.clone(), false);
        let old = evaluate(self.setup, worker, self.before, self.seed, round, OWN_SEQUENCES)?;
        let new = evaluate(self.setup, worker, &with, self.seed, round, OWN_SEQUENCES)?;
        Ok(new.into_iter().zip(old).filter_map(|(new, old)| Some((new?, old?))).collect())
    }
}

impl Arm {
    /// The arms with different stages; the two others are the whole pipeline with its thresholds moved.
    #[must_use]
    pub fn of_the_ablation() -> Vec<Self> {
        Self::ALL.into_iter().filter(|arm| !matches!(arm, Self::Relaxed | Self::Strict)).collect()
    }

    /// Decides about the candidate as the arm does.
    ///
    /// # Errors
    /// If the candidate does not come to an end, or a result cannot be cached.
    pub fn decide(self, context: &ArmContext<'_>, worker: &mut Worker) -> Result<ArmAction, ExperimentError> {
        match self {
            Self::Static => Ok(ArmAction::refused(Fork::NoWork)),
            Self::Naive => Ok(ArmAction::installed(Fork::NoWork)),
            Self::SuccessGate => {
                let pairs = context.own_pairs(worker)?;
                let done = |of: fn(&(HeldOutSequence, HeldOutSequence)) -> bool| {
                    pairs.iter().filter(|pair| of(pair)).count()
                };
                let better = done(|(new, _)| new.done) > done(|(_, old)| old.done);
                let step =
                    if better { ArmAction::installed(Fork::Own) } else { ArmAction::refused(Fork::Own) };
                Ok(ArmAction { episodes: 3 * pairs.len() as u64, ..step })
            }
            Self::Canary => {
                let pairs = context.own_pairs(worker)?;
                let errors = PairedCounts::of(pairs.iter().map(|(new, old)| (!new.done, !old.done)));
                let more_errors = binary_pairs(errors, CANARY_ALPHA)?.lower > 0.0;
                let mean =
                    |of: fn(&(HeldOutSequence, HeldOutSequence)) -> f64| pairs.iter().map(of).sum::<f64>();
                let (new, old) = (mean(|(new, _)| new.time_s), mean(|(_, old)| old.time_s));
                let late = new > CANARY_LATENCY_MAX * old;
                let step = ArmAction { episodes: 3 * pairs.len() as u64, ..ArmAction::installed(Fork::Own) };
                Ok(if more_errors || late { ArmAction { in_force: false, ..step } } else { step })
            }
            Self::Governed => Ok(step_of(&context.end(&[])?, Fork::Whole)),
            Self::Relaxed => Ok(step_of(&context.end_by(&[], ThresholdScale::Lower)?, Fork::Own)),
            Self::Strict => Ok(step_of(&context.end_by(&[], ThresholdScale::Higher)?, Fork::Own)),
            Self::CompatOnly => {
                let whole = context.end(&[])?;
                Ok(if blocked_at(&whole, Stage::Validation) {
                    step_of(&whole, Fork::Whole)
                } else {
                    ArmAction::installed(Fork::Validation)
                })
            }
            Self::NoMonitor => {
                let whole = context.end(&[])?;
                Ok(if is_activated(&whole) {
                    ArmAction {
                        episodes: before_activation(&whole),
                        ..ArmAction::installed(Fork::Activation)
                    }
                } else {
                    step_of(&whole, Fork::Whole)
                })
            }
            Self::NoRollback => {
                let whole = context.end(&[])?;
                let step = step_of(&whole, Fork::Whole);
                Ok(if step.activated && !step.in_force {
                    let restricted = whole
                        .stages
                        .iter()
                        .any(|stage| stage.decision == DecisionOutcome::Monitor(MonitorOutcome::Restrict));
                    ArmAction { in_force: true, restricted, fork: Fork::Rollback, ..step }
                } else {
                    step
                })
            }
            Self::NoSandbox => {
                let whole = context.end(&[])?;
                if blocked_at(&whole, Stage::Validation) {
                    return Ok(step_of(&whole, Fork::Whole));
                }
                Ok(step_of(&context.end(&[AblationPart::Sandbox])?, Fork::Validation))
            }
            Self::NoRecovery => {
                let whole = context.end(&[])?;
                if blocked_at(&whole, Stage::Validation) {
                    return Ok(step_of(&whole, Fork::Whole));
                }
                Ok(step_of(&context.end(&[AblationPart::Recovery])?, Fork::Validation))
            }
            Self::NoShadow | Self::OfflineOnly => {
                let whole = context.end(&[])?;
                if blocked_at(&whole, Stage::Validation) || blocked_at(&whole, Stage::Sandbox) {
                    return Ok(step_of(&whole, Fork::Whole));
                }
                let end = context.end(&[AblationPart::Shadow])?;
                if self == Self::OfflineOnly && is_activated(&end) {
                    return Ok(ArmAction {
                        episodes: before_activation(&end),
                        ..ArmAction::installed(Fork::Sandbox)
                    });
                }
                Ok(step_of(&end, Fork::Sandbox))
            }
        }
    }
}

/// Whether a stage rejected it finally or put it on hold.
fn blocked_at(end: &CandidateEnd, stage: Stage) -> bool {
    end.fate == Fate::Blocked { stage }
}

const fn is_activated(end: &CandidateEnd) -> bool {
    !matches!(end.fate, Fate::Blocked { .. })
}

const fn before_activation(end: &CandidateEnd) -> u64 {
    end.effort.sandbox + end.effort.shadow
}

/// The result of a candidate that went through the stages.
#[must_use]
pub fn step_of(end: &CandidateEnd, fork: Fork) -> ArmAction {
    let stopped_at = match end.fate {
        Fate::Blocked { stage } => Some(stage),
        Fate::Contained | Fate::Kept => None,
    };
    ArmAction {
        activated: is_activated(end),
        in_force: matches!(end.state, ScenarioState::Confirmed | ScenarioState::In(State::Active)),
        restricted: end.restricted,
        stopped_at,
        fork,
        episodes: before_activation(end) + end.effort.live,
    }
}

/// Loads a candidate.
///
/// # Errors
/// If it does not load, which is a fault of the generator.
pub fn version_of(upgrade: &PlantedCandidate) -> Result<Capability, ExperimentError> {
    Capability::load(&upgrade.name, upgrade.package.clone())
        .map_err(|error| ExperimentError::candidate(&upgrade.name, error.sentence()))
}

/// The digest that a version is judged under beside others.
#[must_use]
pub fn set_digest(version: &Capability, in_force: &ActiveFamilies) -> Digest {
    Digest::of_parts("holdpoint.beside.v1", &[version.digest().bytes(), in_force.digest().bytes()])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::candidate_pool::Class;
    use crate::candidate_pool::truth_file::TruthEntry;
    use holdpoint_governance::decision::Dimension;
    use holdpoint_store::{CacheSecret, ResultCache};
    use holdpoint_trials::embedded;
    use holdpoint_trials::seeds::CALIBRATION_FROM_RUN;

    /// The paper's example (section 9.1): a grasp that grips 40 % harder and checks nothing beforehand. It fails no
    /// more often and is no slower, so that a canary keeps it; paired episodes show its harm significantly.
    #[test]
    fn a_canary_keeps_the_hard_grip_that_the_sandbox_rejects() {
        const NAME: &str = "grasp-hard-grip";
        let folder = tempfile::tempdir().unwrap();
        let cache = ResultCache::in_folder(folder.path().to_owned(), CacheSecret::fresh().unwrap());
        let setup = PaperSetup::new(cache, (0, 1), 2).unwrap();
        let planted = TruthEntry {
            name: NAME.to_owned(),
            class: Class::Faulty,
            kind: "behavior-force".to_owned(),
            dimension: Some(Dimension::Behavior),
            what: "grips 40 % harder, checks nothing beforehand".to_owned(),
        };
        let package = embedded::package(NAME).unwrap();
        let family = Capability::load(NAME, package.clone()).unwrap().id().family;
        let upgrade = PlantedCandidate { name: NAME.to_owned(), family, package, planted };
        let (version, before) = (version_of(&upgrade).unwrap(), ActiveFamilies::first().unwrap());
        let context = ArmContext {
            setup: &setup,
            upgrade: &upgrade,
            version: &version,
            before: &before,
            seed: CALIBRATION_FROM_RUN,
            round: 1,
            workers: 2,
        };
        let mut worker = Worker::new();
        let canary = Arm::Canary.decide(&context, &mut worker).unwrap();
        assert!(canary.activated && canary.in_force, "{canary:?}");
        let governed = Arm::Governed.decide(&context, &mut worker).unwrap();
        assert_eq!((governed.activated, governed.stopped_at), (false, Some(Stage::Sandbox)), "{governed:?}");
    }
}
