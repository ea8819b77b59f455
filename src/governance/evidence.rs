//! Evidence: measurements, bound to a version and its circumstances.
//!
//! Plain values, raw per episode, so that every rule can be recomputed from the record. Judges nothing.

use serde::{Deserialize, Serialize};

use super::cell_ability::CellAbility;
use super::failure_cause::FailureCause;
use super::harm::HarmMeasures;
use super::ids::{CapabilityId, Digest};
use super::phase::{PhaseTallies, WorkPhase};

/// The binding of evidence. Evidence with another binding is stale.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EvidenceBinding {
    /// Digest of the candidate's manifest and bundle.
    pub candidate: Digest,
    /// The active version it was compared with; absent for a bootstrap.
    pub active: Option<Digest>,
    /// The profile with every number in it.
    pub profile: Digest,
    /// The compiled policy set.
    pub policy: Digest,
    /// Robot, scene, perturbations and engine build.
    pub environment: Digest,
    /// The versions it works beside in a sequence, and its fallback; absent where it has neither, and in evidence of older
    /// builds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub neighbours: Option<Digest>,
    /// The family's anchor, which it was compared with as well; absent where the active version is the anchor, and in
    /// evidence of older builds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub anchor: Option<Digest>,
}

crate::closed_set! {
    /// The part of a binding that has changed, which makes evidence stale.
    StaleCause, "cause of stale evidence", {
        /// The version itself is another.
        Candidate = "candidate",
        /// Another version of the family is active than the one it was compared with.
        ActiveVersion = "active-version",
        /// Another profile is in force, or a number of it is another.
        Profile = "profile",
        /// Other policies are in force.
        Policies = "policies",
        /// Robot, scene, perturbations or the build that computes episodes are others.
        Environment = "environment",
        /// Other versions are active beside it, or its fallback is another one.
        Neighbours = "team",
        /// Another version is the family's anchor.
        Anchor = "anchor",
    }
}

impl EvidenceBinding {
    /// The changed parts; empty if the evidence counts.
    #[must_use]
    pub fn stale_against(&self, now: &Self) -> Vec<StaleCause> {
        // A policy set is compiled under its profile: under another one it is another set of the same text.
        let policies = self.policy != now.policy && self.profile == now.profile;
        let all = [
            (self.candidate != now.candidate, StaleCause::Candidate),
            (self.active != now.active, StaleCause::ActiveVersion),
            (self.profile != now.profile, StaleCause::Profile),
            (policies, StaleCause::Policies),
            (self.environment != now.environment, StaleCause::Environment),
            (self.neighbours != now.neighbours, StaleCause::Neighbours),
            (self.anchor != now.anchor, StaleCause::Anchor),
        ];
        all.into_iter().filter_map(|(differs, cause)| differs.then_some(cause)).collect()
    }
}

/// The values of one episode (design rule 5.1), from physics and the watcher.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EpisodeValues {
    /// The task was done, by inspection at the end.
    pub success: bool,
    /// A measured quantity was past its limit, or the guard denied a command.
    pub violation: bool,
    /// The watcher raised a failure signal.
    pub anomaly: bool,
    /// The recovery manager took over during the episode.
    pub recovery: bool,
    /// A person stepped in during the episode.
    pub intervention: bool,
    /// The episode reached the time limit without ending itself.
    pub timeout: bool,
    /// A quantity passed the near margin of its limit (with or without passing the limit).
    pub near_violation: bool,
    /// The guard had something to say: a command clamped or refused, or a limit passed.
    #[serde(default)]
    pub policy_warning: bool,
    /// Additional attempts after a failed one, within the episode.
    pub retries: u32,
    /// Execution time, s, not negative.
    pub time_s: f64,
    /// How long motion went on after a declared failure or a stop, ms, not negative.
    pub unsafe_continuation_ms: f64,
    /// Harm to its surroundings; absent in records of older builds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub harm: Option<HarmMeasures>,
    /// Why the task failed; absent where it was done, and in records of older builds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub failure: Option<FailureCause>,
}

impl EpisodeValues {
    /// An episode that succeeds at once, in no time, with nothing wrong: what benchmarks and tests begin from.
    pub const CLEAN: Self = Self {
        success: true,
        violation: false,
        anomaly: false,
        recovery: false,
        intervention: false,
        timeout: false,
        near_violation: false,
        policy_warning: false,
        retries: 0,
        time_s: 0.0,
        unsafe_continuation_ms: 0.0,
        harm: None,
        failure: None,
    };

