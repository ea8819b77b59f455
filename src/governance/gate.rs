//! `theta_act`: may this candidate become active, and how?
//!
//! Owns the typed pass that activation needs; nothing else can make one. Reads measured values only.
//! Source: paper equation 10, Table 4, section 5.2 stage 5; design rule 3.7.

mod outputs_alone;
mod terms;

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

use super::ablation::{AblatedParts, AblationPart};
pub use super::alignment::Alignment;
use super::approval::{ApprovalOutcome, ApprovalResult, Requester};
use super::composition::{Kappas, recovery_is_reviewable};
use super::condition::{self, Condition};
use super::decision::{
    Decision, DecisionAnswers, DecisionContext, DecisionMonitoring, DecisionRollback, Dimension, Reason,
    ReasonCode,
};
use super::deployability::Deployability;
use super::evidence::{Conduct, EvidenceBinding, ShadowEvidence, ShadowSequence};
use super::finding::{EvidenceGap, Finding, TwinSignal};
pub use super::outcome::GateOutcome;
use super::outcome::{ActivationMode, Basis, CheckResult};
use super::policy::PolicyTable;
use super::profile::{FreezeWindow, Profile, ProfileName};
use super::strictness::Strictness;
use super::submission::{Provenance, Risk};
use super::wall_time::{ClockMismatch, WallTime};
use crate::stats::{self, PairedCounts};

/// Result of the shadow comparison `Delta_shadow`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ShadowAssessment {
    /// Pass, fail, inconclusive (lengthen shadow) or no data.
    pub check: CheckResult,
    /// Why, the deciding reason first.
    pub reasons: Vec<Reason>,
    /// Sequences the comparison rests on.
    pub sequences: u32,
    /// Mean distance of the candidate's commands from the active version's, 0 to 1 of range; absent without data.
    pub output_divergence: Option<f64>,
    /// Mean share of the twin's trajectory outside the active version's band, 0 to 1; absent without data.
    pub envelope_divergence: Option<f64>,
    /// The agreement of leaving the active version's band with the watcher's events.
    pub alignment: Option<Alignment>,
}

/// How many sequences more with a signal in the twin than in the live world make shadow longer: one may be chance.
const LEAN_FROM: u64 = 2;

/// How a version goes about its work, read from one side of a sequence.
type ConductFlag = fn(&Conduct) -> bool;

/// The compared conduct of the two sides. It is no violation, so it lengthens shadow and rejects nothing.
const CONDUCT: [(TwinSignal, ConductFlag); 2] =
    [(TwinSignal::Retry, |conduct| conduct.retried), (TwinSignal::PolicyWarning, |conduct| conduct.warned)];

const fn net_of(pairs: PairedCounts) -> u64 {
    pairs.candidate_only.saturating_sub(pairs.active_only)
}

const fn shadow_reason(finding: Finding) -> Reason {
    Reason::new(Dimension::Shadow, finding)
}

fn leans(signal: TwinSignal, net: u64) -> Reason {
    shadow_reason(Finding::SignalLeans { signal }).with(net as f64, LEAN_FROM as f64)
}

/// The worse shadow signal of a reason, if any. In a record of an older build the sentence begins with it.
#[must_use]
pub fn worse_signal(reason: &Reason) -> Option<TwinSignal> {
    match (&reason.finding, reason.code) {
        (Some(Finding::SignalWorse { signal }), _) => Some(*signal),
        (None, ReasonCode::ShadowGovernanceDivergence) => match reason.older_text.split(' ').next()? {
            "policy" => Some(TwinSignal::PolicyHit),
            "failures" => Some(TwinSignal::Failure),
            "watcher" => Some(TwinSignal::WatcherEvent),
            _ => None,
        },
        (Some(_) | None, _) => None,
    }
}

