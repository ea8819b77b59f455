//! Why a check came out as it did, in one sentence with its numbers, and what was measured, by weight.
//!
//! Says everything in one direction: more is worse. Counts come from the raw pairs and drills, verdicts from the rules'
//! own bounds; judges nothing.

use holdpoint_governance::behavior::{BehaviorComponent, ComponentName};
use holdpoint_governance::decision::{Dimension, Kappa, Reason, ReasonCode};
use holdpoint_governance::evidence::{DrillKind, DrillTally, Pair};
use holdpoint_governance::finding::Finding;
use holdpoint_protocol::detail::{FindingVerdict, RationaleFinding, RationaleView};
use holdpoint_protocol::film::{FilmRequest, FilmSubject};
use holdpoint_wording::{hard_stop, harm_comparison, harm_decider, sequence_measure};

use crate::episode_replay::episode_selection::{
    NOWHERE_WORSE, SelectedEpisode, badness, choose, code_faults, decisive, overrun,
};
use crate::evidence_file::EvidenceFile;
use crate::explain::{changes, is_in_favor};

/// The four compatibilities, in their order.
const CHECKS: [Dimension; 4] =
    [Dimension::Interface, Dimension::Policy, Dimension::Behavior, Dimension::Recovery];

/// Why each part of the rules came out as it did: the four compatibilities, then whatever else has reasons.
pub(crate) fn rationales(evidence_file: &EvidenceFile, reasons: &[Reason]) -> Vec<RationaleView> {
    if evidence_file.kappas.is_none() {
        return Vec::new();
    }
    let mut about = CHECKS.to_vec();
    for reason in reasons {
        if !about.contains(&reason.dimension) {
            about.push(reason.dimension);
        }
    }
    about.into_iter().map(|about| rationale(evidence_file, reasons, about)).collect()
}

fn rationale(evidence_file: &EvidenceFile, reasons: &[Reason], about: Dimension) -> RationaleView {
    let against = reasons.iter().filter(|reason| reason.dimension == about && !is_in_favor(reason.code));
    let mut view = RationaleView {
        change: changes(evidence_file, against),
        ..base_rationale(evidence_file, reasons, about)
    };
    let faults = code_faults(evidence_file);
    if about == Dimension::Behavior && !faults.is_empty() {
        // Whatever was measured of such code, it came of this.
        view.decisive = format!("{}; {}", faults.join("; "), view.decisive);
    }
    view
}

/// As [`rationale`], without what would have to change: that reads the whole evidence file.
fn base_rationale(evidence_file: &EvidenceFile, reasons: &[Reason], about: Dimension) -> RationaleView {
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
    let found = match about {
        Dimension::Behavior => decisive_component(evidence_file).or_else(|| lead(&findings, first_against)),
        Dimension::Recovery => lead(&findings, first_against),
        _ => None,
    };
    let decisive = match (found, first_against) {
        (Some(found), Some(reason))
            if !repeats_reason(about, evidence_file) && found != with_numbers(evidence_file, reason) =>
        {
            format!("{found}: {}", with_numbers(evidence_file, reason))
        }
        (Some(found), Some(_)) => found,
        (None, Some(reason)) => with_numbers(evidence_file, reason),
        (_, None) => favorable_sentence(evidence_file, about, &own, &findings),
    };
    // Where nothing was measured a reason is all there is: what the sentence says is not said again below it.
    findings.retain(|finding| finding.weight.is_some() || finding.text != decisive);
    RationaleView { about, decisive, change: Vec::new(), findings, film }
}

/// What a reason found; of a breach of the budget, which overrun of the code it was.
fn finding_text(evidence_file: &EvidenceFile, reason: &Reason) -> String {
    match (&reason.finding, overrun(evidence_file)) {
        (Some(Finding::SandboxHardStop { stop }), Some(fault)) => {
            format!("hard stop {}: {}", stop.name(), hard_stop(*stop, Some(fault)))
        }
        _ => holdpoint_wording::reason(reason),
    }
}

/// What decided on behavior and recovery, and which runs show it, for approvers: one sentence each.
pub(crate) fn summary(evidence_file: &EvidenceFile) -> Vec<String> {
    let Some(kappas) = &evidence_file.kappas else { return Vec::new() };
    let reasons = [&kappas.behavior.reasons[..], &kappas.recovery.reasons[..]].concat();
    let mut sentences = code_faults(evidence_file);
    for about in [Dimension::Behavior, Dimension::Recovery] {
        push_sentences(evidence_file, &reasons, about, &mut sentences);
    }
    sentences
}