    /// Whether every number is one, and plausible: finite, not negative, at most 10^4 retries and 10^5 s.
    #[must_use]
    pub fn is_valid(&self) -> bool {
        (0.0..=1.0e5).contains(&self.time_s)
            && (0.0..=1.0e8).contains(&self.unsafe_continuation_ms)
            && self.retries <= 10_000
            && self.harm.is_none_or(|harm| harm.is_valid())
    }
}

/// The same episode (task, seed, disturbances) run by both versions.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Pair {
    /// Seed of the episode; no two pairs share one.
    pub seed: u64,
    /// Values of the active version's run.
    pub active: EpisodeValues,
    /// Values of the candidate's run.
    pub candidate: EpisodeValues,
    /// It has the live cell's distribution, and began where a live sequence comes to the task; not in records of older
    /// builds.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub live_like: bool,
}

crate::closed_set! {
    /// An event that the runtime must make impossible; one ends an evaluation at once.
    HardStop, "hard stop", {
        /// The code asked for something it cannot have.
        UndeclaredImport = "undeclared-import",
        /// It asked for what its own manifest does not declare, or its tool went there; the guard refused it.
        CommandPastGuard = "command-past-guard",
        /// The arm moved on after a stop.
        MotionAfterStop = "motion-after-stop",
        /// A number that is not finite came out of the code.
        NonFiniteOutput = "non-finite-output",
        /// It took more ticks or commands than it declares, or computed longer than a live arm can wait.
        BudgetBreach = "budget-breach",
    }
}

/// Paired episodes of one evaluation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PairedEvidence {
    /// Version, profile, policy and environment the episodes were run for.
    pub binding: EvidenceBinding,
    /// In the order of running, so that an early end cuts off a tail.
    pub pairs: Vec<Pair>,
    /// Hard stops seen, in order.
    pub hard_stops: Vec<HardStop>,
}

/// The episodes of a family's anchor on the seeds of a comparison.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AnchorEvidence {
    /// The anchor.
    pub version: CapabilityId,
    /// In the order of the pairs.
    pub episodes: Vec<AnchorEpisode>,
}

/// An episode of the anchor.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AnchorEpisode {
    /// Seed of the episode.
    pub seed: u64,
    /// Its values.
    pub values: EpisodeValues,
}

/// Behavior signature `B_c` with its two companions (paper section 4.3; readings X49): means per episode.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct Signature {
    /// Share of episodes in which the task was done, 0 to 1.
    pub success: f64,
    /// Mean execution time of an episode, simulated s.
    pub time_s: f64,
    /// Mean number of retries per episode.
    pub retry: f64,
    /// Share of episodes with a violation, 0 to 1.
    pub violation: f64,
    /// Share of episodes with an anomaly, 0 to 1.
    pub anomaly: f64,
    /// Share of episodes in which recovery ran.
    pub recovery: f64,
    /// Share of episodes with an intervention (not part of `kappa_B`).
    #[serde(default)]
    pub intervention: f64,
    /// Share of episodes that ran out of time; each of them counts as an anomaly too.
    #[serde(default)]
    pub timeout: f64,
    /// Share of episodes with a policy warning (not part of `kappa_B`).
    #[serde(default)]
    pub policy_warning: f64,
    /// Share of episodes in which a measured value came near its limit (not part of `kappa_B`).
    #[serde(default)]
    pub near_limit: f64,
    /// Time that at most one episode in twenty exceeds, simulated s; 0 if nothing is known of it.
    #[serde(default)]
    pub time_p95_s: f64,
}

impl Signature {
    /// Whether every share lies in [0, 1] and every mean is finite and not negative.
    #[must_use]
    pub fn is_valid(&self) -> bool {
        let shares = [
            self.success,
            self.violation,
            self.anomaly,
            self.recovery,
            self.intervention,
            self.timeout,
            self.policy_warning,
            self.near_limit,
        ];
        shares.iter().all(|share| (0.0..=1.0).contains(share))
            && [self.time_s, self.retry, self.time_p95_s].iter().all(|mean| (0.0..=1.0e5).contains(mean))
    }
}

crate::closed_set! {
    /// The four drills of design rule 3.5.
    DrillKind, "kind of drill", {
        /// The rollback target is restored with its policy state and continues.
        Rollback = "rollback",
        /// The bound fallback takes over and ends safely.
        Fallback = "fallback",
        /// Standstill in the safe pose within the declared time, without a violation.
        Abort = "abort",
        /// The watcher names the injected failure in time.
        Detect = "detect",
    }
}

