//! Profiles: every number the rules use, for one setting (simulation, real cell, people nearby).
//!
//! Owns the text form and its checks. The numbers and their reasons are in `profiles/*.toml`. Only numbers that
//! older profiles do not have get a value from code (`profile/later_numbers.rs`). Source: design rule 3.13; paper
//! appendix D, without numbers there (readings X63).

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::alarms::Priority;
use super::ids::Digest;
use super::start_domain::OutsideResponse;
use super::submission::Risk;
use super::text_error::{TextError, check_size, parse_toml};
use super::wall_time::WallTime;

mod class_limits;
mod evaluation_settings;
pub mod fields;
mod harm;
pub(crate) mod later_numbers;
mod live_harm;
pub mod name;
mod reasons;
mod recovery_settings;
mod runtime_limits;

pub use evaluation_settings::EvaluationSettings;
use fields::Weights;
pub use harm::{HarmSettings, HarmTolerance};
use later_numbers as later;
pub use live_harm::LiveHarmSettings;
pub use name::{ClassRisk, ProfileName, ProfileNameError, SiteName, SiteNameError, titled};
pub use reasons::ReasonedNumber;
use reasons::Reasons;
pub use recovery_settings::RecoverySettings;
pub use runtime_limits::{RuntimeLimits, WatcherTolerances};

/// The largest profile text, bytes; checked before it is parsed.
pub const PROFILE_BYTES_MAX: usize = 64 * 1024;

/// Every number the rules are applied with, for one setting (paper appendix D).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Profile {
    /// The setting it is for: its class. Candidates, approvals and rules speak of the class.
    pub name: ProfileName,
    /// Its own name, if it does not come with the program: which numbers of that class these are.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub site: Option<SiteName>,
    /// Least acceptable value of each dimension.
    pub thresholds: Thresholds,
    /// Weights of the composite score, which is reported and gates nothing.
    pub composite: Weights,
    /// The limits that the guard enforces while a skill runs.
    pub runtime: RuntimeLimits,
    /// Tolerances beyond which the watcher raises a signal.
    pub watcher: WatcherTolerances,
    /// Budgets and error rates of sandbox, shadow and drills.
    pub evaluation: EvaluationSettings,
    /// What is demanded of shadow where the cell has no twin.
    pub shadow: ShadowSettings,
    /// How many tries an author has, at which levels, and against which margin.
    pub tries: TrySettings,
    /// Costs per unit of worsening that make up `kappa_B`.
    pub behavior: BehaviorSettings,
    /// How much worse a version may be in each measure of harm.
    pub harm: HarmSettings,
    /// How harm in live tasks is judged, for a version's whole life.
    pub live_harm: LiveHarmSettings,
    /// Floors and weights of `rho` and `kappa_R`.
    pub recovery: RecoverySettings,
    /// The gate's requirements beyond the four dimensions, and the activation mode.
    pub activation: ActivationSettings,
    /// What is done where evidence does not cover the start of a task.
    pub domain: DomainSettings,
    /// Charts, silence and escalation while a version is watched.
    pub monitor: MonitorSettings,
    /// What is normal for the cell itself with any active version, and when it no longer is.
    pub health: HealthSettings,
    /// The quorum, and the validity of an answer.
    pub approval: ApprovalSettings,
    /// How far the machine's clock may be set before a person has to confirm the time.
    pub clock: ClockSettings,
    /// Spans of wall time in which nothing is activated.
    #[serde(default)]
    pub freeze: Vec<FreezeWindow>,
    /// How soon an operator has to act on each alarm.
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

/// Least acceptable values of the four dimensions (paper appendix I).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Thresholds {
    /// The published set that is scaled.
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

    /// Least acceptable `kappa_I`, after scaling.
    #[must_use]
    pub fn interface(&self) -> f64 {
        self.scaled(0)
    }

    /// Least acceptable `kappa_P`, after scaling.
    #[must_use]
    pub fn policy(&self) -> f64 {
        self.scaled(1)
    }

    /// Least acceptable `kappa_B`, after scaling; compared with the significant worsening.
    #[must_use]
    pub fn behavior(&self) -> f64 {
        self.scaled(2)
    }

    /// Least acceptable `kappa_R`, after scaling.
    #[must_use]
    pub fn recovery(&self) -> f64 {
        self.scaled(3)
    }
}