/// What decided against a version, one sentence for each part of the rules, and which runs show it; of a decision in
/// its favor, the sentences for the next approvers.
pub(crate) fn decision_sentences(evidence_file: &EvidenceFile, reasons: &[Reason]) -> Vec<String> {
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
        return if evidence_file.pairs.is_empty() { Vec::new() } else { summary(evidence_file) };
    }
    let mut sentences = code_faults(evidence_file);
    for about in against {
        push_sentences(evidence_file, reasons, about, &mut sentences);
    }
    sentences
}

fn push_sentences(
    evidence_file: &EvidenceFile,
    reasons: &[Reason],
    about: Dimension,
    sentences: &mut Vec<String>,
) {
    let RationaleView { decisive, film, .. } = base_rationale(evidence_file, reasons, about);
    sentences.push(format!("{}: {decisive}", about.name()));
    let episode =
        film.and_then(|request| choose(evidence_file, request).ok().map(|episode| (request.of, episode)));
    if let Some((of, SelectedEpisode { number, count, beyond, why, .. })) = episode {
        let more = if beyond > 0 { format!(" on record, {beyond} more failed") } else { String::new() };
        sentences.push(if why == NOWHERE_WORSE {
            // There is no worst one where none is worse.
            format!("{why} (of {count})")
        } else {
            format!("the worst {of} is number {number} of {count}{more}: {why}")
        });
    }
}

/// Whether the sentence of the measured component says what the first reason says.
fn repeats_reason(about: Dimension, evidence_file: &EvidenceFile) -> bool {
    about == Dimension::Behavior && decisive(evidence_file).is_some()
}

const fn film_of(of: FilmSubject, nothing: bool) -> Option<FilmRequest> {
    if nothing { None } else { Some(FilmRequest { of, number: None }) }
}

/// The gravest finding, where the rules found something.
fn lead(findings: &[RationaleFinding], against: Option<&Reason>) -> Option<String> {
    against?;
    let gravest = findings.iter().find(|finding| finding.verdict == FindingVerdict::Worse);
    gravest.map(|finding| finding.text.clone())
}

fn with_numbers(evidence_file: &EvidenceFile, reason: &Reason) -> String {
    let text = finding_text(evidence_file, reason);
    match (reason.evidence, reason.limit) {
        (Some(found), Some(limit)) => {
            format!("{text} ({} against a limit of {})", number(found), number(limit))
        }
        (Some(found), None) => format!("{text} ({})", number(found)),
        (None, _) => text,
    }
}

/// A compatibility that is as it has to be: of these more is better.
fn is_value(reason: &Reason) -> bool {
    is_in_favor(reason.code) && reason.evidence.zip(reason.limit).is_some_and(|(value, least)| value >= least)
}

/// A sentence where nothing speaks against it.
fn favorable_sentence(
    evidence_file: &EvidenceFile,
    about: Dimension,
    own: &[&Reason],
    findings: &[RationaleFinding],
) -> String {
    let kappas = evidence_file.kappas.as_ref();
    let kappa = |about| -> Option<Kappa> {
        let kappas = kappas?;
        match about {
            Dimension::Interface => kappas.interface.kappa,
            Dimension::Policy => kappas.policy.kappa,
            Dimension::Behavior => kappas.behavior.kappa,
            Dimension::Recovery => kappas.recovery.kappa,
            _ => None,
        }
    };
    let value = kappa(about).map_or_else(String::new, |kappa| format!("{:.3}: ", kappa.get()));
    let nearest = findings.first().filter(|_| matches!(about, Dimension::Behavior | Dimension::Recovery));
    match (nearest, own.first()) {
        (Some(nearest), _) => {
            format!("{value}nothing speaks against it; nearest to a limit: {}", nearest.text)
        }
        (None, Some(reason)) => format!("{value}{}", with_numbers(evidence_file, reason)),
        (None, None) if evidence_file.pairs.is_empty() && about == Dimension::Behavior => {
            "not measured yet: the sandbox does that".to_owned()
        }
        (None, None) => format!("{value}nothing speaks against it"),
    }
}

/// Reasons as findings, those against it first.
fn reason_findings(evidence_file: &EvidenceFile, own: &[&Reason]) -> Vec<RationaleFinding> {
    let mut all: Vec<RationaleFinding> = own
        .iter()
        .map(|reason| RationaleFinding {
            text: with_numbers(evidence_file, reason),
            weight: None,
            verdict: if is_in_favor(reason.code) { FindingVerdict::Tolerable } else { FindingVerdict::Worse },
        })
        .collect();
    all.sort_by_key(|finding| finding.verdict);
    all
}

