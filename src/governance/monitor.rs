//! `M(telemetry, policy, Gamma)`: continue, restrict, escalate or roll back, after activation.
//!
//! Safety events trip at once. Rates are charted per episode: CUSUM warns early and restricts, Shiryaev-Roberts with a
//! guaranteed run length to a false alarm rolls back. Silence escalates, then restricts; an unanswered escalation
//! rolls back. Conditions of an activation make it stricter until the version is confirmed. Time comes in as ticks;
//! nothing here reads a clock. Source: paper section 5.2 stage 6, equation 11; design rule 3.8.

mod normal;
mod rate_comparison;
mod trip;

use std::borrow::Cow;

use holdpoint_body::RATE_HZ;
use holdpoint_text::Hint;
use serde::{Deserialize, Serialize};

pub use normal::normal_rates;
pub use rate_comparison::{
    ComparedRate, ComparedTask, ForkedPair, RateComparison, RateTally, deciding_rates,
};
pub use trip::{roll_back, safety_trip};

use super::closed_set::convert_equal_terms;
use super::decision::{Dimension, Reason, ReasonCode};
use super::evidence::{EpisodeValues, Signature};
use super::finding::Finding;
use super::profile::{HarmSettings, MonitorSettings, Profile, ProfileName};
use super::strictness::Strictness;
use crate::stats::{Cusum, ShiryaevRoberts, StatsError};

crate::closed_set! {
    /// An action of the monitor; later ones outrank earlier ones.
    MonitorAction, "action of the monitor", {
        /// Normal; the version continues.
        Continue = "continue",
        /// An escalation; without an answer by the deadline it becomes a rollback.
        Escalate = "escalate",
        /// Tool speed and force are capped at the profile's `monitor.restrict_factor` until people release it.
        Restrict = "restrict",
        /// Authority is revoked and the ladder climbed; outranks everything else and latches.
        Rollback = "rollback",
    }
}

crate::closed_set! {
    /// What an event reports of a monitor: an action other than continuing, or the end of the concern that a version
    /// was activated with.
    MonitorOutcome, "outcome of the monitor", {
        /// No action; no event reports it.
        Continue = "continue",
        /// Operators are asked whether it may continue.
        Escalate = "escalate",
        /// Tool speed and force are capped until people release the version.
        Restrict = "restrict",
        /// The version is rolled back; the rollback target is bound again.
        Rollback = "rollback",
        /// Fresh evidence settled the concern.
        Settled = "settled",
        /// The concern remains on fresh evidence: the version is rolled back.
        DoubtRemains = "doubt-remains",
    }
}

crate::closed_set! {
    /// An operator's answer to an escalation. An operator who wants the version removed rolls it back instead.
    MonitorAnswer, "answer to a monitor", {
        /// The version continues; its charts restart.
        GoOn = "go-on",
        /// As that, and its restriction is lifted.
        Release = "release",
    }
}

convert_equal_terms! { MonitorAction => MonitorOutcome: Continue, Escalate, Restrict, Rollback }

crate::closed_set! {
    /// Events that trip the monitor in the tick they happen (design rule 3.8).
    SafetyEvent, "safety event", {
        /// Force on the surroundings past its limit.
        ForceLimit = "force-limit",
        /// Tool or joint speed past its limit.
        SpeedLimit = "speed-limit",
        /// Contact of the robot with itself or with fixtures outside the task's phases.
        Collision = "collision",
        /// The tool entered a zone it must keep out of.
        KeepOut = "keep-out",
        /// Motion after a declared failure or a stop for longer than the profile allows.
        UnsafeContinuation = "unsafe-continuation",
        /// A number that is not finite from the version or from telemetry.
        NotANumber = "not-a-number",
        /// The guard denied a command that the version's own permissions do not cover.
        PermissionBreach = "permission-breach",
        /// A measure of harm past the value from which it is a danger to people, found at the end of the task.
        Danger = "danger",
    }
}