crate::closed_set! {
    /// Whether shadow may rest on outputs alone.
    OutputsAlone, "answer to outputs alone", {
        /// It passes a version; a large divergence of outputs makes it longer.
        Enough = "enough",
        /// The version is demoted.
        Hold = "hold",
    }
}

/// What is demanded of shadow where the cell has no twin.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ShadowSettings {
    /// What follows where a live cell can neither export its state nor have a trial cell set to what it observed.
    pub outputs_alone: OutputsAlone,
}

/// Error rates and number of tries (see [`tries`](crate::tries)).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct TrySettings {
    /// The loss of success that every accepted version has to exclude at the level of its try.
    pub margin: f64,
    /// Most probability that an author ever gets a version accepted that loses the margin or more, between two reviews.
    pub author_alpha: f64,
    /// The same for all authors of a family together.
    pub family_alpha: f64,
    /// Tries of an author in a family; then a person has to review them.
    pub per_author: u32,
    /// Tries of all authors in a family, likewise.
    pub per_family: u32,
}

/// Costs of `kappa_B` per unit of worsening.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct BehaviorSettings {
    /// Per unit of success rate lost.
    pub cost_success: f64,
    /// Per relative increase of time, over pairs in which both succeed.
    pub cost_time: f64,
    /// Per additional retry per episode.
    pub cost_retry: f64,
    /// Per unit of increase of the share of episodes with a violation.
    pub cost_violation: f64,
    /// Per unit of increase of the share of episodes with an anomaly.
    pub cost_anomaly: f64,
    /// Per unit of increase of the share of episodes in which recovery ran.
    pub cost_recovery: f64,
    /// Loss of success that rejects by itself where it is established.
    #[serde(default = "later::success_loss_max", skip_serializing_if = "later::is_success_loss_max")]
    pub success_loss_max: f64,
    /// Factor on the monitor's limits for a version with an open concern.
    #[serde(default = "later::concern_factor", skip_serializing_if = "later::is_concern_factor")]
    pub concern_factor: f64,
}

/// The gate's requirements beyond the four dimensions, and the activation mode.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ActivationSettings {
    /// Live episodes a version is provisional for.
    pub provisional_episodes: u32,
    /// Whether the gate requires a significant improvement of success.
    pub require_improvement: bool,
    /// Whether every activation is rollback-coupled while provisional.
    pub rollback_coupled: bool,
    /// Whether every activation is bound to approvals.
    pub approval_bound: bool,
}

/// What is done where evidence does not cover the start of a task.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DomainSettings {
    /// The response to a task whose start lies outside the domain of the active version's evidence.
    pub outside: OutsideResponse,
}

/// How a version is watched after its activation.
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
    /// Silence of telemetry after which the monitor escalates, ms.
    pub telemetry_escalate_ms: f64,
    /// Silence of telemetry after which the version is restricted, ms.
    pub telemetry_restrict_ms: f64,
    /// Time for an answer to an escalation, s; then it rolls back.
    pub escalation_deadline_s: f64,
    /// Factor on speed and force of a restricted version.
    pub restrict_factor: f64,
    /// Factor on the time that nineteen of twenty episodes stayed below before activation; above it one is slow.
    pub slow_factor: f64,
    /// One-sided error of the bound that a version's twins leave open on each normal rate.
    #[serde(default = "later::monitor_normal_alpha", skip_serializing_if = "later::is_monitor_normal_alpha")]
    pub normal_alpha: f64,
    /// Share of slow episodes that is normal.
    #[serde(default = "later::slow_share", skip_serializing_if = "later::is_slow_share")]
    pub slow_share: f64,
    /// Share of episodes past a limit of harm that is normal.
    #[serde(default = "later::harm_share", skip_serializing_if = "later::is_harm_share")]
    pub harm_share: f64,
    /// Newest live tasks in which the rollback target is compared when a rate rolls a version back.
    #[serde(default = "later::paired_tasks", skip_serializing_if = "later::is_paired_tasks")]
    pub paired_tasks: f64,
    /// One-sided error of that comparison; only below it a rate rolls back for good.
    #[serde(default = "later::paired_alpha", skip_serializing_if = "later::is_paired_alpha")]
    pub paired_alpha: f64,
}