/// The component the rules found first, as a sentence.
fn decisive_component(evidence_file: &EvidenceFile) -> Option<String> {
    let name = decisive(evidence_file)?;
    let component =
        evidence_file.behavior.as_ref()?.components.iter().find(|component| component.name == name)?;
    Some(sentence(component, &evidence_file.pairs))
}

/// Components, harm and sequences, the gravest first.
fn behavior_findings(evidence_file: &EvidenceFile) -> Vec<RationaleFinding> {
    let Some(behavior) = &evidence_file.behavior else { return Vec::new() };
    let verdict = |worse, tolerable| match (worse, tolerable) {
        (true, _) => FindingVerdict::Worse,
        (false, true) => FindingVerdict::Tolerable,
        (false, false) => FindingVerdict::Doubtful,
    };
    let components = behavior.components.iter().map(|component| RationaleFinding {
        text: format!("{}{}", sentence(component, &evidence_file.pairs), bound_of(component)),
        weight: weight(component.worsening, component.tolerance),
        verdict: verdict(component.is_established(), component.is_within_tolerance()),
    });
    // A measure in which the two do not differ says nothing of either.
    let differing = behavior.harm.iter().filter(|harm| harm.worsening != 0.0 || !harm.is_within_tolerance());
    let harm = differing.map(|harm| RationaleFinding {
        text: match harm_decider(harm) {
            Some(deciding) => format!("{}; {deciding}", harm_comparison(harm)),
            None => harm_comparison(harm),
        },
        weight: weight(harm.worsening, harm.tolerance),
        verdict: verdict(harm.is_established(), harm.is_within_tolerance()),
    });
    let sequences =
        behavior.sequences.iter().filter(|found| found.is_concern()).map(|found| RationaleFinding {
            text: format!(
                "whole sequences: {} {} with it, {} with the active version; at most {} more is tolerated{}",
                sequence_measure(found.measure),
                number(found.candidate),
                number(found.active),
                number(found.tolerance),
                if found.worsening > found.tolerance {
                    String::new()
                } else {
                    format!("; {BOUND}: worse by {} at least is established", number(found.lower))
                }
            ),
            weight: weight(found.worsening, found.tolerance),
            verdict: verdict(found.is_established(), false),
        });
    let mut all: Vec<RationaleFinding> = components.chain(harm).chain(sequences).collect();
    by_gravity(&mut all);
    all
}

/// States that the bound decides, not the mean.
const BOUND: &str = "its bound decides";

/// What makes the verdict of a component whose mean is within what is tolerated; empty where that is no question.
fn bound_of(component: &BehaviorComponent) -> String {
    let BehaviorComponent { name, worsening, lower, upper, tolerance } = *component;
    let amount = |value: f64| match name {
        ComponentName::Retry => number(value),
        ComponentName::Success
        | ComponentName::Time
        | ComponentName::Violation
        | ComponentName::Anomaly
        | ComponentName::Recovery => format!("{} %", number(100.0 * value)),
    };
    if worsening > tolerance {
        String::new()
    } else if component.is_established() {
        format!("; {BOUND}: worse by {} at least is established", amount(lower))
    } else if component.is_within_tolerance() {
        String::new()
    } else {
        match upper {
            Some(upper) => format!("; {BOUND}: up to {} worse is not excluded", amount(upper)),
            None => format!("; {BOUND}: so few episodes exclude nothing"),
        }
    }
}

fn by_gravity(all: &mut [RationaleFinding]) {
    let heavy = |finding: &RationaleFinding| finding.weight.unwrap_or(f64::NEG_INFINITY);
    all.sort_by(|a, b| a.verdict.cmp(&b.verdict).then(heavy(b).total_cmp(&heavy(a))));
}

fn weight(worsening: f64, tolerance: f64) -> Option<f64> {
    let weight = worsening / tolerance;
    weight.is_finite().then_some(weight)
}