/// `Delta_shadow`: a significant worsening in the twin decides, by a paired lower bound: regressions of success,
/// policy hits, watcher events. Output and envelope divergence, a signal that leans toward worse, and conduct (more
/// new attempts, more policy warnings, more time near a limit) only lengthen it (design rules 3.7, 5.4).
///
/// A measure of harm that is significantly worse beyond its margin fails it as well. Where the cell has no twin, the
/// profile says whether outputs alone are enough.
///
/// `shadow_alpha` is shared by the three signals, the measures of harm and the two looks (after the plain and after the longest
/// shadow), so that an equally good candidate fails with probability at most `shadow_alpha`.
#[must_use]
pub fn assess_shadow(
    evidence: &ShadowEvidence,
    current: &EvidenceBinding,
    profile: &Profile,
) -> ShadowAssessment {
    let settings = &profile.evaluation;
    let count = u32::try_from(evidence.sequences.len()).unwrap_or(u32::MAX);
    let done = |check, mut reasons: Vec<Reason>, output: Option<f64>, envelope: Option<f64>| {
        reasons.extend(outputs_alone::observed_twin(&evidence.sequences));
        ShadowAssessment {
            check,
            reasons,
            sequences: count,
            output_divergence: output,
            envelope_divergence: envelope,
            alignment: envelope.map(|_| Alignment::of(&evidence.sequences, settings.envelope_divergence_max)),
        }
    };
    let no_data =
        |gap| done(CheckResult::NoData, vec![shadow_reason(Finding::ShadowGap { gap })], None, None);
    if evidence.binding != *current {
        return no_data(EvidenceGap::OtherBinding);
    }
    if let Some(stop) = evidence.hard_stops.first() {
        let hard = shadow_reason(Finding::ShadowHardStop { stop: *stop });
        return done(CheckResult::Fail, vec![hard], None, None);
    }
    if !evidence.outputs.is_empty() {
        return outputs_alone::assess(evidence, profile);
    }
    if evidence.sequences.is_empty() || !evidence.sequences.iter().all(ShadowSequence::is_valid) {
        return no_data(EvidenceGap::NoEpisodes);
    }
    let seeds: BTreeSet<u64> = evidence.sequences.iter().map(|sequence| sequence.seed).collect();
    if seeds.len() != evidence.sequences.len() {
        return no_data(EvidenceGap::RepeatedSeed);
    }
    let mean = |value: fn(&ShadowSequence) -> f64| {
        evidence.sequences.iter().map(value).sum::<f64>() / f64::from(count.max(1))
    };
    let (output, envelope) = (mean(|s| s.output_divergence), mean(|s| s.envelope_divergence));
    let mut reasons = Vec::new();
    let mut leaning = Vec::new();
    let paired =
        |sides: fn(&ShadowSequence) -> (bool, bool)| PairedCounts::of(evidence.sequences.iter().map(sides));
    let signals = [
        (TwinSignal::Failure, paired(|s| (!s.twin_success, !s.live_success))),
        (TwinSignal::PolicyHit, paired(|s| (s.twin_policy_hit, s.live_policy_hit))),
        (TwinSignal::WatcherEvent, paired(|s| (s.twin_watcher_event, s.live_watcher_event))),
    ];
    // The signals share the error rate, and so do the two looks: at the plain length, and once more at the longest.
    // Where harm was measured a share of it is for the measures of harm, which have tolerances besides.
    let harm_alpha = settings.shadow_harm_share * settings.shadow_alpha;
    let measured = evidence.sequences.iter().any(|s| s.twin_conduct.harm.is_some());
    let signals_alpha = settings.shadow_alpha - if measured { harm_alpha } else { 0.0 };
    let each = signals_alpha / (2.0 * signals.len() as f64);
    for (signal, pairs) in signals {
        let Ok(bound) = stats::binary_pairs(pairs, each) else {
            return no_data(EvidenceGap::SignalUnbounded);
        };
        let net = net_of(pairs);
        if bound.lower > 0.0 {
            reasons.push(shadow_reason(Finding::SignalWorse { signal }).with(bound.lower, 0.0));
        } else if net >= LEAN_FROM {
            leaning.push(leans(signal, net));
        }
    }
    reasons.extend(super::behavior::in_shadow(&evidence.sequences, harm_alpha / 2.0, profile));
    for (signal, of) in CONDUCT {
        let sides = evidence.sequences.iter().map(|s| (of(&s.twin_conduct), of(&s.live_conduct)));
        let net = net_of(PairedCounts::of(sides));
        if net >= LEAN_FROM {
            leaning.push(leans(signal, net));
        }
    }
    if !reasons.is_empty() {
        return done(CheckResult::Fail, reasons, Some(output), Some(envelope));
    }
    reasons.append(&mut leaning);
    for (finding, found, limit) in [
        (Finding::OutputsDiffer, output, settings.output_divergence_max),
        (Finding::EnvelopeLeft, envelope, settings.envelope_divergence_max),
        (
            Finding::NearLimitsMore,
            mean(|s| s.twin_conduct.near_share) - mean(|s| s.live_conduct.near_share),
            settings.near_divergence_max,
        ),
    ] {
        if found > limit {
            reasons.push(shadow_reason(finding).with(found, limit));
        }
    }
    let needed = if reasons.is_empty() { settings.shadow_sequences } else { settings.shadow_sequences_max };
    if count < needed {
        let few = shadow_reason(Finding::MoreSequencesNeeded).with(f64::from(count), f64::from(needed));
        reasons.push(few);
        return done(CheckResult::Inconclusive, reasons, Some(output), Some(envelope));
    }
    reasons.push(shadow_reason(Finding::ShadowClean));
    done(CheckResult::Pass, reasons, Some(output), Some(envelope))
}