crate::closed_set! {
    /// What the monitor does at the limit of a chart.
    ChartLevel, "level of a chart", {
        /// It warns, and restricts the version or asks an operator.
        Warning = "warning",
        /// It rolls the version back.
        Trip = "trip",
    }
}

crate::closed_set! {
    /// The charted rates, each as the share of bad episodes.
    Rate, "rate of the monitor", {
        /// Episodes in which the task was not done.
        Failure = "failure",
        /// Episodes with a violation: a limit passed, or a command refused.
        Violation = "violation",
        /// Episodes with an anomaly: the watcher raised a signal.
        Anomaly = "anomaly",
        /// Episodes in which a person stepped in.
        Intervention = "intervention",
        /// Episodes with at least one retry.
        Retry = "retry",
        /// Episodes in which recovery ran.
        Recovery = "recovery",
        /// Episodes that ran out of time.
        Timeout = "timeout",
        /// Episodes with a policy warning: a command clamped or refused, or a limit passed.
        PolicyWarning = "policy-warning",
        /// Episodes in which a measured value came near its limit.
        NearLimit = "near-limit",
        /// Episodes slower than the profile's factor on what nineteen of twenty took before activation.
        Slow = "slow",
        /// Episodes in which a measure of harm is past the profile's limit.
        Harm = "harm",
    }
}

/// The largest rate that a chart is tuned to: a chart needs a rate below 1.
const DEGRADED_MAX: f64 = 0.95;

/// The largest shift that a chart is tuned to; the range of the profile's field ends there.
const SHIFT_MAX: f64 = 0.9;

impl Rate {
    /// `slow_over_s`: from where an episode is slow; absent if that is not known. `limits`: of harm, if known.
    fn is_bad(
        self,
        episode: &EpisodeValues,
        slow_over_s: Option<f64>,
        limits: Option<&HarmSettings>,
    ) -> bool {
        match self {
            Self::Failure => !episode.success,
            Self::Violation => episode.violation,
            Self::Anomaly => episode.anomaly,
            Self::Intervention => episode.intervention,
            Self::Retry => episode.retries > 0,
            Self::Recovery => episode.recovery,
            Self::Timeout => episode.timeout,
            Self::PolicyWarning => episode.policy_warning,
            Self::NearLimit => episode.near_violation,
            Self::Slow => slow_over_s.is_some_and(|over| episode.time_s > over),
            Self::Harm => limits.zip(episode.harm).is_some_and(|(limits, harm)| limits.is_past(&harm)),
        }
    }
    /// The share of bad episodes that is normal, from what was measured before activation or, where nothing was, from the
    /// profile.
    fn normal(self, signature: &Signature, settings: &MonitorSettings) -> f64 {
        match self {
            Self::Failure => 1.0 - signature.success,
            Self::Violation => signature.violation,
            Self::Anomaly => signature.anomaly,
            Self::Intervention => signature.intervention,
            // At most one retry per episode is assumed: the share of episodes with one is at most the mean.
            Self::Retry => signature.retry,
            Self::Recovery => signature.recovery,
            Self::Timeout => signature.timeout,
            Self::PolicyWarning => signature.policy_warning,
            Self::NearLimit => signature.near_limit,
            Self::Slow => settings.slow_share,
            Self::Harm => settings.harm_share,
        }
    }

    /// Whether it describes how a version works rather than a failure. It may then occur in every episode, as where a
    /// profile clamps a version's usual requests.
    const fn is_manner(self) -> bool {
        matches!(self, Self::PolicyWarning | Self::NearLimit)
    }

    /// Whether a tighter envelope brings it about by itself.
    const fn follows_from_restriction(self) -> bool {
        matches!(self, Self::PolicyWarning | Self::NearLimit | Self::Slow)
    }
}

/// One action of the monitor with its reasons.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MonitorDecision {
    /// The action from this tick on.
    pub action: MonitorAction,
    /// Why, the deciding reason first.
    pub reasons: Vec<Reason>,
    /// When it was decided, virtual ticks.
    pub tick: u64,
}