/// Outcomes of the drills of one kind. A missing hook is a failed drill; one that could not be set up is infeasible.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DrillTally {
    /// Passed, read from joint speed, contact and pose.
    pub passed: u32,
    /// Feasible drills that did not pass, a missing hook included.
    pub failed: u32,
    /// Drills that could not be set up; they say nothing about the version.
    pub infeasible: u32,
    /// Of the failed ones, those that the other version passed at the same place; 0 in records of older builds.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub failed_alone: u32,
}

#[allow(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
const fn is_zero(count: &u32) -> bool {
    *count == 0
}

impl DrillTally {
    /// Drills that were carried out, passed or not.
    #[must_use]
    pub const fn feasible(&self) -> u32 {
        self.passed.saturating_add(self.failed)
    }
}

/// Tallies of the four kinds of drill, for one version.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, schemars::JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct DrillTallies {
    /// `r_rollback`: the rollback target is restored and continues.
    pub rollback: DrillTally,
    /// `r_fallback`: the declared fallback takes over and ends safely.
    pub fallback: DrillTally,
    /// `r_abort`: standstill in the safe pose within the declared time.
    pub abort: DrillTally,
    /// `r_detect`: the injected failure is named in time.
    pub detect: DrillTally,
    /// The same drills by the phase of the work in which they began.
    #[serde(default, skip_serializing_if = "PhaseTallies::is_empty")]
    #[schemars(with = "Vec<crate::phase::PhaseTally>")]
    pub phases: PhaseTallies,
}

impl DrillTallies {
    /// The tally of one kind of drill.
    #[must_use]
    pub const fn of(&self, kind: DrillKind) -> &DrillTally {
        match kind {
            DrillKind::Rollback => &self.rollback,
            DrillKind::Fallback => &self.fallback,
            DrillKind::Abort => &self.abort,
            DrillKind::Detect => &self.detect,
        }
    }

    /// The tally of one kind, to count into.
    pub const fn of_mut(&mut self, kind: DrillKind) -> &mut DrillTally {
        match kind {
            DrillKind::Rollback => &mut self.rollback,
            DrillKind::Fallback => &mut self.fallback,
            DrillKind::Abort => &mut self.abort,
            DrillKind::Detect => &mut self.detect,
        }
    }
}

/// An episode that a candidate ran alone, before the comparison.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SoloEpisode {
    /// Canonical, or adversarial.
    pub mode: SandboxMode,
    /// Its place among those of the mode, from 0: what stress there is follows from it.
    pub place: u64,
    /// Seed of the episode.
    pub seed: u64,
    /// Its values.
    pub values: EpisodeValues,
    /// The hard stop that ended the evaluation, if any.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hard_stop: Option<HardStop>,
}

/// A failed drill of the candidate, with all inputs of its re-run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FailedDrill {
    /// The kind of drill.
    pub kind: DrillKind,
    /// The phase of the work in which it began; absent: anywhere in it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub phase: Option<WorkPhase>,
    /// Seed of the episode.
    pub seed: u64,
    /// Whether the active version passed the same drill; absent where it could not be set up for it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub active: Option<bool>,
}

crate::closed_set! {
    /// Under which conditions a version is run in the sandbox.
    SandboxMode, "mode of the sandbox", {
        /// The unperturbed task.
        Canonical = "canonical",
        /// Perturbed, on the same seeds as the active version.
        Perturbation = "perturbation",
        /// Perturbed, under stress: a tighter envelope, permissions withdrawn in flight, a person where the work is.
        Adversarial = "adversarial",
        /// Perturbed, on new seeds: settles a concern.
        Confirmation = "confirmation",
    }
}

/// Drills of one kind past the base number, which settle whether the candidate fails alone.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SettlingTally {
    /// Drills of the candidate. The active version does those only where the candidate failed.
    pub alone: u32,
    /// Of them, those that the candidate failed and the active version passed.
    pub alone_failed: u32,
    /// Drills of both.
    pub paired: u32,
    /// Of them, those that the candidate alone failed.
    pub candidate_failed: u32,
    /// Of them, those that the active version alone failed.
    pub active_failed: u32,
}

/// Drills past the base number, by the kinds that are settled.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SettlingTallies {
    /// Of the rollback hook.
    pub rollback: SettlingTally,
    /// Of the safe-abort hook.
    pub abort: SettlingTally,
}

impl SettlingTallies {
    /// The tally of a kind; `None` of a kind that is not settled.
    #[must_use]
    pub const fn of(&self, kind: DrillKind) -> Option<&SettlingTally> {
        match kind {
            DrillKind::Rollback => Some(&self.rollback),
            DrillKind::Abort => Some(&self.abort),
            DrillKind::Fallback | DrillKind::Detect => None,
        }
    }