/// Everything `theta_act` looks at: measured values, bindings, answers and the circumstances of now.
#[derive(Clone, Copy, Debug)]
pub struct GateInput<'a> {
    /// The four assessments; B and R measured.
    pub kappas: &'a Kappas,
    /// The shadow result; absent if it did not run.
    pub shadow: Option<&'a ShadowAssessment>,
    /// The binding of each piece of evidence.
    pub bindings: &'a [EvidenceBinding],
    /// The required binding.
    pub current: &'a EvidenceBinding,
    /// Whether success is significantly better (see [`super::behavior::BehaviorAssessment::improved`]).
    pub improved: bool,
    /// The combined approvals; absent before a request.
    pub approval: Option<&'a ApprovalResult>,
    /// Risk class of the candidate; high needs a safety officer among the approvals.
    pub risk: Risk,
    /// The requester of the registration.
    pub requester: &'a Requester,
    /// How the version came about; site policies may forbid a risk tier of one provenance.
    pub provenance: Provenance,
    /// Profiles under which a profile demotion blocks this version.
    pub blocked_under: &'a BTreeSet<ProfileName>,
    /// Dependencies that no active version meets.
    pub unmet: &'a [String],
    /// A break-glass review of the family is open.
    pub review_open: bool,
    /// Whether the profile is authorized as this program has it, or needs no authorization.
    pub profile_authorized: bool,
    /// Wall time of the decision, for freeze windows and approvals.
    pub now: WallTime,
    /// The clock mismatch, if any; nothing is activated before a person has confirmed the time.
    pub clock_doubt: Option<ClockMismatch>,
    /// The candidate's row version at the decision; the pass is valid for no other.
    pub row_version: u64,
    /// Digests of the circumstances of now; they must be the evidence's.
    pub made_under: DecisionContext,
    /// The parts that an experiment omits: they are not required, and the decision states it.
    pub omitted: AblatedParts,
}

/// How a version is active once the gate is passed (paper table 4).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GateTerms {
    /// The modes that hold together; `Full` only alone.
    pub modes: BTreeSet<ActivationMode>,
    /// Conditions of use the guard and the monitor enforce while the version is active, without repetition.
    pub conditions: Vec<Condition>,
    /// Live episodes until it is confirmed, from the profile.
    pub provisional_episodes: u32,
}

/// Proof that the gate was passed: only [`evaluate`] makes it, and it cannot be read from a file.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GatePassed {
    terms: GateTerms,
    row_version: u64,
    made_under: DecisionContext,
    until: Option<WallTime>,
}

impl GatePassed {
    /// How the version is to be active.
    #[must_use]
    pub const fn terms(&self) -> &GateTerms {
        &self.terms
    }

    /// Digests of the circumstances; the pass is void when one of them changes.
    #[must_use]
    pub const fn made_under(&self) -> &DecisionContext {
        &self.made_under
    }