/// An escalation that waits for an answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Escalation {
    /// When the escalation was raised, virtual ticks.
    pub since_tick: u64,
    /// When it becomes a rollback without an answer, virtual ticks.
    pub deadline_tick: u64,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct ControlChart {
    rate: Rate,
    /// The share of bad episodes that is normal.
    normal: f64,
    warning: Cusum,
    trip: ShiryaevRoberts,
}

/// The monitor of one activation. Serializable, so that a restart continues from its state.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Monitor {
    /// The profile's settings, before they are made stricter.
    settings: MonitorSettings,
    strictness: Strictness,
    unsafe_continuation_max_ms: f64,
    /// From where an episode is slow, s; absent if nothing was measured before activation.
    #[serde(default)]
    slow_over_s: Option<f64>,
    /// Limits of harm; absent where it is not charted, and in a monitor that an older build set up.
    #[serde(default)]
    limits: Option<HarmSettings>,
    provisional_left: u32,
    episodes: u64,
    charts: Vec<ControlChart>,
    last_telemetry_tick: u64,
    escalation: Option<Escalation>,
    restricted: bool,
    /// It runs under a tighter envelope than it was measured under.
    #[serde(default)]
    tightened: bool,
    rolled_back: bool,
}

/// A monitor that could not be set up; without one nothing may run.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "a field is named as the thing that it is")]
pub enum MonitorError {
    /// An expected rate is not between 0 and 1.
    #[error("the expected {rate} rate {value} is not allowed; 0 to 1 is")]
    Rate { rate: &'static str, value: f64 },
    /// A condition's factor on the limits is not above 0 and at most 1.
    #[error("the factor {0} on the monitor's limits is not allowed; above 0 and up to 1 is")]
    Factor(f64),
    /// The charts cannot be tuned with these settings.
    #[error("the monitor's charts cannot be set up: {0}")]
    Stats(#[from] StatsError),
}

impl Hint for MonitorError {
    fn hint(&self) -> Option<Cow<'static, str>> {
        match self {
            Self::Rate { .. } | Self::Factor(_) => None,
            Self::Stats(error) => error.hint(),
        }
    }
}

impl ControlChart {
    fn new(rate: Rate, normal: f64, settings: &MonitorSettings) -> Result<Self, MonitorError> {
        Ok(Self {
            rate,
            normal,
            warning: Cusum::new(normal, normal + settings.shift, settings.cusum_limit)?,
            trip: ShiryaevRoberts::new(normal, settings.false_alarm_episodes)?,
        })
    }
}

fn ticks(seconds: f64) -> u64 {
    let ticks = seconds * f64::from(RATE_HZ);
    #[allow(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "bounded on both sides")]
    if ticks.is_finite() { ticks.clamp(0.0, 9.0e15) as u64 } else { 0 }
}

const fn reason(finding: Finding) -> Reason {
    Reason::new(Dimension::Monitor, finding)
}

impl Monitor {
    /// A monitor by the profile for a version whose normal rates are `expected`, live from `now_tick`.
    ///
    /// # Errors
    /// Expected rates that are no shares, or settings no chart can be tuned with.
    pub fn new(profile: &Profile, expected: &Signature, now_tick: u64) -> Result<Self, MonitorError> {
        Self::strict(profile, expected, Strictness::PLAIN, now_tick)
    }

