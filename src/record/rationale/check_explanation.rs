//! Why a check came out as it did, in typed values, and what was measured, by weight.
//!
//! Counts come from the raw pairs and drills, verdicts from the rules' own bounds; judges nothing. The crate
//! `holdpoint-wording` makes the sentences at the last step.

use holdpoint_governance::behavior::{BehaviorComponent, ComponentName, component_of};
use holdpoint_governance::composition::Kappas;
use holdpoint_governance::decision::{Dimension, Reason, ReasonCode};
use holdpoint_governance::evidence::{DrillKind, DrillTally, EpisodeValues, Pair};
use holdpoint_governance::explanation::{
    CheckFinding, CheckReason, ComponentFinding, ComponentValues, DecidingBound, DecidingFact,
    DrillComparison, ReasonContent, Remedy, Support,
};
use holdpoint_governance::finding::Finding;
use holdpoint_governance::outcome::CheckResult;
use holdpoint_governance::permission::{PermissionExcess, PermissionUse};
use holdpoint_protocol::detail::{FindingVerdict, RationaleFinding, RationaleView};
use holdpoint_protocol::film::{CodeFaultCount, FilmRequest, FilmSubject};
use holdpoint_wording::check::{check_decision, check_finding, decided_check, worst_work};
use holdpoint_wording::explanation::permission_excess;

use crate::evidence_file::EvidenceFile;
use crate::rationale::episode_selection::{
    SelectedEpisode, badness, choose, code_fault_counts, decisive, decisive_harm, overrun,
};
use crate::rationale::remedy::{is_in_favor, is_tolerated, remedies};

/// The four compatibilities, in their order.
const CHECKS: [Dimension; 4] =
    [Dimension::Interface, Dimension::Policy, Dimension::Behavior, Dimension::Recovery];

/// What a summary for approvers is about.
pub const SUMMARIZED: [Dimension; 2] = [Dimension::Behavior, Dimension::Recovery];

/// Why one part of the rules came out as it did.
#[derive(Clone, Debug, PartialEq)]
struct CheckRationale {
    about: Dimension,
    /// How confined code failed, for behavior.
    faults: Vec<CodeFaultCount>,
    fact: DecidingFact,
    remedies: Vec<Remedy>,
    /// The gravest first.
    findings: Vec<WeighedFinding>,
    film: Option<FilmRequest>,
}

/// Something that was found, with its weight.
#[derive(Clone, Debug, PartialEq)]
struct WeighedFinding {
    finding: CheckFinding,
    weight: Option<f64>,
    verdict: FindingVerdict,
}

impl CheckRationale {
    /// As front ends show it.
    fn view(&self) -> RationaleView {
        let findings = self.findings.iter().map(|found| RationaleFinding {
            text: check_finding(&found.finding),
            weight: found.weight,
            verdict: found.verdict,
        });
        RationaleView {
            about: self.about,
            decisive: check_decision(&self.faults, &self.fact),
            change: holdpoint_wording::explanation::remedies(&self.remedies),
            findings: findings.collect(),
            film: self.film,
        }
    }
}

/// Why each part of the rules came out as it did: the four compatibilities, then whatever else has reasons.
#[must_use]
pub fn rationales(evidence_file: &EvidenceFile, reasons: &[Reason]) -> Vec<RationaleView> {
    if evidence_file.kappas.is_none() {
        return Vec::new();
    }
    let mut about = CHECKS.to_vec();
    for reason in reasons {
        if !about.contains(&reason.dimension) {
            about.push(reason.dimension);
        }
    }
    about.into_iter().map(|about| rationale(evidence_file, reasons, about).view()).collect()
}

fn rationale(evidence_file: &EvidenceFile, reasons: &[Reason], about: Dimension) -> CheckRationale {
    let against = reasons.iter().filter(|reason| reason.dimension == about && !is_in_favor(reason.code));
    // A fault of the code explains whatever was measured of its behavior.
    let faults = if about == Dimension::Behavior { code_fault_counts(evidence_file) } else { Vec::new() };
    // What passed without a condition needs no change.
    let remedies =
        if has_passed(evidence_file, about) { Vec::new() } else { remedies(evidence_file, against) };
    CheckRationale { faults, remedies, ..base_rationale(evidence_file, reasons, about) }
}