    /// Whether it is still valid: same row version, same circumstances, approvals not expired.
    #[must_use]
    pub fn holds(&self, row_version: u64, made_under: &DecisionContext, now: WallTime) -> bool {
        self.row_version == row_version
            && self.made_under == *made_under
            && self.until.is_none_or(|until| now < until)
    }
}

/// The gate's decision, and the pass if there is one.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GateResult {
    /// The gate's outcome with its reasons and the four answers.
    pub decision: Decision<GateOutcome>,
    /// The pass that activation needs; present exactly with [`GateOutcome::Pass`].
    pub passed: Option<GatePassed>,
}

/// Whether a dimension asks for a review, so that the review's quorum is needed.
#[must_use]
pub fn needs_review(kappas: &Kappas, profile: &Profile) -> bool {
    let policy: CheckResult = kappas.policy.outcome.into();
    policy == CheckResult::Review || (profile.has_approver() && recovery_is_reviewable(&kappas.recovery))
}

/// Distinct people who have to approve an activation: by the profile and the risk tier, by a review that a dimension
/// asks for, by a condition, and by a site policy that reviews activations; at least the most of these.
#[must_use]
pub fn people_needed(
    kappas: &Kappas,
    (risk, provenance): (Risk, Provenance),
    table: &PolicyTable,
    profile: &Profile,
) -> u8 {
    let review = needs_review(kappas, profile);
    let required = super::approval::quorum(&profile.approval, risk, review);
    let site =
        table.activation_reviewed(risk, provenance).map_or(0, |_| profile.approval.quorum_review.max(1));
    required.max(site).max(condition::people_needed(&kappas.conditions()))
}

/// `theta_act(kappas, S, Delta_shadow, Gamma)` (paper equation 10).
#[must_use]
pub fn evaluate(input: &GateInput<'_>, table: &PolicyTable, profile: &Profile) -> GateResult {
    let mut found = GateFindings::default();
    found.dimensions(input, profile);
    found.evidence(input);
    if input.omitted.has(AblationPart::Shadow) {
        found.noted.push(AblatedParts::skip_reason(Dimension::Shadow));
    } else {
        found.shadow(input.shadow, condition::shadow_needed(&input.kappas.conditions()));
    }
    found.rules(input, table, profile);
    let quorum = people_needed(input.kappas, (input.risk, input.provenance), table, profile);
    let glass = found.approvals(input.approval, quorum);
    if glass {
        found.overrule();
    }
    found.conclude(input, profile, quorum, glass)
}

#[derive(Default)]
struct GateFindings {
    reject: Vec<Reason>,
    demote: Vec<Reason>,
    hold: Vec<Reason>,
    await_approval: Vec<Reason>,
    noted: Vec<Reason>,
    until: Option<WallTime>,
}

const fn reason(finding: Finding) -> Reason {
    Reason::new(Dimension::Gate, finding)
}

impl GateFindings {
    fn dimensions(&mut self, input: &GateInput<'_>, profile: &Profile) {
        let kappas = input.kappas;
        for (dimension, check) in kappas.checks() {
            if input.omitted.covers(dimension) {
                self.noted.push(AblatedParts::skip_reason(dimension));
                continue;
            }
            let of = dimension;
            let waived = dimension == Dimension::Recovery
                && needs_review(kappas, profile)
                && recovery_is_reviewable(&kappas.recovery);
            match check {
                // A review is settled by the approvals, whose quorum counts it.
                CheckResult::Pass | CheckResult::PassRestricted(_) | CheckResult::Review => {}
                CheckResult::Fail if waived => {}
                CheckResult::Fail => {
                    self.reject.push(reason(Finding::DimensionIncompatible { of }));
                }
                CheckResult::Inconclusive | CheckResult::NoData => {
                    self.demote.push(reason(Finding::DimensionInconclusive { of }));
                }
                CheckResult::Skipped => {
                    self.demote.push(reason(Finding::DimensionSkipped { of }));
                }
            }
        }
        let review_without_approver =
            CheckResult::from(kappas.policy.outcome) == CheckResult::Review && !profile.has_approver();
        if review_without_approver {
            self.reject.push(reason(Finding::ReviewWithoutApprover));
        }
        let values = [
            (Dimension::Interface, kappas.interface.basis, kappas.interface.kappa),
            (Dimension::Policy, kappas.policy.basis, kappas.policy.kappa),
            (Dimension::Behavior, kappas.behavior.basis, kappas.behavior.kappa),
            (Dimension::Recovery, kappas.recovery.basis, kappas.recovery.kappa),
        ];
        for (of, basis, value) in values.into_iter().filter(|value| !input.omitted.covers(value.0)) {
            if basis == Basis::Estimated {
                self.demote.push(reason(Finding::NotMeasured { of }));
            }
            if value.is_none() {
                self.demote.push(reason(Finding::NoValue { of }));
            }
        }
    }