    /// A monitor under the conditions of an activation, for a version whose normal rates are `expected`, live from
    /// `now_tick`.
    ///
    /// # Errors
    /// Expected rates that are no shares, a factor out of range, or settings no chart can be tuned with.
    pub fn strict(
        profile: &Profile,
        expected: &Signature,
        strictness: Strictness,
        now_tick: u64,
    ) -> Result<Self, MonitorError> {
        if !(strictness.factor > 0.0 && strictness.factor <= 1.0) {
            return Err(MonitorError::Factor(strictness.factor));
        }
        let settings = profile.monitor;
        let mut charts = Vec::new();
        for rate in Rate::ALL {
            let value = rate.normal(expected, &settings);
            let allowed = value.is_finite() && value >= 0.0 && (value <= 1.0 || rate == Rate::Retry);
            if !allowed {
                return Err(MonitorError::Rate { rate: rate.name(), value });
            }
            // Room for a worse rate has to be left, whatever was measured.
            let normal_max = DEGRADED_MAX - settings.shift.min(SHIFT_MAX);
            if rate.is_manner() && value > normal_max {
                // A rate close to 1 cannot rise significantly.
                continue;
            }
            let normal = value.clamp(settings.rate_min, normal_max);
            charts.push(ControlChart::new(rate, normal, &strictness.applied(&settings))?);
        }
        Ok(Self {
            settings,
            strictness,
            unsafe_continuation_max_ms: profile.runtime.unsafe_continuation_max_ms,
            slow_over_s: (expected.time_p95_s > 0.0).then_some(settings.slow_factor * expected.time_p95_s),
            // Under tighter limits an unchanged version's live share is larger, and not measured yet: it took an honest one
            // off under `human`.
            limits: (profile.name == ProfileName::Sim).then_some(profile.harm),
            provisional_left: profile.activation.provisional_episodes,
            episodes: 0,
            charts,
            last_telemetry_tick: now_tick,
            escalation: None,
            restricted: false,
            tightened: false,
            rolled_back: false,
        })
    }

    /// Episodes left until the version is confirmed.
    #[must_use]
    pub const fn provisional_left(&self) -> u32 {
        self.provisional_left
    }

    /// Whether the provisional window passed without a trip, and nothing is open.
    #[must_use]
    pub const fn is_confirmed(&self) -> bool {
        self.provisional_left == 0 && !self.restricted && !self.rolled_back && self.escalation.is_none()
    }

    /// The escalation that waits for an answer.
    #[must_use]
    pub const fn escalation(&self) -> Option<Escalation> {
        self.escalation
    }

    /// Whether the version is restricted by this monitor.
    #[must_use]
    pub const fn is_restricted(&self) -> bool {
        self.restricted
    }

    /// Whether the version runs under a tighter envelope than it was measured under, for any reason: the effects of
    /// the envelope itself are not charted meanwhile.
    pub const fn set_tightened(&mut self, tightened: bool) {
        self.tightened = tightened;
    }

    /// How much stricter than its profile the version is monitored.
    #[must_use]
    pub const fn strictness(&self) -> Strictness {
        self.strictness
    }

    /// The version is confirmed: from now on the profile's levels apply, and charts whose levels change restart.
    ///
    /// # Errors
    /// Settings no chart can be tuned with (they were good before, so none is expected).
    pub fn confirmed(&mut self) -> Result<(), MonitorError> {
        if self.strictness.factor < 1.0 {
            for chart in &mut self.charts {
                *chart = ControlChart::new(chart.rate, chart.normal, &self.settings)?;
            }
        }
        self.strictness = Strictness::PLAIN;
        Ok(())
    }

    /// Nothing of these rates is charted any more; what trips at once is seen all the same. For experiments, which ask what a
    /// blind spot costs.
    pub fn disable_rates(&mut self, rates: &[Rate]) {
        self.charts.retain(|chart| !rates.contains(&chart.rate));
    }

    /// Every chart: the rate, what the monitor does at the limit, the statistic and its limit.
    pub fn charts(&self) -> impl Iterator<Item = (Rate, ChartLevel, f64, f64)> + '_ {
        // A chart without what it judges by is never fed: its 0 would say that nothing was past the limit.
        let (knows_harm, knows_slow) = (self.limits.is_some(), self.slow_over_s.is_some());
        let is_fed = move |rate| (rate != Rate::Harm || knows_harm) && (rate != Rate::Slow || knows_slow);
        self.charts.iter().filter(move |chart| is_fed(chart.rate)).flat_map(|chart| {
            [
                (chart.rate, ChartLevel::Warning, chart.warning.statistic(), chart.warning.threshold()),
                (chart.rate, ChartLevel::Trip, chart.trip.statistic(), chart.trip.arl()),
            ]
        })
    }

