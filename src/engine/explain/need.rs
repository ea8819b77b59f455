//! Which rule a reason belongs to, what was measured for it, and what would have to change.
//!
//! Counts are computed from the raw pairs and drills in the record by the rule's own statistics, never guessed: a
//! number of episodes is the smallest that brings the rule's bound within its limit.

use super::Rule;
use super::seen::{Component, Dossier, Reason, Values};
use holdpoint_governance::rollback::RungFailure;
use holdpoint_governance::stats::{PairedCounts, binary_pairs};

/// The error rate of the one-sided upper bound that the behavioural rule asks for (design rule 3.4).
const UPPER_ALPHA: f64 = 0.05;

/// The rule about people.
pub(super) const APPROVAL: Rule =
    Rule { name: "approval by people", source: "design rule 3.10; paper section 5.2, stage 5" };

/// The rule that decides a stage.
pub(super) fn rule_of_stage(stage: &str) -> Rule {
    let (name, source) = match stage {
        "validation" => (
            "Psi over the four compatibilities",
            "design rules 3.2, 3.3, 3.6; paper section 4.3, Procedures 1 and 2",
        ),
        "sandbox" => (
            "Psi over measured behaviour and rehearsed recovery",
            "design rules 3.4 to 3.6; paper section 4.3, Procedure 2",
        ),
        "shadow" => {
            ("Delta_shadow, live work against its twin", "design rules 3.7, 5.4; paper section 5.2, stage 4")
        }
        "activation" => {
            ("theta_act, the activation gate", "design rule 3.7; paper equation 10, section 5.2, stage 5")
        }
        "monitor" => ("M, the monitor", "design rule 3.8; paper equation 11, section 5.2, stage 6"),
        "rollback" => ("the rollback ladder", "design rule 3.11; paper section 5.2, stage 7, appendix F.3"),
        _ => ("the lifecycle", "design rule 3.9; paper appendix A"),
    };
    Rule { name, source }
}

/// The rule that a reason's dimension belongs to.
pub(super) fn rule_of(dimension: &str) -> Rule {
    let (name, source) = match dimension {
        "interface" => ("kappa_I", "design rule 3.2; paper section 4.3, Procedure 1"),
        "policy" => ("kappa_P", "design rule 3.3; paper section 4.3, Procedure 1"),
        "behavior" => ("kappa_B", "design rule 3.4; paper section 4.3, Table 3"),
        "recovery" => ("kappa_R", "design rule 3.5; paper section 4.3"),
        "composition" => ("Psi", "design rule 3.6; paper Procedure 2"),
        "shadow" => ("Delta_shadow", "design rule 3.7; paper section 5.2, stage 4"),
        "gate" => ("theta_act", "design rule 3.7; paper equation 10"),
        "approval" => return APPROVAL,
        "monitor" => ("M", "design rule 3.8; paper equation 11"),
        _ => ("the rules", "design, chapter 3"),
    };
    Rule { name, source }
}

/// Whether a reason speaks for the version: nothing has to change for it.
#[must_use]
pub fn is_in_favour(code: &str) -> bool {
    const GOOD: [&str; 8] = [
        "behavior-improved",
        "composition-eligible",
        "shadow-clean",
        "gate-passed",
        "approval-granted",
        "approval-not-needed",
        "monitor-healthy",
        "monitor-confirmed",
    ];
    code.ends_with("-compatible") || GOOD.contains(&code)
}

/// The component a behavioural reason is about: its text begins with the name.
fn component<'a>(reason: &Reason, dossier: &'a Dossier) -> Option<&'a Component> {
    let behavior = dossier.behavior.as_ref().filter(|_| reason.dimension == "behavior")?;
    behavior.components.iter().find(|component| reason.text.starts_with(&component.name))
}

/// What was measured for a reason, where the evidence tells more than the reason.
pub(super) fn measured(reason: &Reason, dossier: &Dossier) -> Option<String> {
    if let Some(component) = component(reason, dossier) {
        let n = dossier.behavior.as_ref().map_or(0, |behavior| behavior.pairs);
        let Component { name, worsening, lower, upper, tolerance } = component;
        let upper =
            upper.map_or_else(|| "no upper bound".to_owned(), |upper| format!("95 % bound {upper:.3}"));
        return Some(format!(
            "{name} {worsening:+.3} over n = {n} pairs, at least {lower:.3}, {upper}, tolerance {tolerance:.3}"
        ));
    }
    if reason.dimension == "recovery" && reason.code != "recovery-no-data" {
        let (candidate, active) = dossier.drills.as_ref()?;
        let kinds: Vec<String> = candidate
            .each()
            .into_iter()
            .zip(active.each())
            .filter(|((_, tally), _)| tally.feasible() > 0)
            .map(|((kind, new), (_, old))| {
                format!("{kind} {}/{} (active {}/{})", new.passed, new.feasible(), old.passed, old.feasible())
            })
            .collect();
        return (!kinds.is_empty()).then(|| format!("drills passed: {}", kinds.join(", ")));
    }
    if reason.dimension == "shadow" {
        let shadow = dossier.shadow.as_ref()?;
        return Some(format!("n = {} shadow sequences", shadow.sequences));
    }
    None
}