    fn evidence(&mut self, input: &GateInput<'_>) {
        if input.bindings.is_empty() {
            self.demote.push(reason(Finding::NoEvidence));
        }
        if input.bindings.iter().any(|binding| binding != input.current) {
            self.demote.push(reason(Finding::EvidenceStale));
        }
        let (under, now) = (&input.made_under, input.current);
        let same = under.candidate == now.candidate
            && under.active == now.active
            && under.policy == now.policy
            && under.profile == now.profile
            && under.environment == now.environment
            && under.neighbours == now.neighbours
            && under.anchor == now.anchor;
        if !same {
            self.demote.push(reason(Finding::CircumstancesDiffer));
        }
    }

    fn shadow(&mut self, shadow: Option<&ShadowAssessment>, needed: u32) {
        let Some(shadow) = shadow else {
            self.demote.push(reason(Finding::ShadowNotRun));
            return;
        };
        if shadow.check == CheckResult::Pass && shadow.sequences < needed {
            let short = reason(Finding::ShadowTooShort);
            self.demote.push(short.with(f64::from(shadow.sequences), f64::from(needed)));
        }
        let list = match shadow.check {
            CheckResult::Pass => &mut self.noted,
            CheckResult::Fail => {
                self.reject.push(reason(Finding::ShadowFailed));
                &mut self.reject
            }
            CheckResult::PassRestricted(_)
            | CheckResult::Review
            | CheckResult::Inconclusive
            | CheckResult::NoData
            | CheckResult::Skipped => {
                self.demote.push(reason(Finding::ShadowInconclusive));
                &mut self.demote
            }
        };
        list.extend(shadow.reasons.iter().cloned());
    }

    fn rules(&mut self, input: &GateInput<'_>, table: &PolicyTable, profile: &Profile) {
        if table.profile != profile.name || table.digest != input.made_under.policy {
            self.demote.push(reason(Finding::PoliciesDiffer));
        }
        if let Some(because) = table.activation_forbidden(input.risk, input.provenance) {
            self.reject.push(reason(Finding::SitePolicyForbids { because: because.clone() }));
        }
        if input.blocked_under.contains(&profile.name) {
            self.hold.push(reason(Finding::ProfileBlocked { profile: profile.name }));
        }
        if !input.unmet.is_empty() {
            let dependencies = input.unmet.to_vec();
            self.hold.push(reason(Finding::DependenciesNotActive { dependencies }));
        }
        let needs_people = people_needed(input.kappas, (input.risk, input.provenance), table, profile) > 0;
        let strict = profile.name.is_beside_people() || (profile.name.is_at_risk() && needs_people);
        if *input.requester == Requester::Unknown && strict {
            self.hold.push(reason(Finding::RequesterUnknown));
        }
        if input.review_open {
            self.hold.push(reason(Finding::ReviewOpen));
        }
        if !input.profile_authorized {
            self.hold.push(reason(Finding::ProfileUnauthorized));
        }
        if let Some(FreezeWindow { until, reason: why, .. }) = profile.frozen_at(input.now) {
            self.hold.push(reason(Finding::Frozen { until: *until, reason: why.clone() }));
        }
        if let Some(mismatch) = input.clock_doubt {
            self.hold.push(reason(Finding::ClockMismatched { mismatch }));
        }
        if input.kappas.conditions().contains(&Condition::SimulationOnly) && profile.name != ProfileName::Sim
        {
            self.reject.push(reason(Finding::NotASimulation { profile: profile.name }));
        }
        match (profile.activation.require_improvement, input.improved) {
            (true, false) => self.demote.push(reason(Finding::NoImprovement)),
            (false, false) => self.noted.push(reason(Finding::ImprovementWaived)),
            (true | false, true) => self.noted.push(reason(Finding::Improved)),
        }
    }

