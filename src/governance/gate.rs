//! `theta_act`: may this candidate become active, and how?
//!
//! Owns the typed pass that activation needs; nothing else can make one. Reads measured values only.
//! Source: paper equation 10, Table 4, section 5.2 stage 5; design rule 3.7.

mod terms;

use std::collections::BTreeSet;

use serde::{Deserialize, Serialize};

pub use super::alignment::Alignment;
use super::approval::{ApprovalOutcome, ApprovalResult, Requester};
use super::composition::{Kappas, recovery_is_reviewable};
use super::condition::{self, Condition};
use super::decision::{Answers, Decision, Dimension, MadeUnder, Reason, ReasonCode};
use super::evidence::{Binding, Conduct, ShadowEvidence, ShadowSequence};
use super::omitted::{Omitted, Part};
pub use super::outcome::GateOutcome;
use super::outcome::{ActivationMode, Basis, Check};
use super::policy::PolicyTable;
use super::profile::{FreezeWindow, Profile, ProfileName};
use super::strictness::Strictness;
use super::submission::{Provenance, Risk};
use super::vocabulary;
use super::wall_time::{ClockDoubt, WallTime};
use crate::stats::{self, PairedCounts};

/// Result of the shadow comparison `Delta_shadow`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ShadowAssessment {
    /// Pass, fail, inconclusive (lengthen shadow) or no data.
    pub check: Check,
    /// Why, the deciding reason first.
    pub reasons: Vec<Reason>,
    /// Sequences the comparison rests on.
    pub sequences: u32,
    /// Mean distance of the candidate's commands from the active version's, 0 to 1 of range; absent without data.
    pub output_divergence: Option<f64>,
    /// Mean share of the twin's trajectory outside the active version's band, 0 to 1; absent without data.
    pub envelope_divergence: Option<f64>,
    /// How far leaving the active version's band and the watcher's word go together.
    pub alignment: Option<Alignment>,
}

/// How many sequences more with a signal in the twin than in the live world make shadow longer: one may be chance.
const LEAN_FROM: u64 = 2;

/// The share of `shadow_alpha` that the measures of harm have.
const HARM_SHARE: f64 = 0.1;

/// How a version goes about its work, read from one side of a sequence.
type ConductFlag = fn(&Conduct) -> bool;

/// What is compared of the two sides' conduct. No violation, so it makes shadow longer and rejects nothing.
const CONDUCT: [(&str, ConductFlag); 2] =
    [("new attempts", |conduct| conduct.retried), ("policy warnings", |conduct| conduct.warned)];

const fn net_of(pairs: PairedCounts) -> u64 {
    pairs.candidate_only.saturating_sub(pairs.active_only)
}

fn leans(what: &str, net: u64) -> Reason {
    let text = format!("{what} lean towards more than under the active version");
    Reason::new(ReasonCode::ShadowLeaning, Dimension::Shadow, text).with(net as f64, LEAN_FROM as f64)
}