/// Whether a compatibility passed, without a condition.
fn has_passed(evidence_file: &EvidenceFile, about: Dimension) -> bool {
    let checks = evidence_file.kappas.as_ref().map(Kappas::checks);
    checks.is_some_and(|checks| checks.contains(&(about, CheckResult::Pass)))
}

/// As [`rationale`], without faults of code, and without what would have to change: that reads the whole evidence file.
fn base_rationale(evidence_file: &EvidenceFile, reasons: &[Reason], about: Dimension) -> CheckRationale {
    let own: Vec<&Reason> = reasons.iter().filter(|reason| reason.dimension == about).collect();
    let first_against = own.iter().copied().find(|reason| !is_in_favor(reason.code));
    let (mut findings, film) = match about {
        // What was stopped before it was compared is seen alone.
        Dimension::Behavior if evidence_file.pairs.is_empty() => (
            reason_findings(evidence_file, &own),
            film_of(FilmSubject::Alone, evidence_file.alone.is_empty()),
        ),
        Dimension::Behavior => (behavior_findings(evidence_file), film_of(FilmSubject::Episode, false)),
        Dimension::Recovery => (
            recovery_findings(evidence_file),
            film_of(FilmSubject::Drill, evidence_file.failed_drills.is_empty()),
        ),
        // What is looked up and not measured has no more or less: its value stands in the heading.
        Dimension::Interface | Dimension::Policy => {
            let own: Vec<&Reason> = own.iter().copied().filter(|reason| !is_value(reason)).collect();
            (reason_findings(evidence_file, &own), None)
        }
        Dimension::Composition
        | Dimension::Shadow
        | Dimension::Gate
        | Dimension::Approval
        | Dimension::Monitor => (reason_findings(evidence_file, &own), None),
    };
    let fact = match first_against {
        Some(reason) => {
            let measured = match about {
                // A hard stop ends the evaluation, whatever was measured so far.
                Dimension::Behavior if reason.code == ReasonCode::BehaviorHardStop => None,
                Dimension::Behavior => decisive_finding(evidence_file).or_else(|| gravest(&findings)),
                Dimension::Recovery => gravest(&findings),
                _ => None,
            };
            let reason = check_reason(evidence_file, reason);
            match measured {
                Some(finding) => {
                    let repeats = repeats_reason(about, evidence_file)
                        || matches!(&finding, CheckFinding::Reason(stated) if *stated == reason);
                    DecidingFact::Against { finding, reason: (!repeats).then_some(reason) }
                }
                None => DecidingFact::Against { finding: CheckFinding::Reason(reason), reason: None },
            }
        }
        None => in_favor(evidence_file, about, &own, &findings),
    };
    // Where nothing was measured a reason is all there is: what the deciding fact states does not stand again below it.
    findings.retain(|found| found.weight.is_some() || !states_only(&fact, &found.finding));
    CheckRationale { about, faults: Vec::new(), fact, remedies: Vec::new(), findings, film }
}

/// Whether the fact states this finding and nothing beyond it.
fn states_only(fact: &DecidingFact, finding: &CheckFinding) -> bool {
    match (fact, finding) {
        (DecidingFact::Against { finding: stated, reason: None }, finding) => stated == finding,
        (
            DecidingFact::InFavor { kappa: None, support: Support::Reason(stated) },
            CheckFinding::Reason(reason),
        ) => stated == reason,
        _ => false,
    }
}

/// A reason with its numbers; of a breach of the budget, which overrun of the code it was.
fn check_reason(evidence_file: &EvidenceFile, reason: &Reason) -> CheckReason {
    let is_hard_stop = matches!(reason.finding, Some(Finding::SandboxHardStop { .. }));
    CheckReason {
        content: ReasonContent::from(reason),
        overrun: overrun(evidence_file).filter(|_| is_hard_stop),
    }
}

/// What decided on these of behavior and recovery, and which runs show it, for approvers: one sentence each.
#[must_use]
pub fn summary(evidence_file: &EvidenceFile, about: &[Dimension]) -> Vec<String> {
    let Some(kappas) = &evidence_file.kappas else { return Vec::new() };
    let reasons = [&kappas.behavior.reasons[..], &kappas.recovery.reasons[..]].concat();
    sentences(evidence_file, &reasons, about)
}

