//! The renderer: what the facts of a question say, line by line.
//!
//! A pure function. Whoever changes a word of it raises [`RENDERER_VERSION`]: what was signed over other lines and is still
//! open is void then, and asked again. What is closed keeps its own lines.

use super::{AskedPerson, QuestionFacts};
use crate::event::DimensionResult;
use crate::purpose::Purpose;
use holdpoint_governance::decision::{Reason, ReasonCode};
use holdpoint_governance::profile::titled;
use holdpoint_governance::risk::RiskClass;
use holdpoint_governance::submission::Risk;
use holdpoint_text::Untrusted;

/// Version of the words below.
pub const RENDERER_VERSION: u32 = 1;

/// The longest line, columns; a screen wraps them.
const WIDTH_MAX: usize = 400;

/// The digits of the candidate's digest that name it for short.
const SHORT_ID_DIGITS: usize = 4;

/// The lines of a question: all that a person reads before they answer, sanitised, one sentence each.
#[must_use]
pub fn render(facts: &QuestionFacts) -> Vec<String> {
    let mut lines = vec![title(facts)];
    lines.extend(facts.asked.as_ref().map(asked));
    if facts.purpose == Purpose::Emergency {
        lines
            .push("Two others review it afterwards, or it is taken off; it is flagged until then".to_owned());
    }
    if !facts.about.is_empty() {
        lines.push(facts.about.clone());
    }
    lines.push(way_back(facts));
    let asked_by = facts.asked_by.as_ref().map_or_else(String::new, |by| format!("; {by} put this question"));
    lines.push(format!(
        "It is {}; written by {}, registered by {}{asked_by}",
        facts.state,
        facts.author.in_words(),
        facts.requester.name()
    ));
    let assessed =
        facts.assessed.as_ref().map_or_else(|| "high (not assessed)".to_owned(), RiskClass::in_words);
    let needed = match (facts.needed, facts.risk) {
        (1, Risk::High) => "takes a safety officer".to_owned(),
        (needed, Risk::High) => format!("takes {needed} people, a safety officer among them"),
        (1, Risk::Low | Risk::Medium) => "takes 1 person".to_owned(),
        (needed, Risk::Low | Risk::Medium) => format!("takes {needed} people"),
    };
    lines.push(format!("Risk {assessed}; {needed}"));
    if let Some(deployment) = facts.deployment {
        lines.push(format!("Deployment outcome so far: {deployment}"));
    }
    if !facts.stale.is_empty() {
        let causes: Vec<&str> = facts.stale.iter().map(|cause| cause.name()).collect();
        lines.push(format!("STALE, measured under another {}", causes.join(", ")));
    }
    evidence(facts, &mut lines);
    lines.push(format!("New permissions: {}", listed(&facts.new_permissions)));
    let changes = facts.changes.lines();
    if changes.is_empty() {
        lines.push("Changes: none known of permissions, parameters and interface".to_owned());
    }
    lines.extend(changes.iter().map(|line| format!("Change: {line}")));
    lines.extend(facts.conditions.iter().map(|condition| format!("Condition: {condition}")));
    if facts.untested.is_empty() {
        lines.push("Not tested: nothing is known to be missing".to_owned());
    }
    lines.extend(facts.untested.iter().map(|what| format!("Not tested: {what}")));
    lines.extend(facts.on_drift.iter().map(|drift| format!("If it gets worse: {drift}")));
    lines.push(unanswered(facts));
    lines.push(bound_to(facts));
    lines.into_iter().map(|line| Untrusted::new(line).display(WIDTH_MAX).into_string()).collect()
}

fn title(facts: &QuestionFacts) -> String {
    let (of, on) = (&facts.version, &facts.robot);
    let id: String = facts.candidate.to_string().chars().take(SHORT_ID_DIGITS).collect();
    let profile = titled(facts.profile, facts.site.as_ref());
    match facts.purpose {
        Purpose::Activation => format!("Promote {of} ({id}) to active on {on}, profile {profile}?"),
        Purpose::Release => format!("Release {of} ({id}) on {on}: lift its restriction?"),
        Purpose::Review => format!("Was it right to let {of} ({id}) in alone, in an emergency, on {on}?"),
        Purpose::Emergency => format!("EMERGENCY: let {of} ({id}) in alone on {on}, profile {profile}?"),
    }
}