    /// Takes the values of one finished live episode and returns the action. One that a person ended says
    /// that a person stepped in and nothing else ([`Monitor::record_intervention`]).
    pub fn observe(&mut self, episode: &EpisodeValues, now_tick: u64) -> MonitorDecision {
        if !episode.is_valid() {
            return self.safety(SafetyEvent::NotANumber, now_tick);
        }
        if episode.unsafe_continuation_ms > self.unsafe_continuation_max_ms * self.strictness.factor {
            return self.safety(SafetyEvent::UnsafeContinuation, now_tick);
        }
        if episode.intervention {
            return self.record_intervention(now_tick);
        }
        self.episodes = self.episodes.saturating_add(1);
        self.provisional_left = self.provisional_left.saturating_sub(1);
        let (slow_over_s, limits, tightened) = (self.slow_over_s, self.limits, self.tightened);
        let is_judged = |rate: Rate| !(tightened && rate.follows_from_restriction());
        self.chart(
            |rate| is_judged(rate).then(|| rate.is_bad(episode, slow_over_s, limits.as_ref())),
            now_tick,
        )
    }

    /// A person stepped in: stopped the version in a task, or restricted it. Charted as an intervention and as
    /// nothing else; it is no episode of the window.
    pub fn record_intervention(&mut self, now_tick: u64) -> MonitorDecision {
        self.chart(|rate| (rate == Rate::Intervention).then_some(true), now_tick)
    }

    /// Charts one observation as good or bad and returns the action; `None` leaves a chart unchanged.
    fn chart(&mut self, is_bad: impl Fn(Rate) -> Option<bool>, now_tick: u64) -> MonitorDecision {
        let (mut trips, mut warnings) = (Vec::new(), Vec::new());
        for chart in &mut self.charts {
            let Some(bad) = is_bad(chart.rate) else { continue };
            if chart.trip.update(bad) {
                let reason = reason(Finding::RateWorse { rate: chart.rate });
                trips.push(reason.with(chart.trip.statistic(), chart.trip.arl()));
            }
            if chart.warning.update(bad) {
                let reason = reason(Finding::RateDrifts { rate: chart.rate });
                warnings.push(reason.with(chart.warning.statistic(), chart.warning.threshold()));
            }
        }
        if !trips.is_empty() {
            trips.extend(warnings);
            return self.act(MonitorAction::Rollback, trips, now_tick);
        }
        if !warnings.is_empty() && self.strictness.coupled {
            warnings.insert(0, reason(Finding::RollbackCoupled));
            return self.act(MonitorAction::Rollback, warnings, now_tick);
        }
        if !warnings.is_empty() {
            return self.act(MonitorAction::Restrict, warnings, now_tick);
        }
        self.no_action(now_tick)
    }

    /// Takes a safety event: it trips at once.
    pub fn safety(&mut self, event: SafetyEvent, now_tick: u64) -> MonitorDecision {
        self.act(MonitorAction::Rollback, vec![reason(Finding::SafetyTrip { event })], now_tick)
    }

    /// Telemetry of this tick arrived and every number in it is one.
    pub fn telemetry(&mut self, now_tick: u64) {
        self.last_telemetry_tick = self.last_telemetry_tick.max(now_tick);
    }