impl MonitorSettings {
    /// [`MonitorSettings::paired_tasks`] as a number of tasks.
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "the range of the field")]
    #[must_use]
    pub const fn paired_tasks_max(&self) -> usize {
        self.paired_tasks as usize
    }
}

/// How every active version is watched, whether or not it is new.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct HealthSettings {
    /// Tasks of a family over which its normal rates are counted, once.
    pub commissioning_tasks: u32,
    /// Largest share of failed, and of timed-out, tasks that may count as normal.
    pub failure_max: f64,
    /// Least share that is assumed to be normal: none in few tasks is no proof of none.
    pub rate_min: f64,
    /// Worsening of a share that the charts are tuned to find.
    pub shift: f64,
    /// Level of the charts (CUSUM of log-likelihood ratios); `e^level` tasks to a false alarm at least.
    pub cusum_limit: f64,
    /// Factor above the largest force of the commissioning from which a force counts as bad.
    pub force_margin: f64,
    /// Factor on the largest value of the commissioning from which a signal of the camera check counts as bad.
    pub sense_margin: f64,
    /// Largest camera jitter that may count as normal, m (see [`crate::sensor_health::SensorSignal`]).
    pub jitter_max_m: f64,
    /// Largest rate of missing camera frames that may count as normal.
    pub missing_max: f64,
    /// Tasks in a row, all without it, after which a condition is measured to be over.
    pub clear_tasks: u32,
    /// One-sided error of the bound that the commissioning leaves open on each normal rate.
    #[serde(default = "later::health_normal_alpha", skip_serializing_if = "later::is_health_normal_alpha")]
    pub normal_alpha: f64,
    /// Least part of its limit that counts as normal for a signal of the camera check.
    #[serde(default = "later::sense_floor_share", skip_serializing_if = "later::is_sense_floor_share")]
    pub sense_floor_share: f64,
}

/// The quorum, and the validity of requests and answers.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ApprovalSettings {
    /// Distinct approvers for low risk; 0: none required.
    pub quorum_low: u8,
    /// Distinct approvers for medium risk; 0: none required.
    pub quorum_medium: u8,
    /// Distinct approvers for high risk; 0: none required.
    pub quorum_high: u8,
    /// People for a review (a policy or recovery review), at least this many.
    pub quorum_review: u8,
    /// Time for answers, s; then the version is on hold.
    pub timeout_s: f64,
    /// How long an approval stays good, s.
    pub valid_s: f64,
    /// Whether one person may approve in an emergency (break-glass), with a later review.
    pub break_glass: bool,
    /// Validity of a break-glass approval, s.
    pub break_glass_valid_s: f64,
}

impl ApprovalSettings {
    /// Distinct people needed for a risk tier.
    #[must_use]
    pub const fn quorum(&self, risk: Risk) -> u8 {
        match risk {
            Risk::Low => self.quorum_low,
            Risk::Medium => self.quorum_medium,
            Risk::High => self.quorum_high,
        }
    }
}

/// When the machine's clock is believed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct ClockSettings {
    /// How far the wall clock may go another way than the time since the machine was started, while an engine runs, s.
    /// Beyond it nothing is activated before a person has confirmed the time.
    pub jump_max_s: f64,
}