    /// The tally of a kind, to count into.
    pub const fn of_mut(&mut self, kind: DrillKind) -> Option<&mut SettlingTally> {
        match kind {
            DrillKind::Rollback => Some(&mut self.rollback),
            DrillKind::Abort => Some(&mut self.abort),
            DrillKind::Fallback | DrillKind::Detect => None,
        }
    }
}

/// The same drills done with the candidate and with the active version.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecoveryEvidence {
    /// Version, profile, policy and environment the drills were run for.
    pub binding: EvidenceBinding,
    /// Drills with the candidate in control when the fault is injected.
    pub candidate: DrillTallies,
    /// The same drills with the active version in control.
    pub active: DrillTallies,
    /// Drills past the base number; none in records of older builds.
    #[serde(default)]
    pub settling: SettlingTallies,
}

/// How a version went about its work, where nothing was violated.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Conduct {
    /// It needed a new attempt.
    pub retried: bool,
    /// The guard clamped or refused a command, or measured a limit passed.
    pub warned: bool,
    /// Share of its ticks within the profile's margin of a limit or of a keep-out zone, 0 to 1.
    pub near_share: f64,
    /// Harm to its surroundings; absent in records of older builds.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub harm: Option<HarmMeasures>,
}

/// The values of one shadow sequence: the twin (driven by the candidate) against the live world.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ShadowSequence {
    /// Seed of the disturbances both worlds shared.
    pub seed: u64,
    /// The active version did the task in the live world.
    pub live_success: bool,
    /// The candidate did it in the twin.
    pub twin_success: bool,
    /// A policy hit (denied or clamped command) in the live world.
    pub live_policy_hit: bool,
    /// A policy hit (denied or clamped command) in the twin.
    pub twin_policy_hit: bool,
    /// A watcher event in the live world.
    pub live_watcher_event: bool,
    /// A watcher event in the twin, which the candidate drives.
    pub twin_watcher_event: bool,
    /// Mean distance of the candidate's commands from the active version's on the same observations, 0 to 1 of range.
    pub output_divergence: f64,
    /// Share of the twin's trajectory outside the band of the active version's traces, 0 to 1.
    pub envelope_divergence: f64,
    /// How the active version went about it in the live world.
    #[serde(default)]
    pub live_conduct: Conduct,
    /// How the candidate went about it in the twin.
    #[serde(default)]
    pub twin_conduct: Conduct,
    /// How far the twin began from the observed state; absent where it continued from the exported one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub twin_difference: Option<TwinDifference>,
}

impl ShadowSequence {
    /// Whether every share is a number in [0, 1].
    #[must_use]
    pub fn is_valid(&self) -> bool {
        let shares = [
            self.output_divergence,
            self.envelope_divergence,
            self.live_conduct.near_share,
            self.twin_conduct.near_share,
        ];
        let harm = [self.live_conduct.harm, self.twin_conduct.harm];
        shares.iter().all(|share| (0.0..=1.0).contains(share))
            && harm.iter().flatten().all(HarmMeasures::is_valid)
            && self.twin_difference.is_none_or(|difference| difference.is_valid())
    }
}

/// How far the state of a twin, when it began, was from the observed state of the live cell.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TwinDifference {
    /// Largest difference of a joint position, rad.
    pub joints_rad: f64,
    /// Difference of the distance between the finger pads, m.
    pub width_m: f64,
    /// Distance of the object from where it was seen, m; absent where it was not seen.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub object_m: Option<f64>,
}

impl TwinDifference {
    /// Whether every value is finite and not negative.
    #[must_use]
    pub fn is_valid(&self) -> bool {
        let values = [self.joints_rad, self.width_m, self.object_m.unwrap_or_default()];
        values.iter().all(|value| value.is_finite() && *value >= 0.0)
    }
}

/// The values of one shadow sequence in a cell without a twin: outputs alone.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OutputSequence {
    /// Seed of the sequence.
    pub seed: u64,
    /// Mean distance of the candidate's commands from the active version's on the same observations, 0 to 1 of range.
    pub output_divergence: f64,
}

/// The whole sequences of one shadow deployment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ShadowEvidence {
    /// Version, profile, policy and environment of shadow.
    pub binding: EvidenceBinding,
    /// In the order of running.
    pub sequences: Vec<ShadowSequence>,
    /// Hard stops seen in the twin or the live world, in order; one fails shadow.
    pub hard_stops: Vec<HardStop>,
    /// The sequences of a cell without a twin, in the order of running; `sequences` is empty then.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub outputs: Vec<OutputSequence>,
    /// Abilities of the cell that shadow lacked.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub missing: Vec<CellAbility>,
}