/// `Delta_shadow`: what is established as worse in the twin decides, by a paired lower bound: regressions of
/// success, policy hits, watcher events. Output and envelope divergence, a signal that leans towards worse, and
/// conduct (more new attempts, more policy warnings, more time near a limit) only lengthen it (design rules 3.7, 5.4).
///
/// A measure of harm that is established as worse beyond its tolerance fails it as well.
///
/// `shadow_alpha` is shared by the three signals, the measures of harm and the two looks (after the plain and after the longest
/// shadow), so that an equally good candidate fails with probability at most `shadow_alpha`.
#[must_use]
pub fn assess_shadow(evidence: &ShadowEvidence, current: &Binding, profile: &Profile) -> ShadowAssessment {
    let settings = &profile.evaluation;
    let count = u32::try_from(evidence.sequences.len()).unwrap_or(u32::MAX);
    let reason = |code, text: &str| Reason::new(code, Dimension::Shadow, text);
    let done = |check, reasons, output: Option<f64>, envelope: Option<f64>| ShadowAssessment {
        check,
        reasons,
        sequences: count,
        output_divergence: output,
        envelope_divergence: envelope,
        alignment: envelope.map(|_| Alignment::of(&evidence.sequences, settings.envelope_divergence_max)),
    };
    let no_data = |text| done(Check::NoData, vec![reason(ReasonCode::ShadowNoData, text)], None, None);
    if evidence.binding != *current {
        return no_data("shadow was worked for another version, profile, policy or environment");
    }
    if let Some(stop) = evidence.hard_stops.first() {
        let hard = reason(ReasonCode::GateHardLimit, &format!("{} was seen", stop.name()));
        return done(Check::Fail, vec![hard], None, None);
    }
    if evidence.sequences.is_empty() || !evidence.sequences.iter().all(ShadowSequence::is_valid) {
        return no_data("no usable sequences");
    }
    let seeds: BTreeSet<u64> = evidence.sequences.iter().map(|sequence| sequence.seed).collect();
    if seeds.len() != evidence.sequences.len() {
        return no_data("a seed occurs twice");
    }
    let mean = |value: fn(&ShadowSequence) -> f64| {
        evidence.sequences.iter().map(value).sum::<f64>() / f64::from(count.max(1))
    };
    let (output, envelope) = (mean(|s| s.output_divergence), mean(|s| s.envelope_divergence));
    let mut reasons = Vec::new();
    let mut leaning = Vec::new();
    let signals = [
        (
            "failures of the task",
            PairedCounts::of(evidence.sequences.iter().map(|s| (!s.twin_success, !s.live_success))),
        ),
        (
            "policy hits",
            PairedCounts::of(evidence.sequences.iter().map(|s| (s.twin_policy_hit, s.live_policy_hit))),
        ),
        (
            "watcher events",
            PairedCounts::of(evidence.sequences.iter().map(|s| (s.twin_watcher_event, s.live_watcher_event))),
        ),
    ];
    // The signals share the error rate, and so do the two looks: at the plain length, and once more at the longest.
    // Where harm was measured a tenth of it is for the measures of harm, which have tolerances besides.
    let harm_alpha = HARM_SHARE * settings.shadow_alpha;
    let measured = evidence.sequences.iter().any(|s| s.twin_conduct.harm.is_some());
    let signals_alpha = settings.shadow_alpha - if measured { harm_alpha } else { 0.0 };
    let each = signals_alpha / (2.0 * signals.len() as f64);
    for (what, pairs) in signals {
        let Ok(bound) = stats::binary_pairs(pairs, each) else {
            return no_data("the signals cannot be bounded");
        };
        let net = net_of(pairs);
        if bound.lower > 0.0 {
            let text = format!("{what} are established as more frequent than under the active version");
            reasons.push(reason(ReasonCode::ShadowGovernanceDivergence, &text).with(bound.lower, 0.0));
        } else if net >= LEAN_FROM {
            leaning.push(leans(what, net));
        }
    }
    reasons.extend(super::behavior::in_shadow(&evidence.sequences, harm_alpha / 2.0, profile));
    for (what, of) in CONDUCT {
        let sides = evidence.sequences.iter().map(|s| (of(&s.twin_conduct), of(&s.live_conduct)));
        let net = net_of(PairedCounts::of(sides));
        if net >= LEAN_FROM {
            leaning.push(leans(what, net));
        }
    }
    if !reasons.is_empty() {
        return done(Check::Fail, reasons, Some(output), Some(envelope));
    }
    reasons.append(&mut leaning);
    for (code, text, found, limit) in [
        (ReasonCode::ShadowOutputDivergence, "the outputs differ", output, settings.output_divergence_max),
        (
            ReasonCode::ShadowEnvelopeDivergence,
            "the twin leaves the active version's band",
            envelope,
            settings.envelope_divergence_max,
        ),
        (
            ReasonCode::ShadowLeaning,
            "the twin is nearer to its limits for more of its time",
            mean(|s| s.twin_conduct.near_share) - mean(|s| s.live_conduct.near_share),
            settings.near_divergence_max,
        ),
    ] {
        if found > limit {
            reasons.push(reason(code, text).with(found, limit));
        }
    }
    let needed = if reasons.is_empty() { settings.shadow_sequences } else { settings.shadow_sequences_max };
    if count < needed {
        let few = reason(ReasonCode::ShadowNoData, "more sequences are needed")
            .with(f64::from(count), f64::from(needed));
        reasons.push(few);
        return done(Check::Inconclusive, reasons, Some(output), Some(envelope));
    }
    reasons.push(reason(ReasonCode::ShadowClean, "no governance signal is established as more frequent"));
    done(Check::Pass, reasons, Some(output), Some(envelope))
}