/// `passes a limit in 38 of 120 episodes, the active version in 0; at most 5 % more is tolerated`.
fn sentence(component: &BehaviorComponent, pairs: &[Pair]) -> String {
    let BehaviorComponent { name, tolerance, .. } = *component;
    let n = pairs.len();
    let count = |of: &dyn Fn(&Pair) -> f64| pairs.iter().filter(|pair| of(pair) > 0.0).count();
    let new = |pair: &Pair| badness(name, &pair.candidate);
    let old = |pair: &Pair| badness(name, &pair.active);
    #[allow(clippy::cast_precision_loss, reason = "episodes are few")]
    let mean = |of: &dyn Fn(&Pair) -> f64, among: &dyn Fn(&Pair) -> bool| {
        let chosen: Vec<f64> = pairs.iter().filter(|pair| among(pair)).map(of).collect();
        if chosen.is_empty() { 0.0 } else { chosen.iter().sum::<f64>() / chosen.len() as f64 }
    };
    let more = format!("at most {} % more is tolerated", number(100.0 * tolerance));
    match name {
        ComponentName::Violation => {
            format!(
                "passes a limit in {} of {n} episodes, the active version in {}; {more}",
                count(&new),
                count(&old)
            )
        }
        ComponentName::Anomaly => format!(
            "shows a failure to the watcher in {} of {n} episodes, the active version in {}; {more}",
            count(&new),
            count(&old)
        ),
        ComponentName::Recovery => format!(
            "needs the recovery manager in {} of {n} episodes, the active version in {}; {more}",
            count(&new),
            count(&old)
        ),
        ComponentName::Success => format!(
            "does not do the task in {} of {n} episodes, the active version in {}; {more}",
            count(&new),
            count(&old)
        ),
        ComponentName::Retry => {
            let all = |_: &Pair| true;
            format!(
                "tries {} times more an episode, the active version {}; at most {} more are tolerated",
                number(mean(&new, &all)),
                number(mean(&old, &all)),
                number(tolerance)
            )
        }
        ComponentName::Time => {
            let both = |pair: &Pair| pair.candidate.success && pair.active.success;
            format!(
                "takes {:.2} s where both do the task, the active version {:.2} s; at most {} % longer is tolerated",
                mean(&new, &both),
                mean(&old, &both),
                number(100.0 * tolerance)
            )
        }
    }
}

/// Each kind of drill, the one that fails most beyond the active version's first.
fn recovery_findings(evidence_file: &EvidenceFile) -> Vec<RationaleFinding> {
    let Some((candidate, active)) = &evidence_file.drills else { return Vec::new() };
    let kinds = evidence_file.recovery.as_ref().map(|recovery| recovery.kinds.as_slice()).unwrap_or_default();
    let share = |tally: &DrillTally| match tally.feasible() {
        0 => 0.0,
        all => f64::from(tally.failed) / f64::from(all),
    };
    let worked = DrillKind::ALL.into_iter().filter(|kind| candidate.of(*kind).feasible() > 0);
    let mut all: Vec<(f64, RationaleFinding)> = worked
        .map(|kind| {
            let (new, old) = (candidate.of(kind), active.of(kind));
            let text = format!(
                "fails {} of {} {kind} drills, the active version {} of {}",
                new.failed,
                new.feasible(),
                old.failed,
                old.feasible()
            );
            let excess = share(new) - share(old);
            let rates = kinds.iter().find(|rates| rates.kind == kind);
            let verdict = match rates {
                Some(rates) if rates.established_worse => FindingVerdict::Worse,
                Some(rates) if !rates.leans_worse => FindingVerdict::Tolerable,
                // Too few of them for the rule's bound, or a lean.
                Some(_) | None if new.failed > 0 => FindingVerdict::Doubtful,
                Some(_) | None => FindingVerdict::Tolerable,
            };
            (excess.max(share(new) / 2.0), RationaleFinding { text, weight: None, verdict })
        })
        .collect();
    all.sort_by(|(a, _), (b, _)| b.total_cmp(a));
    let against = evidence_file.recovery.iter().flat_map(|recovery| &recovery.assessment.reasons);
    let is_against = against.into_iter().any(|reason| !is_in_favor(reason.code));
    if let Some((_, gravest)) = all.first_mut().filter(|(excess, _)| is_against && *excess > 0.0) {
        gravest.verdict = FindingVerdict::Worse;
    }
    all.into_iter().map(|(_, finding)| finding).collect()
}

