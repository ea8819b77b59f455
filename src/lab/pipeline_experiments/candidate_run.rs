//! One candidate through the seven stages on a scratch store, and its end.
//!
//! Drives the engine through its socket's requests as a script does. Knows nothing of the truth about a candidate: its
//! findings are the engine's decisions. Approvers, if the profile asks them, always agree, so that only the engine's
//! own judgment stops a candidate here.

mod driver;

use std::path::Path;

use serde::{Deserialize, Serialize};

use super::ExperimentError;
pub(crate) use driver::{CandidateDriver, DrivenSlice};
use holdpoint_engine::Experiment;
use holdpoint_explain::store_metrics::{self, Since};
use holdpoint_governance::decision::{Reason, ReasonCode};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::metrics::Fate;
use holdpoint_governance::monitor::MonitorOutcome;
use holdpoint_governance::outcome::StageOutcome;
use holdpoint_governance::profile::{Profile, ProfileName, ThresholdPreset};
use holdpoint_governance::site_profile::{ChosenProfile, ProfileTexts};
use holdpoint_governance::submission::Package;
use holdpoint_protocol::event::DimensionResult;
use holdpoint_protocol::scenario_state::{Decider, ScenarioState};
use holdpoint_registry::{TelemetryViews, Views};
use holdpoint_store::{Layout, ResultCache};
use holdpoint_trials::cache::EpisodeCache;
use holdpoint_trials::cell::Cell;
use holdpoint_trials::seeds::EpisodeSeeds;

/// The settings of a candidate's run.
#[derive(Clone)]
pub struct CandidateSetting<'a> {
    /// Robot, scene and distributions.
    pub cell: &'a Cell,
    pub profile: ProfileName,
    /// The run's seed, which selects its episodes.
    pub seed: u64,
    /// Active versions' episodes, which runs share.
    pub cache: &'a ResultCache,
    /// Workers; the result is the same for any number.
    pub workers: usize,
    /// The parts that are left out, and the first active versions.
    pub experiment: Experiment,
    pub thresholds: ThresholdScale,
}

#[cfg(test)]
impl<'a> CandidateSetting<'a> {
    /// The whole pipeline under `sim`, on a seed of calibration.
    pub(crate) fn calibration(cell: &'a Cell, cache: &'a ResultCache) -> Self {
        Self {
            cell,
            profile: ProfileName::Sim,
            seed: holdpoint_trials::seeds::CALIBRATION_FROM_RUN,
            cache,
            experiment: Experiment::default(),
            thresholds: ThresholdScale::AsTheyAre,
            workers: 2,
        }
    }
}

/// How the profile's thresholds of the four kappas are scaled.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum ThresholdScale {
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

impl ThresholdScale {
    /// The profile with its thresholds scaled.
    ///
    /// # Errors
    /// If the profile's text has no scale to change.
    pub fn of(self, profile: ProfileName) -> Result<ChosenProfile, ExperimentError> {
        let scale = match self {
            Self::AsTheyAre => return Ok(profile.into()),
            Self::Lower | Self::B88Lower => 0.9,
            Self::Higher | Self::B88Higher => 1.1,
            Self::Halved => 0.5,
            Self::B88 => 1.0,
        };
        let (preset, wanted) = match self {
            Self::B88 | Self::B88Lower | Self::B88Higher => ("paper-b88", ThresholdPreset::PaperB88),
            Self::AsTheyAre | Self::Lower | Self::Higher | Self::Halved => ("paper", ThresholdPreset::Paper),
        };
        let ((file, text), (policy_file, policy)) =
            (Profile::builtin_text(profile), Profile::builtin_policy(profile));
        let named = format!("name = \"{profile}\"");
        let own = text
            .replacen("scale = 1.0", &format!("scale = {scale:.1}"), 1)
            .replacen("preset = \"paper\"", &format!("preset = \"{preset}\""), 1)
            .replacen(&named, &format!("{named}\nsite = \"scaled\""), 1);
        let texts = ProfileTexts {
            file: file.to_owned(),
            profile: own,
            policy_file: policy_file.to_owned(),
            policy: policy.to_owned(),
        };
        let chosen = ChosenProfile::of(texts).map_err(ExperimentError::unexpected)?;
        let is_wanted = chosen.rules().is_ok_and(|(profile, _)| {
            profile.thresholds.preset == wanted && (profile.thresholds.scale - scale).abs() < 1e-9
        });
        if !is_wanted {
            return Err(ExperimentError::Unexpected(format!(
                "the thresholds in {file} could not be changed"
            )));
        }
        Ok(chosen)
    }
}

/// CPU time of each stage, s, of all threads.
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
    pub decision: DecisionOutcome,
    /// Why, the deciding reasons first.
    pub reasons: Vec<Reason>,
}

impl StageRecord {
    /// The codes of the reasons, in order; those that follow each other once.
    pub(crate) fn codes(&self) -> Vec<ReasonCode> {
        let mut codes: Vec<ReasonCode> = self.reasons.iter().map(|reason| reason.code).collect();
        codes.dedup();
        codes
    }
}

/// The decision, in the decider's own words; no two of them share one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum DecisionOutcome {
    Stage(StageOutcome),
    Monitor(MonitorOutcome),
}

/// Episodes that ran for a candidate, of its own.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EpisodeEffort {
    /// Sandbox episodes, pairs and drills.
    pub sandbox: u64,
    /// The full budget of the sandbox.
    pub sandbox_budget: u64,
    pub shadow: u64,
    /// Live episodes while it was active.
    pub live: u64,
}