/// Everything `theta_act` looks at: measured values, bindings, answers and the circumstances of now.
#[derive(Clone, Copy, Debug)]
pub struct GateInput<'a> {
    /// The four assessments; B and R measured.
    pub kappas: &'a Kappas,
    /// What shadow came to; absent if it was not worked.
    pub shadow: Option<&'a ShadowAssessment>,
    /// What each piece of evidence was gathered for.
    pub bindings: &'a [Binding],
    /// What it has to be bound to now.
    pub current: &'a Binding,
    /// Whether better success is established (see [`super::behavior::BehaviorAssessment::improved`]).
    pub improved: bool,
    /// What people answered, taken together; absent if nobody was asked yet.
    pub approval: Option<&'a ApprovalResult>,
    /// Risk class of the candidate; high needs a safety officer among the approvals.
    pub risk: Risk,
    /// Who registered the candidate.
    pub requester: &'a Requester,
    /// How the version came about; site policies may forbid a risk tier of one provenance.
    pub provenance: Provenance,
    /// Profiles closed to this version by a profile demotion.
    pub closed: &'a BTreeSet<ProfileName>,
    /// Dependencies that no active version meets.
    pub unmet: &'a [String],
    /// A break-glass review of the family is open.
    pub review_open: bool,
    /// Whether the profile is in force as this program has it: an administrator authorized it, or nobody has to.
    pub profile_authorized: bool,
    /// Wall time of the decision; freeze windows and approvals are held against it.
    pub now: WallTime,
    /// Why the machine's clock is not believed, if so; nothing is activated before a person has confirmed the time.
    pub clock_doubt: Option<ClockDoubt>,
    /// The candidate's row version at the decision; the pass holds for no other.
    pub row_version: u64,
    /// Digests of the circumstances of now; they must be the evidence's.
    pub made_under: MadeUnder,
    /// What an experiment leaves out: nothing is demanded of it, and the decision says so.
    pub omitted: Omitted,
}

/// How a version is active once the gate is passed (paper table 4).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Terms {
    /// The modes that hold together; `Full` only alone.
    pub modes: BTreeSet<ActivationMode>,
    /// Conditions of use the guard and the monitor enforce while the version is active, without repetition.
    pub conditions: Vec<Condition>,
    /// Live episodes until it is confirmed, from the profile.
    pub provisional_episodes: u32,
}

/// Proof that the gate was passed: made by [`evaluate`] alone, and not readable from a file.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GatePassed {
    terms: Terms,
    row_version: u64,
    made_under: MadeUnder,
    until: Option<WallTime>,
}

impl GatePassed {
    /// How the version is to be active.
    #[must_use]
    pub const fn terms(&self) -> &Terms {
        &self.terms
    }

    /// Digests of the circumstances; the pass is void when one of them changes.
    #[must_use]
    pub const fn made_under(&self) -> &MadeUnder {
        &self.made_under
    }

