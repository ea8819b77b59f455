//! Profiles: every number the rules use, for one setting (simulation, real cell, people nearby).
//!
//! Owns the text form and its checks. The numbers and their reasons are in `profiles/*.toml`; there is no
//! default in code. Source: design rule 3.13; paper appendix D, without numbers there (readings X63).

use std::collections::BTreeSet;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::ids::Digest;
use super::mode::ZoneName;
use super::submission::Risk;
use super::text_error::{TextError, check_size, parse_toml};

pub mod fields;
pub mod name;

use fields::Weights;
pub use name::{ProfileName, ProfileNameError};

/// The largest profile text, bytes.
pub const PROFILE_BYTES_MAX: usize = 64 * 1024;

/// Every number of a profile.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Profile {
    /// The setting.
    pub name: ProfileName,
    /// Thresholds of the four dimensions.
    pub thresholds: Thresholds,
    /// Weights of the reported composite.
    pub composite: Weights,
    /// What the guard enforces while a skill runs.
    pub runtime: RuntimeLimits,
    /// What the watcher calls an anomaly.
    pub watcher: WatcherTolerances,
    /// Sandbox, shadow and drills.
    pub evaluation: Evaluation,
    /// Weights and tolerances of `kappa_B`.
    pub behavior: BehaviorSettings,
    /// Floors and weights of `rho` and `kappa_R`.
    pub recovery: RecoverySettings,
    /// The gate.
    pub activation: ActivationSettings,
    /// After activation.
    pub monitor: MonitorSettings,
    /// Who has to be asked.
    pub approval: ApprovalSettings,
    /// When change is frozen, virtual seconds.
    #[serde(default)]
    pub freeze: Vec<FreezeWindow>,
    /// Priority of each alarm.
    pub alarms: AlarmPriorities,
}

/// Which published set of thresholds a profile starts from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum ThresholdPreset {
    /// Appendix I: I .95, P .90, B .85, R .80.
    Paper,
    /// As `paper` with B .88, the one set that also reproduces the paper's sensitivity table.
    PaperB88,
}

/// Thresholds of the four dimensions.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Thresholds {
    /// The set.
    pub preset: ThresholdPreset,
    /// Factor on all four; results are capped at 1.
    pub scale: f64,
}

impl Thresholds {
    const fn base(&self) -> [f64; 4] {
        match self.preset {
            ThresholdPreset::Paper => [0.95, 0.90, 0.85, 0.80],
            ThresholdPreset::PaperB88 => [0.95, 0.90, 0.88, 0.80],
        }
    }

    fn scaled(&self, index: usize) -> f64 {
        (self.base()[index] * self.scale).min(1.0)
    }

    /// Threshold of `kappa_I`.
    #[must_use]
    pub fn interface(&self) -> f64 {
        self.scaled(0)
    }

    /// Threshold of `kappa_P`.
    #[must_use]
    pub fn policy(&self) -> f64 {
        self.scaled(1)
    }

    /// Threshold of `kappa_B`.
    #[must_use]
    pub fn behavior(&self) -> f64 {
        self.scaled(2)
    }

    /// Threshold of `kappa_R`.
    #[must_use]
    pub fn recovery(&self) -> f64 {
        self.scaled(3)
    }
}

/// What the guard enforces.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RuntimeLimits {
    /// Tool speed, m/s.
    pub tool_speed_max_m_s: f64,
    /// Force on the surroundings, N.
    pub contact_force_max_n: f64,
    /// Force per finger, N.
    pub grip_force_max_n: f64,
    /// Speed of the fastest joint, rad/s.
    pub joint_speed_max_rad_s: f64,
    /// Retries in one episode.
    pub retries_max: u32,
    /// Longest motion after a declared failure or a stop, ms.
    pub unsafe_continuation_max_ms: f64,
    /// Share of a limit from which a value counts as near it.
    pub near_margin: f64,
    /// Lowest corner of where the tool may be, world frame, m.
    pub workspace_min_m: [f64; 3],
    /// Highest corner.
    pub workspace_max_m: [f64; 3],
    /// Zones the tool must keep out of.
    pub keep_out: BTreeSet<ZoneName>,
    /// Highest authority granted without a review.
    pub authority_max: u8,
    /// Processor time per tick, microseconds.
    pub cpu_us_per_tick_max: u32,
    /// Memory, KiB.
    pub memory_kib_max: u32,
    /// Longest episode, s.
    pub episode_max_s: f64,
}