fn asked(person: &AskedPerson) -> String {
    let AskedPerson { name, role, void } = person;
    let counts = match void {
        None => "your approval would count as one".to_owned(),
        Some(ReasonCode::ApprovalSelf) => {
            "your approval would NOT count: you wrote it, registered it or asked for this".to_owned()
        }
        Some(ReasonCode::ApprovalRole) => {
            "your approval would NOT count: your role does not reach this risk".to_owned()
        }
        Some(code) => format!("your approval would NOT count: {code}"),
    };
    format!("You are asked as {name}, {role}: {counts}; a refusal counts alone")
}

fn way_back(facts: &QuestionFacts) -> String {
    match (facts.purpose, &facts.replaces) {
        (Purpose::Activation | Purpose::Emergency, None) => {
            "Replaces nothing: the family has no active version".to_owned()
        }
        (Purpose::Activation | Purpose::Emergency, Some(replaced)) => {
            format!("Replaces {replaced}, which stays pinned as the way back")
        }
        (Purpose::Release | Purpose::Review, None) => "There is no way back from it".to_owned(),
        (Purpose::Release | Purpose::Review, Some(back)) => format!("The way back is {back}"),
    }
}

fn evidence(facts: &QuestionFacts, lines: &mut Vec<String>) {
    lines.extend(facts.dimensions.iter().map(|dimension| format!("Evidence: {}", dimension_line(dimension))));
    if let Some(pairs) = &facts.pairs {
        let ([low, high], [active_low, active_high]) = (pairs.candidate_interval, pairs.active_interval);
        lines.push(format!(
            "Sandbox: {} paired episodes, success {:.3} [{low:.3}, {high:.3}] against {:.3} [{active_low:.3}, \
             {active_high:.3}]",
            pairs.n, pairs.candidate, pairs.active
        ));
    }
    if let Some(shadow) = &facts.shadow {
        lines.push(format!(
            "Shadow: {} sequences, divergence output {:.3}, governance {:.3}, envelope {:.3}",
            shadow.n, shadow.output, shadow.governance, shadow.envelope
        ));
    }
    lines.extend(facts.reasons.iter().map(|reason| format!("Asked because: {}", reason_line(reason))));
    lines.extend(facts.why.iter().map(|line| format!("Why: {line}")));
}

fn unanswered(facts: &QuestionFacts) -> String {
    let Some(until) = facts.until else { return "Nobody answers: it stays held".to_owned() };
    let by = until.spoken();
    match facts.purpose {
        Purpose::Activation => format!("Nobody answers by {by}: it is held, never approved"),
        Purpose::Release => format!("Nobody answers by {by}: it stays restricted"),
        Purpose::Review => {
            format!("Nobody answers by {by}: it is taken off; nothing of its family is promoted before")
        }
        Purpose::Emergency => format!("Nobody answers by {by}: it stays held"),
    }
}

fn bound_to(facts: &QuestionFacts) -> String {
    format!(
        "Signed over candidate {}, evidence {}, policy {}",
        facts.candidate.short(),
        facts.evidence.short(),
        facts.policy.short()
    )
}

fn listed(items: &[String]) -> String {
    if items.is_empty() { "none".to_owned() } else { items.join(", ") }
}

/// One dimension with value, interval, limit and where it comes from.
#[must_use]
fn dimension_line(result: &DimensionResult) -> String {
    let value = result.kappa.map_or_else(|| "no data".to_owned(), |kappa| format!("{kappa:.3}"));
    let interval = result.interval.map_or_else(String::new, |[low, high]| format!(" [{low:.3}, {high:.3}]"));
    let basis = if result.measured { "" } else { ", estimated" };
    let (name, limit, outcome) = (result.dimension.words(), result.threshold, result.outcome);
    format!("{name} {value}{interval} (at least {limit:.2}) {outcome}{basis}")
}

fn reason_line(reason: &Reason) -> String {
    format!("{}: {}", reason.code, reason.code.told(&reason.text))
}