/// What decided against a version, one sentence for each part of the rules, and which runs show it; of a decision in
/// its favor, the sentences for the next approvers.
#[must_use]
pub fn decision_sentences(evidence_file: &EvidenceFile, reasons: &[Reason]) -> Vec<String> {
    let mut against: Vec<Dimension> = Vec::new();
    // What is still to be measured decided nothing, and the composition says what its parts came to.
    let decides = |reason: &&Reason| {
        let open = matches!(reason.code, ReasonCode::BehaviorNoData | ReasonCode::RecoveryNoData);
        !is_in_favor(reason.code) && !open && reason.dimension != Dimension::Composition
    };
    for reason in reasons.iter().filter(decides) {
        if !against.contains(&reason.dimension) {
            against.push(reason.dimension);
        }
    }
    if against.is_empty() || evidence_file.kappas.is_none() {
        return if evidence_file.pairs.is_empty() { Vec::new() } else { summary(evidence_file, &SUMMARIZED) };
    }
    let is_clamped = against.contains(&Dimension::Recovery)
        || reasons.iter().any(|reason| reason.code == ReasonCode::BehaviorAsksMore);
    let asked = if is_clamped { asked_beyond(evidence_file) } else { Vec::new() };
    [asked, sentences(evidence_file, reasons, &against)].concat()
}

/// What the code asks for beyond its declaration, one sentence for each quantity: the guard clamps such commands.
fn asked_beyond(evidence_file: &EvidenceFile) -> Vec<String> {
    let excesses = evidence_file.permissions.as_ref().map(PermissionUse::excesses).unwrap_or_default();
    let asked = excesses.iter().filter(|excess| matches!(excess, PermissionExcess::Asked { .. }));
    asked.map(permission_excess).collect()
}

/// How confined code failed, then what decided each of these parts of the rules and the work that shows it.
fn sentences(evidence_file: &EvidenceFile, reasons: &[Reason], about: &[Dimension]) -> Vec<String> {
    let mut sentences: Vec<String> =
        code_fault_counts(evidence_file).into_iter().map(holdpoint_wording::film::code_fault_count).collect();
    for about in about {
        let CheckRationale { about, fact, film, .. } = base_rationale(evidence_file, reasons, *about);
        sentences.push(decided_check(about, &fact));
        let worst = film
            .and_then(|request| choose(evidence_file, request).ok().map(|selected| (request.of, selected)));
        if let Some((of, SelectedEpisode { number, count, beyond, reason: Some(reason), .. })) = worst {
            sentences.push(worst_work(of, number, count, beyond, reason));
        }
    }
    sentences
}

/// Whether the measured component is what the first reason states.
fn repeats_reason(about: Dimension, evidence_file: &EvidenceFile) -> bool {
    about == Dimension::Behavior && decisive(evidence_file).is_some()
}

const fn film_of(of: FilmSubject, nothing: bool) -> Option<FilmRequest> {
    if nothing { None } else { Some(FilmRequest { of, number: None }) }
}

/// The gravest finding, if there is one against the version.
fn gravest(findings: &[WeighedFinding]) -> Option<CheckFinding> {
    let gravest = findings.iter().find(|found| found.verdict == FindingVerdict::Worse);
    gravest.map(|found| found.finding.clone())
}

/// A compatibility that is as it has to be: of these more is better.
fn is_value(reason: &Reason) -> bool {
    is_in_favor(reason.code) && reason.evidence.zip(reason.limit).is_some_and(|(value, least)| value >= least)
}