    /// Checks the time: silence of telemetry and expired escalations.
    pub fn tick(&mut self, now_tick: u64) -> MonitorDecision {
        if let Some(escalation) = self.escalation
            && now_tick >= escalation.deadline_tick
        {
            let unanswered = reason(Finding::EscalationUnanswered);
            return self.act(MonitorAction::Rollback, vec![unanswered], now_tick);
        }
        // A clock that runs backward is silence of unknown length.
        let silent = now_tick.checked_sub(self.last_telemetry_tick).unwrap_or(u64::MAX);
        let action = if silent >= ticks(self.settings.telemetry_restrict_ms / 1e3) {
            MonitorAction::Restrict
        } else if silent >= ticks(self.settings.telemetry_escalate_ms / 1e3) {
            MonitorAction::Escalate
        } else {
            return self.no_action(now_tick);
        };
        let silent_ms = silent as f64 * 1e3 / f64::from(RATE_HZ);
        let reason = reason(Finding::TelemetrySilent).with(silent_ms, self.settings.telemetry_escalate_ms);
        // Restricting a silent version does not end the escalation: operators still have to look.
        self.escalate(now_tick);
        self.act(action, vec![reason], now_tick)
    }

    /// When continued silence next causes an action, virtual ticks; absent if it has.
    #[must_use]
    pub fn silence_due_tick(&self) -> Option<u64> {
        if self.rolled_back || self.restricted {
            return None;
        }
        let after_ms = if self.escalation.is_some() {
            self.settings.telemetry_restrict_ms
        } else {
            self.settings.telemetry_escalate_ms
        };
        Some(self.last_telemetry_tick.saturating_add(ticks(after_ms / 1e3)))
    }

    /// An operator requests an action; it is taken as requested, with the operator's words as the reason.
    pub fn operator(&mut self, action: MonitorAction, why: &str, now_tick: u64) -> MonitorDecision {
        self.act(action, vec![reason(Finding::OperatorAsked { words: why.to_owned() })], now_tick)
    }

    /// Operators answered the escalation with "go on"; the charts restart from zero.
    ///
    /// # Errors
    /// Settings no chart can be tuned with (they were good before, so none is expected).
    pub fn on_answer(
        &mut self,
        profile: &Profile,
        expected: &Signature,
        now_tick: u64,
    ) -> Result<(), MonitorError> {
        if self.rolled_back {
            return Ok(());
        }
        self.charts = Self::strict(profile, expected, self.strictness, now_tick)?.charts;
        self.escalation = None;
        Ok(())
    }

    /// The restriction was lifted: the version runs at its full envelope, and values measured under the tighter one no
    /// longer apply. Charts and window restart; an open escalation counts as answered.
    ///
    /// # Errors
    /// As [`Monitor::on_answer`].
    pub fn on_restriction_lifted(
        &mut self,
        profile: &Profile,
        expected: &Signature,
        now_tick: u64,
    ) -> Result<(), MonitorError> {
        self.on_answer(profile, expected, now_tick)?;
        self.restricted = false;
        self.provisional_left = profile.activation.provisional_episodes;
        Ok(())
    }

    fn escalate(&mut self, now_tick: u64) {
        let deadline_tick = now_tick.saturating_add(ticks(self.settings.escalation_deadline_s));
        self.escalation.get_or_insert(Escalation { since_tick: now_tick, deadline_tick });
    }

    fn no_action(&mut self, now_tick: u64) -> MonitorDecision {
        let finding = if self.is_confirmed() { Finding::WindowPassed } else { Finding::MonitorHealthy };
        self.act(MonitorAction::Continue, vec![reason(finding)], now_tick)
    }

    /// A rollback latches: nothing later makes it less.
    fn act(&mut self, action: MonitorAction, mut reasons: Vec<Reason>, tick: u64) -> MonitorDecision {
        match action {
            MonitorAction::Continue => {}
            MonitorAction::Escalate => self.escalate(tick),
            MonitorAction::Restrict => {
                self.restricted = true;
                self.escalate(tick);
            }
            MonitorAction::Rollback => self.rolled_back = true,
        }
        let action = if self.rolled_back { MonitorAction::Rollback } else { action };
        if action == MonitorAction::Rollback && reasons.iter().all(|r| r.code == ReasonCode::MonitorHealthy) {
            reasons = vec![reason(Finding::TripHolds)];
        }
        MonitorDecision { action, reasons, tick }
    }
}