/// A span of wall time in which nothing is activated, also while no engine runs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct FreezeWindow {
    /// Beginning, included.
    pub from: WallTime,
    /// End, not included.
    pub until: WallTime,
    /// Why nothing is activated meanwhile; shown when the freeze blocks an activation.
    pub reason: String,
}

/// Priority of an alarm (ISA-18.2: three levels).
#[derive(Serialize, Deserialize, JsonSchema)]
#[serde(remote = "Priority")]
#[schemars(rename = "AlarmPriority")]
enum PrioritySetting {
    /// Act before the shift ends.
    #[serde(rename = "low")]
    Low,
    /// Act within minutes.
    #[serde(rename = "medium")]
    High,
    /// Act at once; the alarm cannot be shelved.
    #[serde(rename = "high")]
    Critical,
}

/// How soon an operator has to act on each alarm.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct AlarmPriorities {
    /// A family stopped without an active version.
    #[serde(with = "PrioritySetting")]
    pub safe_stopped: Priority,
    /// A version was rolled back, and the rollback target is active.
    #[serde(with = "PrioritySetting")]
    pub rolled_back: Priority,
    /// The monitor capped a version's speed and force.
    #[serde(with = "PrioritySetting")]
    pub restricted: Priority,
    /// An escalation asks whether a version may continue.
    #[serde(with = "PrioritySetting")]
    pub escalated: Priority,
    /// An approval request is open.
    #[serde(with = "PrioritySetting")]
    pub approval_waiting: Priority,
    /// No telemetry came for longer than the monitor allows.
    #[serde(with = "PrioritySetting")]
    pub telemetry_silent: Priority,
    /// An active version, whichever, violated a limit.
    #[serde(with = "PrioritySetting")]
    pub violation: Priority,
    /// A family performs worse than when it was commissioned.
    #[serde(with = "PrioritySetting")]
    pub degraded: Priority,
    /// The evidence of an active version does not cover the start of a task.
    #[serde(with = "PrioritySetting")]
    pub outside_domain: Priority,
}

impl Profile {
    /// Parses and checks a profile; `file` is only named in errors.
    ///
    /// # Errors
    /// [`TextError`] with file, line, field, value and what is allowed: text over 64 KiB, TOML that does not parse,
    /// unknown or missing fields, numbers outside the ranges of [`fields`].
    pub fn parse(file: &str, text: &str) -> Result<Self, TextError> {
        check_size(file, text, PROFILE_BYTES_MAX)?;
        let profile: Self = parse_toml(file, text).map_err(|error| freeze_in_seconds(file, text, error))?;
        match fields::problem(&profile).or_else(|| class_limits::problem(&profile)) {
            None => Ok(profile),
            Some((field, value, allowed)) => Err(TextError::value(file, text, &field, &value, &allowed)),
        }
    }

    /// A profile that comes with the program.
    ///
    /// # Errors
    /// [`TextError`] if the text compiled in does not parse or check, which a test rules out for all three.
    pub fn builtin(name: ProfileName) -> Result<Self, TextError> {
        let (file, text) = Self::builtin_text(name);
        Self::parse(file, text)
    }

    /// The file and the text of a profile that comes with the program.
    #[must_use]
    pub const fn builtin_text(name: ProfileName) -> (&'static str, &'static str) {
        name.declaration().profile
    }

    /// The policy text that comes with the program for a profile.
    #[must_use]
    pub const fn builtin_policy(name: ProfileName) -> (&'static str, &'static str) {
        name.declaration().policy
    }

    /// What is wrong with a profile that does not come with the program, beyond what [`Profile::parse`] refuses:
    /// field, value, what is allowed. `text` is what it was parsed from.
    pub(crate) fn own_problem(&self, text: &str) -> Option<(String, String, String)> {
        if self.site.is_none() {
            let allowed =
                "a name of its own for a profile that does not come with the program, e.g. \"line-4\"";
            return Some(("site".to_owned(), "none".to_owned(), allowed.to_owned()));
        }
        class_limits::less_strict_than_allowed(self).or_else(|| self.unreasoned(text))
    }