/// What the watcher calls an anomaly.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct WatcherTolerances {
    /// Motion of the object in the hand, m.
    pub slip_max_m: f64,
    /// Distance of a joint from its servo target, rad.
    pub tracking_error_max_rad: f64,
    /// Age of the picture acted on, ms.
    pub picture_age_max_ms: f64,
    /// Time in which a failure has to be named, ms.
    pub detect_max_ms: f64,
}

/// Sandbox, shadow and drills.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Evaluation {
    /// Paired episodes of a full sandbox evaluation.
    pub sandbox_pairs: u32,
    /// Family-wise error of the six lower bounds.
    pub alpha: f64,
    /// Most rejections by the finite-population rules that the full budget would not have made; 0 = off.
    pub early_alpha: f64,
    /// Feasible drills of each kind.
    pub drills_per_kind: u32,
    /// Error rate of the shadow comparison, shared by its signals and looks.
    pub shadow_alpha: f64,
    /// Whole sequences of a shadow deployment.
    pub shadow_sequences: u32,
    /// Most sequences after lengthening.
    pub shadow_sequences_max: u32,
    /// Output divergence from which shadow is lengthened.
    pub output_divergence_max: f64,
    /// Envelope divergence from which shadow is lengthened.
    pub envelope_divergence_max: f64,
    /// Sequences of the live world per sandbox episode pair, in hundredths.
    pub live_sequences_per_100_episodes: u32,
}

/// Costs of `kappa_B` per unit of worsening.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BehaviorSettings {
    /// Per unit of success lost.
    pub cost_success: f64,
    /// Per relative increase of time, over pairs where both succeed.
    pub cost_time: f64,
    /// Per retry more.
    pub cost_retry: f64,
    /// Per unit of violation share.
    pub cost_violation: f64,
    /// Per unit of anomaly share.
    pub cost_anomaly: f64,
    /// Per unit of recovery share.
    pub cost_recovery: f64,
}

/// Floors and weights of recovery.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct RecoverySettings {
    /// Least `rho` that is not fragile; also the least pass rate of rollback drills.
    pub rho_floor: f64,
    /// Difference to the active version's `rho` that is still compatible.
    pub rho_tolerance: f64,
    /// Weight of `r_rollback`.
    pub weight_rollback: f64,
    /// Weight of `r_fallback`.
    pub weight_fallback: f64,
    /// Weight of `r_abort`.
    pub weight_abort: f64,
    /// Weight of `r_detect`.
    pub weight_detect: f64,
}

/// The gate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ActivationSettings {
    /// Episodes until an activation is confirmed.
    pub provisional_episodes: u32,
    /// Whether an established improvement is demanded.
    pub require_improvement: bool,
    /// Whether every activation is rollback-coupled while provisional.
    pub rollback_coupled: bool,
    /// Whether every activation is bound to approvals.
    pub approval_bound: bool,
}

/// After activation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct MonitorSettings {
    /// Least worsening of a rate that the charts are tuned to find.
    pub shift: f64,
    /// Level of the early warning (CUSUM of log-likelihood ratios).
    pub cusum_limit: f64,
    /// Mean episodes to a false rollback (Shiryaev-Roberts level).
    pub false_alarm_episodes: f64,
    /// Least rate assumed of the active version: a rate of 0 in finite evidence is not 0.
    pub rate_min: f64,
    /// Silence of telemetry that escalates, ms.
    pub telemetry_escalate_ms: f64,
    /// Silence of telemetry that restricts, ms.
    pub telemetry_restrict_ms: f64,
    /// Time for an answer to an escalation, s; then it rolls back.
    pub escalation_deadline_s: f64,
    /// Factor on speed and force of a restricted version.
    pub restrict_factor: f64,
}

/// Who has to be asked.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ApprovalSettings {
    /// People for low risk.
    pub quorum_low: u8,
    /// People for medium risk.
    pub quorum_medium: u8,
    /// People for high risk.
    pub quorum_high: u8,
    /// People for a review (a policy or recovery review), at least this many.
    pub quorum_review: u8,
    /// Time for answers, s; then it holds.
    pub timeout_s: f64,
    /// How long an approval stays good, s.
    pub valid_s: f64,
    /// Whether the emergency door exists.
    pub break_glass: bool,
    /// How long an emergency approval stays good, s.
    pub break_glass_valid_s: f64,
}