    /// Whether the approval is a break-glass one.
    fn approvals(&mut self, approval: Option<&ApprovalResult>, quorum: u8) -> bool {
        if quorum == 0 && !approval.is_some_and(ApprovalResult::is_emergency) {
            return false;
        }
        let Some(approval) = approval else {
            self.await_approval.push(reason(Finding::NotAskedYet));
            return false;
        };
        let mut glass = false;
        // Each line gives a reason of the gate's own: it never rests on the reasons handed in.
        let (list, own) = match &approval.outcome {
            ApprovalOutcome::Granted { people, break_glass, until } => {
                self.until = Some(*until);
                glass = *break_glass;
                if people.len() < usize::from(quorum) && !glass {
                    (&mut self.await_approval, reason(Finding::QuorumNotReached))
                } else {
                    (&mut self.noted, reason(Finding::ApprovalsPresent))
                }
            }
            // The approval is missing although one is needed: the request was made under other rules.
            ApprovalOutcome::NotNeeded | ApprovalOutcome::Pending { .. } => {
                (&mut self.await_approval, reason(Finding::ApprovalsMissing))
            }
            ApprovalOutcome::TimedOut => (&mut self.hold, reason(Finding::AnsweredTooLate)),
            ApprovalOutcome::Refused { person } => {
                // The reason given is with the answer, among the reasons handed in.
                let refused = Finding::Refused { person: person.clone(), reason: String::new() };
                (&mut self.reject, reason(refused))
            }
        };
        list.push(own);
        list.extend(approval.reasons.iter().cloned());
        glass
    }

    /// An emergency approval overrules what people or the calendar hold a version for, and nothing that was
    /// measured; a review that is open holds all the same.
    fn overrule(&mut self) {
        let (stays, overruled): (Vec<_>, Vec<_>) =
            std::mem::take(&mut self.hold).into_iter().partition(|reason| {
                !matches!(reason.code, ReasonCode::GateFrozen | ReasonCode::GateProfileClosed)
            });
        self.hold = stays;
        self.noted.extend(overruled);
    }

    fn conclude(self, input: &GateInput<'_>, profile: &Profile, quorum: u8, glass: bool) -> GateResult {
        let outcome = if !self.reject.is_empty() {
            GateOutcome::Reject
        } else if !self.demote.is_empty() {
            GateOutcome::Demote
        } else if !self.hold.is_empty() {
            GateOutcome::Hold
        } else if !self.await_approval.is_empty() {
            GateOutcome::AwaitApproval
        } else {
            GateOutcome::Pass
        };
        let terms = terms::terms(input.kappas, profile, quorum, glass);
        let mut reasons = self.reject;
        for list in [self.demote, self.hold, self.await_approval] {
            reasons.extend(list);
        }
        if outcome == GateOutcome::Pass {
            reasons.push(reason(Finding::GatePassed));
        }
        reasons.extend(self.noted);
        let watch = Strictness::of(&terms.conditions);
        let answers = DecisionAnswers {
            admitted: outcome == GateOutcome::Pass,
            conditions: terms.conditions.clone(),
            monitoring: DecisionMonitoring::Charts.into(),
            rollback_when: if watch.coupled {
                DecisionRollback::FirstWarning.into()
            } else {
                DecisionRollback::EstablishedWorsening.into()
            },
            deployment: Some(Deployability::of_gate(outcome, &terms.modes)),
        };
        let passed = (outcome == GateOutcome::Pass).then_some(GatePassed {
            terms,
            row_version: input.row_version,
            made_under: input.made_under,
            until: self.until,
        });
        GateResult { decision: Decision::new(outcome, reasons, answers, &input.made_under), passed }
    }
}