/// What would have to change for a reason to go away; `None` where it speaks for the version.
pub(super) fn change(reason: &Reason, dossier: &Dossier) -> Option<String> {
    if is_in_favour(&reason.code) || reason.code == "composition-restricted" {
        return None;
    }
    let text = match reason.code.as_str() {
        "behavior-established-worse" | "behavior-suspicious" | "behavior-safety-traded" => {
            component(reason, dossier).map_or_else(|| against(reason), |found| behaviour(found, dossier))
        }
        "behavior-no-data" | "composition-no-data" => {
            "it has to be measured: the next stage does that".to_owned()
        }
        // The end of an evaluation is no demand of its own: what ended it stands beside it.
        "behavior-ended-early" | "recovery-ended-early" => return None,
        "behavior-inconclusive" => format!("more paired episodes are needed: {}", against(reason)),
        "behavior-hard-stop" => {
            "the event has to be made impossible: one of them ends an evaluation".to_owned()
        }
        "recovery-rollback-below-floor" => drills(reason, dossier),
        "recovery-below-threshold"
        | "recovery-far-below-floor"
        | "recovery-fragile"
        | "recovery-conditional" => weakest(reason, dossier),
        "recovery-established-worse" | "recovery-leaning" => {
            format!("they have to pass as often as the active version's: {}", against(reason))
        }
        "recovery-no-data" | "shadow-no-data" | "gate-no-data" | "interface-no-data" | "policy-no-data" => {
            format!("evidence is missing: {}", reason.text)
        }
        "recovery-hook-missing" => format!("export the hook: {}", reason.text),
        "recovery-fallback-unresolved" => "bind a fallback that is registered and may take over".to_owned(),
        "recovery-signal-unknown" => format!("declare failure signals the watcher knows: {}", reason.text),
        "recovery-predecessor-not-loadable" => {
            "the predecessor has to load and be true to its digest".to_owned()
        }
        "interface-version-mislabelled" => format!("raise the version number by more: {}", reason.text),
        "interface-export-mismatch" => format!("manifest and code have to say the same: {}", reason.text),
        "interface-dependency-breaking" | "interface-dependency-adaptable" => {
            format!("name a dependency the registry can meet: {}", reason.text)
        }
        "interface-signature-adaptable" | "interface-schema-adaptable" | "interface-condition-adaptable" => {
            format!("an adapter carries it; without one, declare it as before: {}", reason.text)
        }
        "interface-signature-breaking" | "interface-schema-breaking" | "interface-condition-breaking" => {
            format!("declare it as the active version does (type, unit, frame, range): {}", reason.text)
        }
        "policy-uncovered-high-risk" | "policy-uncovered-mode" | "policy-below-threshold" => {
            format!("a policy has to cover it, or the manifest must not reach it: {}", reason.text)
        }
        "policy-forbidden-mode" => format!("the manifest must not reach it: {}", reason.text),
        "policy-undeclared-import" => format!("declare the permission, or do not use it: {}", reason.text),
        "policy-environment-not-admitted" => format!("admit this profile in [deployment]: {}", reason.text),
        "policy-authority-review" | "policy-escalation" | "policy-new-permission" => {
            format!("ask for less, or have people review it: {}", reason.text)
        }
        "approval-pending" => missing_people(reason),
        "approval-refused" => "people would have to approve a new registration".to_owned(),
        "approval-timeout" => {
            "people have to answer by the deadline; `holdpoint resume` asks again".to_owned()
        }
        "gate-frozen" => "the freeze has to end".to_owned(),
        "gate-no-improvement" => "an improvement over the active version has to be established".to_owned(),
        "gate-stale-evidence" => "the stages have to be run again under what holds now".to_owned(),
        "shadow-governance-divergence" => {
            format!(
                "the twin may not have more policy hits or watcher events than the live world: {}",
                against(reason)
            )
        }
        "shadow-output-divergence" | "shadow-envelope-divergence" | "shadow-leaning" => {
            format!("it only lengthens shadow: {}", against(reason))
        }
        "monitor-safety-trip" => "no safety event: the first one takes a version off".to_owned(),
        "monitor-rate-trip" | "monitor-rate-warning" => {
            format!("the rate has to stay as it was measured before activation: {}", against(reason))
        }
        "monitor-telemetry-missing" => format!("telemetry has to arrive: {}", against(reason)),
        "monitor-escalation-unanswered" => "somebody has to answer an escalation by its deadline".to_owned(),
        "monitor-operator" => "a person asked for it".to_owned(),
        _ => against(reason),
    };
    Some(text)
}