impl ApprovalSettings {
    /// People needed for a risk tier.
    #[must_use]
    pub const fn quorum(&self, risk: Risk) -> u8 {
        match risk {
            Risk::Low => self.quorum_low,
            Risk::Medium => self.quorum_medium,
            Risk::High => self.quorum_high,
        }
    }
}

/// A span of virtual time in which nothing is activated.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FreezeWindow {
    /// Beginning, virtual s, included.
    pub from_s: f64,
    /// End, virtual s, not included.
    pub until_s: f64,
    /// Why.
    pub reason: String,
}

/// Priority of an alarm (ISA-18.2: three levels).
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum AlarmPriority {
    /// Act soon.
    Low,
    /// Act within minutes.
    Medium,
    /// Act at once.
    High,
}

/// Priority of each alarm.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AlarmPriorities {
    /// A family stopped without an active version.
    pub safe_stopped: AlarmPriority,
    /// A version was rolled back.
    pub rolled_back: AlarmPriority,
    /// The monitor restricted a version.
    pub restricted: AlarmPriority,
    /// The monitor asks people.
    pub escalated: AlarmPriority,
    /// An approval waits.
    pub approval_waiting: AlarmPriority,
    /// A candidate was rejected.
    pub rejected: AlarmPriority,
    /// Telemetry is silent.
    pub telemetry_silent: AlarmPriority,
}

impl Profile {
    /// Parses and checks a profile; `file` is only named in errors.
    ///
    /// # Errors
    /// [`TextError`] with file, line, field, value and what is allowed.
    pub fn parse(file: &str, text: &str) -> Result<Self, TextError> {
        check_size(file, text, PROFILE_BYTES_MAX)?;
        let profile: Self = parse_toml(file, text)?;
        match fields::problem(&profile) {
            None => Ok(profile),
            Some((field, value, allowed)) => Err(TextError::value(file, text, &field, &value, &allowed)),
        }
    }

    /// A profile that comes with the program.
    ///
    /// # Errors
    /// [`TextError`] where the shipped text is damaged; a test parses all three.
    pub fn builtin(name: ProfileName) -> Result<Self, TextError> {
        let (file, text) = match name {
            ProfileName::Sim => ("profiles/sim.toml", include_str!("../../profiles/sim.toml")),
            ProfileName::Real => ("profiles/real.toml", include_str!("../../profiles/real.toml")),
            ProfileName::Human => ("profiles/human.toml", include_str!("../../profiles/human.toml")),
        };
        Self::parse(file, text)
    }

    /// The policy text that comes with the program for a profile.
    #[must_use]
    pub const fn builtin_policy(name: ProfileName) -> (&'static str, &'static str) {
        match name {
            ProfileName::Sim => ("profiles/sim.cedar", include_str!("../../profiles/sim.cedar")),
            ProfileName::Real => ("profiles/real.cedar", include_str!("../../profiles/real.cedar")),
            ProfileName::Human => ("profiles/human.cedar", include_str!("../../profiles/human.cedar")),
        }
    }

    /// SHA-256 over every number.
    ///
    /// # Errors
    /// Never for a parsed profile: it holds finite numbers and string keys only.
    pub fn digest(&self) -> Result<Digest, serde_json::Error> {
        Digest::of_json("holdpoint.profile.v1", self)
    }

    /// Whether anybody can approve under this profile.
    #[must_use]
    pub const fn has_approver(&self) -> bool {
        self.approval.quorum_review > 0
    }

    /// The freeze window that holds at a virtual time, s; a time that is not a number is frozen.
    #[must_use]
    pub fn frozen_at(&self, now_s: f64) -> Option<&str> {
        if !now_s.is_finite() {
            return Some("the time is unknown");
        }
        let window = self.freeze.iter().find(|window| window.from_s <= now_s && now_s < window.until_s)?;
        Some(&window.reason)
    }

    /// The published JSON Schema of a profile.
    #[must_use]
    pub fn json_schema() -> serde_json::Value {
        schemars::schema_for!(Self).to_value()
    }
}