/// Data of a candidate's own store at the end: its decisions made again, and its live tasks by their telemetry.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PostRunCheck {
    /// Decisions by rules, on record.
    pub decisions: u64,
    /// Of those, the ones that are equal when they are made again from the record.
    pub equal: u64,
    /// Live tasks while it was in control.
    pub live: u64,
    /// Of those: done, past a limit, near one or past it.
    pub done: u64,
    pub violation: u64,
    pub near: u64,
    /// An unsafe event was seen while it was in control.
    pub unsafe_seen: bool,
}

impl PostRunCheck {
    /// Reads a store that no process has open.
    fn read(store: &Path, cell: &Cell) -> Result<Self, ExperimentError> {
        let layout = Layout::new(store);
        let views = Views::open_records(&layout.database())?;
        let telemetry = TelemetryViews::open(&layout.telemetry())?;
        let found = store_metrics::observe(&views, Some(&telemetry), Since::Record(1), cell.digest())
            .map_err(ExperimentError::unexpected)?;
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

/// The result of a candidate.
// Unknown fields are accepted: serde cannot tell them from flattened fields.
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
    pub state: ScenarioState,
    /// It is active in the end, in a tighter envelope than it was measured in.
    #[serde(default)]
    pub restricted: bool,
    /// Blocked, contained or kept.
    #[serde(flatten)]
    pub fate: Fate,
    /// Episodes that ran for it.
    pub effort: EpisodeEffort,
    /// Data of its store.
    pub afterwards: PostRunCheck,
}

/// Runs a candidate until nothing more happens to it by itself.
///
/// # Errors
/// If the engine cannot start or halts, registration refuses the candidate, or it does not settle.
pub fn run_candidate(
    setting: &CandidateSetting<'_>,
    name: &str,
    package: Package,
) -> Result<CandidateEnd, ExperimentError> {
    Ok(run_candidate_timed(setting, name, package)?.0)
}

/// As [`run_candidate`], with the CPU time of each stage; valid in a process that does nothing else meanwhile.
///
/// # Errors
/// As [`run_candidate`].
pub fn run_candidate_timed(
    setting: &CandidateSetting<'_>,
    name: &str,
    package: Package,
) -> Result<(CandidateEnd, StageTimes), ExperimentError> {
    let store = super::scratch()?;
    let (seeds, episodes) = (EpisodeSeeds::OfRun(setting.seed), EpisodeCache::Shared(setting.cache.clone()));
    let mut drive = CandidateDriver::start(setting, (seeds, episodes), store.path(), (name, &package))?;
    drive.register(package)?;
    drive.run_until_settled()?;
    let times = drive.seen.times;
    // The store is closed by then, and all of its telemetry is sealed.
    let end = drive.end(setting)?;
    let afterwards = PostRunCheck::read(store.path(), setting.cell)?;
    Ok((CandidateEnd { afterwards, ..end }, times))
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_governance::lifecycle::Stage;

    /// A candidate's cached result is read instead of a re-run.
    #[test]
    fn an_end_is_read_back_unchanged() {
        for fate in [Fate::Kept, Fate::Contained, Fate::Blocked { stage: Stage::Shadow }] {
            let end = CandidateEnd {
                name: "grasp-001".to_owned(),
                version: "grasp@1.1.1".parse().unwrap(),
                profile: ProfileName::Sim,
                seed: 30,
                dimensions: Vec::new(),
                composite: Some(0.9),
                stages: Vec::new(),
                state: ScenarioState::Confirmed,
                restricted: false,
                fate,
                effort: EpisodeEffort::default(),
                afterwards: PostRunCheck {
                    decisions: 4,
                    equal: 4,
                    live: 15,
                    done: 12,
                    ..PostRunCheck::default()
                },
            };
            let bytes = serde_json::to_vec(&end).unwrap();
            assert_eq!(serde_json::from_slice::<CandidateEnd>(&bytes).unwrap(), end);
        }
    }

    #[test]
    fn only_thresholds_are_scaled() {
        let rules = |thresholds: ThresholdScale| thresholds.of(ProfileName::Sim).unwrap().rules().unwrap().0;
        let plain = rules(ThresholdScale::AsTheyAre);
        assert!(plain.site.is_none());
        for (thresholds, behavior) in [
            (ThresholdScale::Lower, 0.9 * 0.85),
            (ThresholdScale::Higher, 1.1 * 0.85),
            (ThresholdScale::Halved, 0.5 * 0.85),
            (ThresholdScale::B88, 0.88),
            (ThresholdScale::B88Lower, 0.9 * 0.88),
            (ThresholdScale::B88Higher, 1.1 * 0.88),
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
    fn a_decision_is_read_back_by_its_name() {
        let stages = StageOutcome::ALL.map(|outcome| (DecisionOutcome::Stage(outcome), outcome.name()));
        let monitor = MonitorOutcome::ALL.map(|outcome| (DecisionOutcome::Monitor(outcome), outcome.name()));
        for (outcome, name) in stages.into_iter().chain(monitor) {
            let text = serde_json::to_string(&outcome).unwrap();
            assert_eq!(text, format!("{name:?}"));
            assert_eq!(serde_json::from_str::<DecisionOutcome>(&text).unwrap(), outcome);
        }
    }
}