/// What would have to be otherwise for a rung to hold.
pub(super) const fn of_failure(failure: RungFailure) -> &'static str {
    match failure {
        RungFailure::HookFailed => "the safe-abort hook has to bring the arm to a stand in its declared time",
        RungFailure::NoStandstill => {
            "every joint has to stand within a second of the interrupt: look at the arm"
        }
        RungFailure::RetreatBlocked => "the way up has to be free: look at the arm",
        RungFailure::PredecessorMissing => "there has to be a superseded version to go back to",
        RungFailure::DigestMismatch => {
            "the predecessor in the store has to be what was registered: verify the audit"
        }
        RungFailure::PolicyMismatch => "the policies in force have to be those of the profile",
        RungFailure::StoreFailed => "the store has to be readable and writable",
        RungFailure::PredecessorFailed => "the predecessor has to give a command that its guard passes",
        RungFailure::NotRecovered => "the predecessor has to work without a safety event",
    }
}

/// The reason with its number against its limit.
fn against(reason: &Reason) -> String {
    match (reason.evidence, reason.limit) {
        (Some(found), Some(limit)) => format!("{} ({found:.3} against a limit of {limit:.3})", reason.text),
        _ => reason.text.clone(),
    }
}

fn behaviour(component: &Component, dossier: &Dossier) -> String {
    let Component { name, worsening, upper, tolerance, .. } = component;
    let bound = upper.map_or_else(|| "unbounded".to_owned(), |upper| format!("95 % bound {upper:.3}"));
    let fewer = fewer(component, dossier)
        .map_or_else(String::new, |(fewer, all)| format!(": {fewer} fewer of {all} episodes"));
    format!("{name} {worsening:+.3} ({bound}) must be at most {tolerance:.3}{fewer}")
}

/// How many episodes fewer may be worse for the upper bound to come within the tolerance. Absent for what is not
/// counted per episode (time, retries).
fn fewer(component: &Component, dossier: &Dossier) -> Option<(u64, u64)> {
    let bad: fn(&Values) -> bool = match component.name.as_str() {
        "success" => |values| !values.success,
        "violation" => |values| values.violation,
        "anomaly" => |values| values.anomaly,
        "recovery" => |values| values.recovery,
        _ => return None,
    };
    let counts = PairedCounts::of(dossier.pairs.iter().map(|pair| (bad(&pair.candidate), bad(&pair.active))));
    let fits = |fewer: u64| {
        let counts = PairedCounts { candidate_only: counts.candidate_only.checked_sub(fewer)?, ..counts };
        let bound = binary_pairs(counts, UPPER_ALPHA).ok()?;
        Some(bound.upper <= component.tolerance)
    };
    (0..=counts.candidate_only).find(|less| fits(*less) == Some(true)).map(|less| (less, counts.pairs))
}

/// `rollback drills passed 26 of 40; 28 are needed`.
fn drills(reason: &Reason, dossier: &Dossier) -> String {
    let (Some((candidate, _)), Some(floor)) = (&dossier.drills, reason.limit) else { return against(reason) };
    let (passed, all) = (candidate.rollback.passed, candidate.rollback.feasible());
    match needed(floor, all) {
        Some(needed) => format!("rollback drills passed {passed} of {all}; {needed} are needed"),
        None => against(reason),
    }
}

/// The fewest of `all` whose share is at least `floor`.
fn needed(floor: f64, all: u64) -> Option<u64> {
    (0..=all).find(|passed| all > 0 && *passed as f64 / all as f64 >= floor)
}

/// The drills that pull recovery down.
fn weakest(reason: &Reason, dossier: &Dossier) -> String {
    let low =
        dossier.drills.as_ref().and_then(|(candidate, _)| {
            let share = |passed: u64, all: u64| passed as f64 / all as f64;
            candidate.each().into_iter().filter(|(_, tally)| tally.feasible() > 0).min_by(|(_, a), (_, b)| {
                share(a.passed, a.feasible()).total_cmp(&share(b.passed, b.feasible()))
            })
        });
    let limit = reason.limit.map_or_else(String::new, |limit| format!(", at least {limit:.3} is needed"));
    let found = reason.evidence.map_or_else(String::new, |found| format!(" {found:.3}{limit}"));
    match low {
        Some((kind, tally)) => {
            let (passed, all) = (tally.passed, tally.feasible());
            format!("recovery{found}; weakest are the {kind} drills, {passed} of {all} passed")
        }
        None => against(reason),
    }
}

/// `approval by 1 more person`.
fn missing_people(reason: &Reason) -> String {
    match reason.evidence {
        Some(missing) if missing >= 0.5 => {
            let people = if missing < 1.5 { "operator" } else { "operators" };
            format!("approval by {missing:.0} more {people}")
        }
        _ => against(reason),
    }
}

#[cfg(test)]
mod tests;
