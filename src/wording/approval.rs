//! The renderer: what the facts of a question say, line by line.
//!
//! A pure function. If you change a word of it, raise [`RENDERER_VERSION`]: open requests signed over other lines are
//! then void and asked again. Closed requests keep their own lines.

use holdpoint_governance::decision::{Reason, ReasonCode};
use holdpoint_governance::profile::titled;
use holdpoint_governance::risk::RiskClass;
use holdpoint_governance::submission::Risk;
use holdpoint_protocol::approval_document::{ApprovalFacts, RequestedSigner};
use holdpoint_protocol::event::DimensionResult;
use holdpoint_protocol::snapshot::RequestKind;
use holdpoint_text::Untrusted;

use crate::counted_try;
use crate::coverage::{covered_starts, outside_response};
use crate::request::{drift_response, untested};

/// Version of the words below and of those in [`crate::request`].
pub const RENDERER_VERSION: u32 = 3;

/// The longest line, columns; a screen wraps them.
const WIDTH_MAX: usize = 400;

/// The digits of the candidate's digest that name it for short.
const SHORT_ID_DIGITS: usize = 4;

/// The lines of a request: all that an approver reads before the answer, sanitized, one sentence each.
#[must_use]
pub fn render(facts: &ApprovalFacts) -> Vec<String> {
    let mut lines = vec![title(facts)];
    lines.extend(facts.asked.as_ref().map(signer_line));
    if facts.purpose == RequestKind::Emergency {
        lines.push("Two others review it later, or it is rolled back; it is flagged until then".to_owned());
    }
    if !facts.about.is_empty() {
        lines.push(facts.about.clone());
    }
    lines.push(rollback_target(facts));
    let requested_by = facts.asked_by.as_ref().map_or_else(String::new, |by| format!("; requested by {by}"));
    lines.push(format!(
        "It is {}; written by {}, registered by {}{requested_by}",
        facts.state,
        facts.author.label(),
        facts.requester.name()
    ));
    let assessed = facts.assessed.as_ref().map_or_else(|| "high (not assessed)".to_owned(), RiskClass::label);
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
    lines.extend(facts.untested.iter().map(|what| format!("Not tested: {}", untested(*what))));
    lines.extend(facts.on_drift.iter().map(|drift| format!("If it gets worse: {}", drift_response(drift))));
    lines.push(deadline_line(facts));
    lines.push(bound_to(facts));
    lines.into_iter().map(|line| Untrusted::new(line).display(WIDTH_MAX).into_string()).collect()
}

fn title(facts: &ApprovalFacts) -> String {
    let (of, on) = (&facts.version, &facts.robot);
    let id: String = facts.candidate.to_string().chars().take(SHORT_ID_DIGITS).collect();
    let profile = titled(facts.profile, facts.site.as_ref());
    match facts.purpose {
        RequestKind::Activation => format!("Promote {of} ({id}) to active on {on}, profile {profile}?"),
        RequestKind::Release => format!("Release {of} ({id}) on {on}: lift its restriction?"),
        RequestKind::Review => format!("Was it right to let {of} ({id}) in alone, in an emergency, on {on}?"),
        RequestKind::Emergency => {
            format!("EMERGENCY: activate {of} ({id}) alone on {on}, profile {profile}?")
        }
    }
}

fn signer_line(person: &RequestedSigner) -> String {
    let RequestedSigner { name, role, void } = person;
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

fn rollback_target(facts: &ApprovalFacts) -> String {
    match (facts.purpose, &facts.replaces) {
        (RequestKind::Activation | RequestKind::Emergency, None) => {
            "Replaces nothing: the family has no active version".to_owned()
        }
        (RequestKind::Activation | RequestKind::Emergency, Some(replaced)) => {
            format!("Replaces {replaced}, which stays loaded as the rollback target")
        }
        (RequestKind::Release | RequestKind::Review, None) => "It has no rollback target".to_owned(),
        (RequestKind::Release | RequestKind::Review, Some(back)) => format!("The rollback target is {back}"),
    }
}

fn evidence(facts: &ApprovalFacts, lines: &mut Vec<String>) {
    lines.extend(facts.dimensions.iter().map(|dimension| format!("Evidence: {}", dimension_line(dimension))));
    if let Some(pairs) = &facts.pairs {
        let ([low, high], [active_low, active_high]) = (pairs.candidate_interval, pairs.active_interval);
        lines.push(format!(
            "Sandbox: {} paired episodes, success {:.3} [{low:.3}, {high:.3}] against {:.3} [{active_low:.3}, \
             {active_high:.3}]",
            pairs.n, pairs.candidate, pairs.active
        ));
    }
    if let Some(counted) = &facts.counted {
        lines.push(format!("Evidence: {}", counted_try(&facts.version.family, counted)));
    }
    if let Some(shadow) = &facts.shadow {
        lines.push(format!(
            "Shadow: {} sequences, divergence output {:.3}, governance {:.3}, envelope {:.3}",
            shadow.n, shadow.output, shadow.governance, shadow.envelope
        ));
    }
    lines.extend(facts.covers.iter().map(|covers| {
        let (covered, response) = (covered_starts(&covers.domain), outside_response(covers.outside));
        format!("Covered: {covered}; outside: {response}")
    }));
    lines.extend(facts.reasons.iter().map(|reason| format!("Asked because: {}", reason_line(reason))));
    lines.extend(facts.why.iter().map(|line| format!("Why: {line}")));
}

fn deadline_line(facts: &ApprovalFacts) -> String {
    let Some(until) = facts.until else { return "Without a decision the version stays on hold".to_owned() };
    let by = until.label();
    match facts.purpose {
        RequestKind::Activation => format!("If no one decides by {by}, the version stays on hold"),
        RequestKind::Release => format!("If no one decides by {by}, the version stays restricted"),
        RequestKind::Review => {
            format!(
                "If no one decides by {by}, the version is rolled back; nothing of its family is promoted before"
            )
        }
        RequestKind::Emergency => format!("If no one decides by {by}, the version stays on hold"),
    }
}

fn bound_to(facts: &ApprovalFacts) -> String {
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
    let (name, limit, outcome) = (result.dimension.name(), result.threshold, result.outcome);
    format!("{name} {value}{interval} (at least {limit:.2}) {outcome}{basis}")
}

fn reason_line(reason: &Reason) -> String {
    format!("{}: {}", reason.code, crate::reason(reason))
}