/// The deciding fact where nothing speaks against the version.
fn in_favor(
    evidence_file: &EvidenceFile,
    about: Dimension,
    own: &[&Reason],
    findings: &[WeighedFinding],
) -> DecidingFact {
    let kappa = evidence_file.kappas.as_ref().and_then(|kappas| match about {
        Dimension::Interface => kappas.interface.kappa,
        Dimension::Policy => kappas.policy.kappa,
        Dimension::Behavior => kappas.behavior.kappa,
        Dimension::Recovery => kappas.recovery.kappa,
        _ => None,
    });
    let nearest = findings.first().filter(|_| matches!(about, Dimension::Behavior | Dimension::Recovery));
    let support = match (nearest, own.first()) {
        (Some(nearest), _) => Support::NearestToLimit(nearest.finding.clone()),
        (None, Some(reason)) => Support::Reason(check_reason(evidence_file, reason)),
        (None, None) if evidence_file.pairs.is_empty() && about == Dimension::Behavior => {
            return DecidingFact::NotMeasured;
        }
        (None, None) => Support::NoFinding,
    };
    DecidingFact::InFavor { kappa, support }
}

/// Reasons as findings, those against it first.
fn reason_findings(evidence_file: &EvidenceFile, own: &[&Reason]) -> Vec<WeighedFinding> {
    let mut all: Vec<WeighedFinding> = own
        .iter()
        .map(|reason| WeighedFinding {
            finding: CheckFinding::Reason(check_reason(evidence_file, reason)),
            weight: None,
            verdict: if is_in_favor(reason.code) { FindingVerdict::Tolerable } else { FindingVerdict::Worse },
        })
        .collect();
    all.sort_by_key(|found| found.verdict);
    all
}

/// The component or the measure of harm that the first reason of the rules names.
fn decisive_finding(evidence_file: &EvidenceFile) -> Option<CheckFinding> {
    let behavior = evidence_file.behavior.as_ref()?;
    if let Some(kind) = decisive_harm(evidence_file) {
        return behavior.harm.iter().find(|harm| harm.kind == kind).copied().map(CheckFinding::Harm);
    }
    let name = decisive(evidence_file)?;
    let component = behavior.components.iter().find(|component| component.name == name)?;
    Some(CheckFinding::Component(component_finding(component, &evidence_file.pairs, None)))
}

/// Components, harm and sequences, the gravest first.
fn behavior_findings(evidence_file: &EvidenceFile) -> Vec<WeighedFinding> {
    let Some(behavior) = &evidence_file.behavior else { return Vec::new() };
    let verdict = |worse, tolerable| match (worse, tolerable) {
        (true, _) => FindingVerdict::Worse,
        (false, true) => FindingVerdict::Tolerable,
        (false, false) => FindingVerdict::Doubtful,
    };
    let traded =
        behavior.assessment.reasons.iter().find(|reason| reason.code == ReasonCode::BehaviorSafetyTraded);
    let traded = traded.and_then(component_of);
    let counts = |component: &BehaviorComponent| {
        let is_traded = traded == Some(component.name);
        component.is_established() && (is_traded || !is_tolerated(component, behavior))
    };
    let components = behavior.components.iter().map(|component| WeighedFinding {
        finding: CheckFinding::Component(component_finding(
            component,
            &evidence_file.pairs,
            bound_of(component, counts(component)),
        )),
        weight: weight(component.worsening, component.tolerance),
        verdict: verdict(counts(component), component.is_within_tolerance()),
    });
    // A measure in which the two do not differ says nothing of either.
    let differing = behavior.harm.iter().filter(|harm| harm.worsening != 0.0 || !harm.is_within_tolerance());
    let harm = differing.map(|harm| WeighedFinding {
        finding: CheckFinding::Harm(*harm),
        weight: weight(harm.worsening, harm.tolerance),
        verdict: verdict(harm.is_established(), harm.is_within_tolerance()),
    });
    let sequences = behavior.sequences.iter().filter(|found| found.is_concern()).map(|found| {
        let is_past = found.worsening > found.tolerance;
        WeighedFinding {
            finding: CheckFinding::Sequences {
                comparison: *found,
                bound: (!is_past).then_some(DecidingBound::Established(found.lower)),
            },
            weight: weight(found.worsening, found.tolerance),
            verdict: verdict(found.is_established(), false),
        }
    });
    let mut all: Vec<WeighedFinding> = components.chain(harm).chain(sequences).collect();
    by_gravity(&mut all);
    all
}