/// A number in as few digits as tell it.
fn number(value: f64) -> String {
    let digits = match value.abs() {
        size if size >= 100.0 => 0,
        size if size >= 10.0 => 1,
        size if size >= 1.0 => 2,
        _ => 3,
    };
    let text = format!("{value:.digits$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_governance::evidence::HardStop;
    use holdpoint_governance::finding::EvidenceGap;

    use holdpoint_governance::evidence::EpisodeValues;

    fn pair(violation: bool) -> Pair {
        let values = EpisodeValues {
            success: true,
            violation: false,
            anomaly: false,
            recovery: false,
            intervention: false,
            timeout: false,
            near_violation: false,
            policy_warning: false,
            retries: 0,
            time_s: 4.0,
            unsafe_continuation_ms: 0.0,
            harm: None,
        };
        Pair { seed: 1, active: values, candidate: EpisodeValues { violation, ..values } }
    }

    #[test]
    fn a_component_is_stated_in_counts_of_failures() {
        let component = BehaviorComponent {
            name: ComponentName::Violation,
            worsening: 0.5,
            lower: 0.1,
            upper: Some(0.9),
            tolerance: 0.05,
        };
        let pairs = [pair(true), pair(false)];
        assert_eq!(
            sentence(&component, &pairs),
            "passes a limit in 1 of 2 episodes, the active version in 0; at most 5 % more is tolerated"
        );
        assert_eq!(bound_of(&component), "", "the mean says it");
        assert_eq!(weight(0.5, 0.05), Some(10.0));
        assert_eq!(weight(0.5, 0.0), None);
    }

    /// Such a row stood there with the sign of what is bad and a mean that is tolerated.
    #[test]
    fn a_deciding_bound_is_stated() {
        let of = |lower, upper| {
            let name = ComponentName::Violation;
            bound_of(&BehaviorComponent { name, worsening: 0.04, lower, upper, tolerance: 0.05 })
        };
        assert_eq!(of(0.0, Some(0.045)), "");
        assert_eq!(of(0.0, Some(0.085)), "; its bound decides: up to 8.5 % worse is not excluded");
        assert_eq!(of(0.01, Some(0.085)), "; its bound decides: worse by 1 % at least is established");
        assert_eq!(of(0.0, None), "; its bound decides: so few episodes exclude nothing");
    }

    #[test]
    fn the_gravest_stands_first() {
        let finding = |weight, verdict| RationaleFinding { text: String::new(), weight, verdict };
        let mut all = [
            finding(Some(9.0), FindingVerdict::Tolerable),
            finding(Some(1.0), FindingVerdict::Worse),
            finding(None, FindingVerdict::Doubtful),
            finding(Some(3.0), FindingVerdict::Worse),
        ];
        by_gravity(&mut all);
        assert_eq!(all.map(|finding| finding.weight), [Some(3.0), Some(1.0), None, Some(9.0)]);
    }

    #[test]
    fn numbers_are_short() {
        let texts = [0.0, 5.0, 0.125, 12.345, 1234.5, 0.0004, 100.0].map(number);
        assert_eq!(texts, ["0", "5", "0.125", "12.3", "1234", "0", "100"]);
    }

    /// Before the sandbox, and in records without what was measured, a reason stood there as the sentence and as a finding.
    #[test]
    fn a_sentence_is_not_repeated_as_a_finding() {
        let reason = Reason::new(Dimension::Behavior, Finding::BehaviorGap { gap: EvidenceGap::NotMeasured });
        let other = Reason::new(Dimension::Behavior, Finding::Estimated);
        let [text, estimate] = [&reason, &other].map(holdpoint_wording::reason);
        let why = base_rationale(&EvidenceFile::default(), &[reason, other], Dimension::Behavior);
        assert_eq!(why.decisive, text);
        let found: Vec<&str> = why.findings.iter().map(|finding| finding.text.as_str()).collect();
        assert_eq!(found, [estimate]);
    }

    /// Regression: an explanation named 40 of 120 failed episodes, but not that the version's code traps in them.
    #[test]
    fn faults_of_code_come_first() {
        use crate::embedded;
        use holdpoint_body::CodeFault;
        use holdpoint_governance::permission::{PermissionUse, PermissionsUsed};
        use holdpoint_runtime::capability::Capability;

        let name = embedded::names().next().unwrap();
        let version = Capability::load(name, embedded::package(name).unwrap()).unwrap();
        let with = |fault| {
            let used = PermissionsUsed { faults: [(fault, 40)].into(), ..PermissionsUsed::default() };
            let (declared, code) = (&version.manifest.permissions, version.bundle.interface());
            let permissions = Some(PermissionUse::new(declared, &code, &used, 120));
            EvidenceFile { permissions, ..EvidenceFile::default() }
        };
        let stop = HardStop::BudgetBreach;
        let reason = Reason::new(Dimension::Behavior, Finding::SandboxHardStop { stop });
        let view = rationale(&with(CodeFault::Trap), std::slice::from_ref(&reason), Dimension::Behavior);
        assert!(view.decisive.starts_with("its code traps in 40 of 120 tasks; "), "{}", view.decisive);
        let view = rationale(&with(CodeFault::Fuel), &[reason], Dimension::Behavior);
        assert!(view.decisive.ends_with("its code computed beyond its budget"), "{}", view.decisive);
    }

    #[test]
    fn an_unassessed_version_has_no_rationale() {
        assert!(rationales(&EvidenceFile::default(), &[]).is_empty());
    }
}