    /// Whether it still holds: same row version, same circumstances, approvals not expired.
    #[must_use]
    pub fn holds(&self, row_version: u64, made_under: &MadeUnder, now: WallTime) -> bool {
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
    let policy: Check = kappas.policy.outcome.into();
    policy == Check::Review || (profile.has_approver() && recovery_is_reviewable(&kappas.recovery))
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
    let asked = super::approval::quorum(&profile.approval, risk, review);
    let site =
        table.activation_reviewed(risk, provenance).map_or(0, |_| profile.approval.quorum_review.max(1));
    asked.max(site).max(condition::people_needed(&kappas.conditions()))
}

/// `theta_act(kappas, S, Delta_shadow, Gamma)` (paper equation 10).
#[must_use]
pub fn evaluate(input: &GateInput<'_>, table: &PolicyTable, profile: &Profile) -> GateResult {
    let mut found = GateFindings::default();
    found.dimensions(input, profile);
    found.evidence(input);
    if input.omitted.has(Part::Shadow) {
        found.noted.push(Omitted::reason(Dimension::Shadow));
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
    ask: Vec<Reason>,
    noted: Vec<Reason>,
    until: Option<WallTime>,
}

fn reason(code: ReasonCode, text: impl Into<String>) -> Reason {
    Reason::new(code, Dimension::Gate, text)
}

impl GateFindings {
    fn dimensions(&mut self, input: &GateInput<'_>, profile: &Profile) {
        let kappas = input.kappas;
        for (dimension, check) in kappas.checks() {
            if input.omitted.covers(dimension) {
                self.noted.push(Omitted::reason(dimension));
                continue;
            }
            let of = |text: &str| format!("{dimension:?}: {text}").to_lowercase();
            let waived = dimension == Dimension::Recovery
                && needs_review(kappas, profile)
                && recovery_is_reviewable(&kappas.recovery);
            match check {
                // A review is settled by the approvals, whose quorum counts it.
                Check::Pass | Check::PassRestricted(_) | Check::Review => {}
                Check::Fail if waived => {}
                Check::Fail => {
                    self.reject.push(reason(ReasonCode::GateDimensionFailed, of("incompatible")));
                }
                Check::Inconclusive | Check::NoData => {
                    self.demote.push(reason(ReasonCode::GateNoData, of("no conclusive data")));
                }
                Check::Skipped => {
                    self.demote
                        .push(reason(ReasonCode::GateSkipped, of("skipped, which only experiments may")));
                }
            }
        }
        let review_without_approver =
            Check::from(kappas.policy.outcome) == Check::Review && !profile.has_approver();
        if review_without_approver {
            let text = "a review is needed and the profile has no approver";
            self.reject.push(reason(ReasonCode::GateDimensionFailed, text));
        }
        let values = [
            (Dimension::Interface, "kappa_I", kappas.interface.basis, kappas.interface.kappa),
            (Dimension::Policy, "kappa_P", kappas.policy.basis, kappas.policy.kappa),
            (Dimension::Behavior, "kappa_B", kappas.behavior.basis, kappas.behavior.kappa),
            (Dimension::Recovery, "kappa_R", kappas.recovery.basis, kappas.recovery.kappa),
        ];
        for (_, what, basis, value) in values.into_iter().filter(|value| !input.omitted.covers(value.0)) {
            if basis == Basis::Estimated {
                let text = format!("{what} is an estimate; only measured values open the gate");
                self.demote.push(reason(ReasonCode::GateNotMeasured, text));
            }
            if value.is_none() {
                self.demote.push(reason(ReasonCode::GateNoData, format!("{what} has no value")));
            }
        }
    }

    fn evidence(&mut self, input: &GateInput<'_>) {
        if input.bindings.is_empty() {
            self.demote.push(reason(ReasonCode::GateNoData, "there is no evidence"));
        }
        if input.bindings.iter().any(|binding| binding != input.current) {
            let text = "evidence of another version, profile, policy, environment or active version, or beside others";
            self.demote.push(reason(ReasonCode::GateStaleEvidence, text));
        }
        let (under, now) = (&input.made_under, input.current);
        let same = under.candidate == now.candidate
            && under.active == now.active
            && under.policy == now.policy
            && under.profile == now.profile
            && under.environment == now.environment
            && under.neighbours == now.neighbours;
        if !same {
            let text = "the decision's circumstances are not the evidence's";
            self.demote.push(reason(ReasonCode::GateStaleEvidence, text));
        }
    }

    fn shadow(&mut self, shadow: Option<&ShadowAssessment>, needed: u32) {
        let Some(shadow) = shadow else {
            self.demote.push(reason(ReasonCode::GateNoData, "shadow was not worked"));
            return;
        };
        if shadow.check == Check::Pass && shadow.sequences < needed {
            let text = "shadow was worked for fewer sequences than a condition demands";
            let short = reason(ReasonCode::GateShadowTooShort, text);
            self.demote.push(short.with(f64::from(shadow.sequences), f64::from(needed)));
        }
        let list = match shadow.check {
            Check::Pass => &mut self.noted,
            Check::Fail => {
                self.reject.push(reason(ReasonCode::GateDimensionFailed, "shadow failed"));
                &mut self.reject
            }
            Check::PassRestricted(_)
            | Check::Review
            | Check::Inconclusive
            | Check::NoData
            | Check::Skipped => {
                self.demote.push(reason(ReasonCode::GateNoData, "shadow is not conclusive"));
                &mut self.demote
            }
        };
        list.extend(shadow.reasons.iter().cloned());
    }

    fn rules(&mut self, input: &GateInput<'_>, table: &PolicyTable, profile: &Profile) {
        if table.profile != profile.name || table.digest != input.made_under.policy {
            let text = "the policies compiled are not those the decision is made under";
            self.demote.push(reason(ReasonCode::GateStaleEvidence, text));
        }
        if let Some(because) = table.activation_forbidden(input.risk, input.provenance) {
            let text = format!("a site policy forbids it ({})", because.join(", "));
            self.reject.push(reason(ReasonCode::GateSitePolicyForbids, text));
        }
        if input.closed.contains(&profile.name) {
            let text = format!("the profile {:?} is closed to this version", profile.name.name());
            self.hold.push(reason(ReasonCode::GateProfileClosed, text));
        }
        if !input.unmet.is_empty() {
            let text = format!("no active version meets what it depends on: {}", input.unmet.join(", "));
            self.hold.push(reason(ReasonCode::GateDependencyUnmet, text));
        }
        let asked = people_needed(input.kappas, (input.risk, input.provenance), table, profile) > 0;
        let strict = profile.name == ProfileName::Human || (profile.name == ProfileName::Real && asked);
        if *input.requester == Requester::Unknown && strict {
            let text = "no enrolled person is on record as having registered it, so nobody can be told to be independent \
                        of it; register it again, signed, under a new version";
            self.hold.push(reason(ReasonCode::GateRequesterUnknown, text));
        }
        if input.review_open {
            let text = "a review after an emergency approval is open";
            self.hold.push(reason(ReasonCode::GateReviewOpen, text));
        }
        if !input.profile_authorized {
            let text = "no administrator authorized the profile as this program has it";
            self.hold.push(reason(ReasonCode::GateProfileUnauthorized, text));
        }
        if let Some(FreezeWindow { until, reason: why, .. }) = profile.frozen_at(input.now) {
            self.hold.push(reason(ReasonCode::GateFrozen, format!("change is frozen until {until}: {why}")));
        }
        if let Some(doubt) = input.clock_doubt {
            let text = format!("{doubt}; a person has to confirm the time");
            self.hold.push(reason(ReasonCode::GateClockDoubted, text));
        }
        if input.kappas.conditions().contains(&Condition::SimulationOnly) && profile.name != ProfileName::Sim
        {
            let text = format!("it is for simulation alone, and the profile is {:?}", profile.name.name());
            self.reject.push(reason(ReasonCode::GateSimulationOnly, text));
        }
        match (profile.activation.require_improvement, input.improved) {
            (true, false) => {
                let text = "the profile demands an improvement and none is established";
                self.demote.push(reason(ReasonCode::GateNoImprovement, text));
            }
            (false, false) => {
                let text =
                    "no improvement is established; the profile waives it (require_improvement = false)";
                self.noted.push(reason(ReasonCode::GateImprovementWaived, text));
            }
            (true | false, true) => {
                let text = "an improvement of success over the active version is established";
                self.noted.push(reason(ReasonCode::GateImproved, text));
            }
        }
    }

    /// Whether the approval is a break-glass one.
    fn approvals(&mut self, approval: Option<&ApprovalResult>, quorum: u8) -> bool {
        if quorum == 0 && !approval.is_some_and(ApprovalResult::is_emergency) {
            return false;
        }
        let Some(approval) = approval else {
            self.ask.push(reason(ReasonCode::ApprovalPending, "nobody was asked yet"));
            return false;
        };
        let mut glass = false;
        // Each line gives a reason of the gate's own: it never rests on the reasons handed in.
        let (list, own) = match &approval.outcome {
            ApprovalOutcome::Granted { people, break_glass, until } => {
                self.until = Some(*until);
                glass = *break_glass;
                if people.len() < usize::from(quorum) && !glass {
                    (
                        &mut self.ask,
                        reason(ReasonCode::ApprovalPending, "fewer people approved than are needed"),
                    )
                } else {
                    (&mut self.noted, reason(ReasonCode::ApprovalGranted, "the approvals are there"))
                }
            }
            // Nobody was asked for something that needs asking: the question was put under other rules.
            ApprovalOutcome::NotNeeded | ApprovalOutcome::Pending { .. } => {
                (&mut self.ask, reason(ReasonCode::ApprovalPending, "approvals are missing"))
            }
            ApprovalOutcome::TimedOut => {
                (&mut self.hold, reason(ReasonCode::ApprovalTimeout, "too few people answered in time"))
            }
            ApprovalOutcome::Refused { person } => {
                (&mut self.reject, reason(ReasonCode::ApprovalRefused, format!("{person:?} refused")))
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
        } else if !self.ask.is_empty() {
            GateOutcome::AwaitApproval
        } else {
            GateOutcome::Pass
        };
        let terms = terms::terms(input.kappas, profile, quorum, glass);
        let mut reasons = self.reject;
        for list in [self.demote, self.hold, self.ask] {
            reasons.extend(list);
        }
        if outcome == GateOutcome::Pass {
            reasons.push(reason(ReasonCode::GatePassed, "every demand of the profile is met"));
        }
        reasons.extend(self.noted);
        let watch = Strictness::of(&terms.conditions);
        let answers = Answers {
            admitted: outcome == GateOutcome::Pass,
            conditions: terms.conditions.clone(),
            monitoring: format!(
                "provisional for {} episodes, then continuously; {}",
                terms.provisional_episodes,
                watch.limits(&profile.monitor)
            ),
            rollback_when: if watch.coupled() {
                "at the first safety event or warning of a chart, without asking; the predecessor stays loaded".into()
            } else {
                "at a safety event, an established worsening, or an escalation nobody answers".into()
            },
            deployment: Some(vocabulary::deployability_of_gate(outcome, &terms.modes)),
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