/// The bound that makes the verdict of a component; absent where its mean does. `counts`: a significant worsening counts
/// against the version.
fn bound_of(component: &BehaviorComponent, counts: bool) -> Option<DecidingBound> {
    let BehaviorComponent { worsening, lower, upper, tolerance, .. } = *component;
    if worsening > tolerance {
        None
    } else if counts {
        Some(DecidingBound::Established(lower))
    } else if component.is_within_tolerance() {
        None
    } else {
        Some(upper.map_or(DecidingBound::Unbounded, DecidingBound::NotExcluded))
    }
}

fn by_gravity(all: &mut [WeighedFinding]) {
    let heavy = |found: &WeighedFinding| found.weight.unwrap_or(f64::NEG_INFINITY);
    all.sort_by(|a, b| a.verdict.cmp(&b.verdict).then(heavy(b).total_cmp(&heavy(a))));
}

fn weight(worsening: f64, tolerance: f64) -> Option<f64> {
    let weight = worsening / tolerance;
    weight.is_finite().then_some(weight)
}

/// A component counted or averaged over the raw pairs.
fn component_finding(
    component: &BehaviorComponent,
    pairs: &[Pair],
    bound: Option<DecidingBound>,
) -> ComponentFinding {
    let BehaviorComponent { name, tolerance, .. } = *component;
    let compared: Vec<&Pair> = pairs.iter().filter(|pair| name.is_compared_in(pair)).collect();
    let of = |side: fn(&Pair) -> &EpisodeValues| -> (usize, f64) {
        let values: Vec<f64> = compared.iter().map(|pair| badness(name, side(pair))).collect();
        let bad = values.iter().filter(|value| **value > 0.0).count();
        (bad, values.iter().sum::<f64>() / (values.len().max(1) as f64))
    };
    let (candidate, active) = (of(|pair| &pair.candidate), of(|pair| &pair.active));
    let values = match name {
        ComponentName::Violation
        | ComponentName::Anomaly
        | ComponentName::Recovery
        | ComponentName::Success => {
            ComponentValues::Episodes { candidate: candidate.0, active: active.0, of: pairs.len() }
        }
        ComponentName::Retry | ComponentName::Time => {
            ComponentValues::Mean { candidate: candidate.1, active: active.1 }
        }
    };
    ComponentFinding { name, values, tolerance, bound }
}

/// Each kind of drill, the one that fails most beyond the active version's first.
fn recovery_findings(evidence_file: &EvidenceFile) -> Vec<WeighedFinding> {
    let Some((candidate, active)) = &evidence_file.drills else { return Vec::new() };
    let kinds = evidence_file.recovery.as_ref().map(|recovery| recovery.kinds.as_slice()).unwrap_or_default();
    let share = |tally: &DrillTally| match tally.feasible() {
        0 => 0.0,
        all => f64::from(tally.failed) / f64::from(all),
    };
    let worked = DrillKind::ALL.into_iter().filter(|kind| candidate.of(*kind).feasible() > 0);
    let mut all: Vec<(f64, WeighedFinding)> = worked
        .map(|kind| {
            let (new, old) = (candidate.of(kind), active.of(kind));
            let drills = DrillComparison { kind, phase: None, candidate: *new, active: *old };
            let excess = share(new) - share(old);
            let rates = kinds.iter().find(|rates| rates.kind == kind);
            let verdict = match rates {
                Some(rates) if rates.established_worse => FindingVerdict::Worse,
                Some(rates) if !rates.leans_worse => FindingVerdict::Tolerable,
                // Too few of them for the rule's bound, or a lean.
                Some(_) | None if new.failed > 0 => FindingVerdict::Doubtful,
                Some(_) | None => FindingVerdict::Tolerable,
            };
            let found = WeighedFinding { finding: CheckFinding::Drills(drills), weight: None, verdict };
            (excess.max(share(new) / 2.0), found)
        })
        .collect();
    all.sort_by(|(a, _), (b, _)| b.total_cmp(a));
    let against = evidence_file.recovery.iter().flat_map(|recovery| &recovery.assessment.reasons);
    let is_against = against.into_iter().any(|reason| !is_in_favor(reason.code));
    if let Some((_, gravest)) = all.first_mut().filter(|(excess, _)| is_against && *excess > 0.0) {
        gravest.verdict = FindingVerdict::Worse;
    }
    all.into_iter().map(|(_, found)| found).collect()
}

#[cfg(test)]
mod tests;