    /// Where it is less strict than its class permits: field, value, what is allowed.
    pub(crate) fn weaker_than_class(&self) -> Option<(String, String, String)> {
        class_limits::less_strict_than_allowed(self)
    }

    /// A number that differs from the shipped profile of its class and has no reason of its own.
    fn unreasoned(&self, text: &str) -> Option<(String, String, String)> {
        let shipped = fields::numbers(&Self::builtin(self.name).ok()?);
        let reasons = Reasons::of(text);
        let differs = |(path, value): &(String, f64)| {
            shipped.iter().find(|(name, _)| name == path).is_none_or(|(_, shipped)| shipped != value)
        };
        let (path, value) = fields::numbers(self)
            .into_iter()
            .find(|number| differs(number) && reasons.own(&number.0).is_none())?;
        let allowed =
            format!("that number with a reason behind # on its line: the profile {} has another", self.name);
        Some((path, value.to_string(), allowed))
    }

    /// Every number with its reason by `text`, what this was parsed from; a number without one has the reason that the
    /// shipped profile of its class gives for the same number.
    ///
    /// # Errors
    /// As [`Profile::builtin`].
    pub(crate) fn reasoned(&self, text: &str) -> Result<Vec<ReasonedNumber>, TextError> {
        let (own, shipped) = (Reasons::of(text), Reasons::of(Self::builtin_text(self.name).1));
        let before = fields::numbers(&Self::builtin(self.name)?);
        let number = |(path, value): (String, f64)| {
            let shipped_value = before.iter().find(|(name, _)| *name == path).map(|(_, value)| *value);
            let same = shipped_value == Some(value);
            let reason = own.own(&path).or_else(|| if same { shipped.any(&path) } else { own.any(&path) });
            let reason = reason.map(ToOwned::to_owned);
            ReasonedNumber { path, value, shipped: shipped_value.filter(|_| !same), reason }
        };
        Ok(fields::numbers(self).into_iter().map(number).collect())
    }

    /// The same with another number of pairs: what a counted try has to run.
    #[must_use]
    pub fn with_sandbox_pairs(&self, sandbox_pairs: u32) -> Self {
        Self { evaluation: EvaluationSettings { sandbox_pairs, ..self.evaluation }, ..self.clone() }
    }

    /// SHA-256 over every number.
    ///
    /// # Errors
    /// Never for a parsed profile: it holds finite numbers and string keys only.
    pub fn digest(&self) -> Result<Digest, serde_json::Error> {
        Digest::of_json("holdpoint.profile.v1", self)
    }

    /// Whether any approver can approve under this profile.
    #[must_use]
    pub const fn has_approver(&self) -> bool {
        self.approval.quorum_review > 0
    }

    /// The freeze window in force at a moment.
    #[must_use]
    pub fn frozen_at(&self, now: WallTime) -> Option<&FreezeWindow> {
        self.freeze.iter().find(|window| window.from <= now && now < window.until)
    }

    /// The published JSON Schema of a profile.
    #[must_use]
    pub fn json_schema() -> serde_json::Value {
        schemars::schema_for!(Self).to_value()
    }
}

/// Says of a freeze in the engine's seconds, as earlier versions had it, how it is written now.
fn freeze_in_seconds(file: &str, text: &str, error: TextError) -> TextError {
    let field = match &error {
        TextError::Syntax { message, .. } => ["from_s", "until_s"]
            .into_iter()
            .find(|field| message.contains(&format!("unknown field `{field}`"))),
        TextError::TooLarge { .. } | TextError::Value { .. } => None,
    };
    let Some(field) = field else { return error };
    let allowed = "from and until as times with their zone, e.g. from = \"2026-12-24T06:00:00+01:00\"; the engine's \
                   seconds stand still while no engine runs";
    TextError::value(file, text, &format!("freeze.{field}"), "seconds of the engine", allowed)
}
