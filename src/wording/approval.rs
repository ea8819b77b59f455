//! The renderer: what the facts of a question say, line by line.
//!
//! A pure function. If you change a word of it, raise [`RENDERER_VERSION`]: open requests signed over other lines are
//! then void and asked again. Closed requests keep their own lines.
//!
//! The order: the verdict with its failures, the question and who is asked, the risk and the author's summary, what
//! changes, what was measured, what was not tested and not covered, what earlier signers wrote, and what a signature does.

use holdpoint_governance::decision::{Reason, ReasonCode};
use holdpoint_governance::evidence::StaleCause;
use holdpoint_governance::outcome::DimensionOutcome;
use holdpoint_governance::profile::titled;
use holdpoint_governance::risk::RiskCause;
use holdpoint_governance::submission::Risk;
use holdpoint_protocol::approval_document::{
    ApprovalFacts, EarlierSignature, RequestedSigner, SignatureEffect,
};
use holdpoint_protocol::event::DimensionResult;
use holdpoint_protocol::snapshot::RequestKind;
use holdpoint_text::Untrusted;

use crate::condition::condition_of_use;
use crate::counted_try;
use crate::coverage::{covered_starts, outside_response};
use crate::request::{drift_response, untested};
use crate::version_diff;

/// Version of the words below and of those in [`crate::request`].
pub const RENDERER_VERSION: u32 = 6;

/// The longest line, columns; a screen wraps them.
const WIDTH_MAX: usize = 400;

/// The digits of the candidate's digest that name it for short.
const SHORT_ID_DIGITS: usize = 4;

/// What a line is about, for its color. Made of the signed facts, and no part of what is signed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LineMark {
    /// Nothing in particular.
    #[default]
    Plain,
    /// The question itself.
    Question,
    /// Every check passed.
    Good,
    /// A check or its evidence failed.
    Failure,
    /// Something to look at before signing.
    Caution,
}

/// A line of a request, and what it is about.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RequestLine {
    /// One sentence, sanitized.
    pub text: String,
    /// What it is about.
    pub mark: LineMark,
}

/// The lines of a request: all that an approver reads before the answer, sanitized, one sentence each.
#[must_use]
pub fn render(facts: &ApprovalFacts) -> Vec<String> {
    marked_lines(facts).into_iter().map(|line| line.text).collect()
}

/// As [`render`], each line with its mark.
#[must_use]
pub fn marked_lines(facts: &ApprovalFacts) -> Vec<RequestLine> {
    let mut lines = Lines::default();
    verdict(facts, &mut lines);
    lines.add(LineMark::Question, title(facts));
    let asked = facts.asked.as_ref().map(|person| signer_line(person, &facts.signed_before));
    lines.extend(LineMark::Plain, asked);
    if facts.purpose == RequestKind::Emergency {
        let review = "Two others review it later, or it is demoted; it is flagged until then";
        lines.add(LineMark::Caution, review.to_owned());
    }
    if !facts.about.is_empty() {
        lines.add(LineMark::Plain, facts.about.clone());
    }
    lines.add(LineMark::Plain, rollback_target(facts));
    lines.add(if facts.risk == Risk::High { LineMark::Caution } else { LineMark::Plain }, risk_line(facts));
    let requested_by = facts.asked_by.as_ref().map_or_else(String::new, |by| format!("; requested by {by}"));
    let (author, requester) = (facts.author.label(), facts.requester.name());
    lines.add(LineMark::Plain, format!("Written by {author}, registered by {requester}{requested_by}"));
    let summary = match facts.summary.trim() {
        "" => "The author gave no summary".to_owned(),
        summary => format!("Summary of the author: {summary}"),
    };
    lines.add(LineMark::Plain, summary);
    if let Some(deployment) = facts.deployment {
        lines.add(LineMark::Plain, format!("Deployment outcome so far: {deployment}"));
    }
    lines.extend(
        LineMark::Caution,
        facts.reasons.iter().map(|reason| format!("Asked because: {}", reason_line(reason))),
    );
    changes(facts, &mut lines);
    evidence(facts, &mut lines);
    gaps(facts, &mut lines);
    lines.extend(
        LineMark::Plain,
        facts.on_drift.iter().map(|drift| format!("If it gets worse: {}", drift_response(drift))),
    );
    lines.extend(LineMark::Plain, facts.signed_before.iter().map(earlier_signature));
    lines.extend(LineMark::Caution, facts.effect.map(|effect| effect_line(facts, effect)));
    lines.add(LineMark::Plain, deadline_line(facts));
    lines.0
}

/// The lines so far.
#[derive(Default)]
struct Lines(Vec<RequestLine>);

impl Lines {
    fn add(&mut self, mark: LineMark, text: String) {
        let text = Untrusted::new(text).display(WIDTH_MAX).into_string();
        self.0.push(RequestLine { text, mark });
    }

    fn extend(&mut self, mark: LineMark, texts: impl IntoIterator<Item = String>) {
        for text in texts {
            self.add(mark, text);
        }
    }
}

/// How far a check speaks for the version.
#[derive(Clone, Copy, PartialEq, Eq)]
enum CheckSupport {
    Passed,
    Restricted,
    LeftToPeople,
    Undecided,
    Failed,
}

const fn support(outcome: DimensionOutcome) -> CheckSupport {
    match outcome {
        DimensionOutcome::Compatible => CheckSupport::Passed,
        DimensionOutcome::Conditional | DimensionOutcome::Suspicious | DimensionOutcome::Fragile => {
            CheckSupport::Restricted
        }
        DimensionOutcome::Review => CheckSupport::LeftToPeople,
        DimensionOutcome::Inconclusive | DimensionOutcome::NoData => CheckSupport::Undecided,
        DimensionOutcome::Incompatible => CheckSupport::Failed,
    }
}

/// The verdict of the checks, first the form of the code where it is a component; then one line for each failure.
fn verdict(facts: &ApprovalFacts, lines: &mut Lines) {
    let count = |of: CheckSupport| facts.dimensions.iter().filter(|one| support(one.outcome) == of).count();
    let (failed, undecided) = (count(CheckSupport::Failed), count(CheckSupport::Undecided));
    let (restricted, people) = (count(CheckSupport::Restricted), count(CheckSupport::LeftToPeople));
    let all = facts.dimensions.len();
    let component = facts.component.as_ref().map_or_else(String::new, |component| {
        let replaces = component.replaces.as_ref();
        let replaces = replaces.map_or_else(String::new, |code| format!(" in place of {code}"));
        format!(", a WebAssembly component ({}{replaces}),", component.file)
    });
    let version = format!("{}{component}", facts.version);
    let limits: Vec<String> =
        [(restricted, "under a restriction"), (people, "left to people"), (undecided, "undecided")]
            .into_iter()
            .filter(|(count, _)| *count > 0)
            .map(|(count, what)| format!("; {count} {what}"))
            .collect();
    let limits = limits.concat();
    let (mark, text) = if all == 0 {
        (LineMark::Caution, format!("{version} was not assessed"))
    } else if failed > 0 {
        let despite = despite_failures(facts.purpose, failed);
        (LineMark::Failure, format!("{version} FAILS {failed} of {all} checks{limits}; {despite}"))
    } else if undecided > 0 {
        (LineMark::Caution, format!("{version} fails none of {all} checks{limits}"))
    } else if limits.is_empty() {
        (LineMark::Good, format!("{version} passes all {all} checks"))
    } else {
        (LineMark::Caution, format!("{version} passes all {all} checks{limits}"))
    };
    lines.add(mark, text);
    lines.extend(LineMark::Failure, stale_evidence(&facts.stale));
    let failed = facts.dimensions.iter().filter(|one| support(one.outcome) == CheckSupport::Failed);
    lines.extend(LineMark::Failure, failed.map(|failed| format!("FAILS {}", dimension_line(failed))));
    lines.extend(LineMark::Failure, facts.failures.iter().map(|why| format!("FAILS because: {why}")));
}

/// Why evidence is stale; absent while it counts.
#[must_use]
pub fn stale_evidence(causes: &[StaleCause]) -> Option<String> {
    let names: Vec<&str> = causes.iter().map(|cause| cause.name()).collect();
    (!names.is_empty()).then(|| format!("STALE, measured under another {}", names.join(", ")))
}

/// What becomes of failed checks: without people's approval the rules would have rejected the version.
const fn despite_failures(purpose: RequestKind, failed: usize) -> &'static str {
    match (purpose, failed) {
        (RequestKind::Activation, 1) => "the signatures waive it",
        (RequestKind::Activation, _) => "the signatures waive them",
        (RequestKind::Emergency, _) => "break-glass activates it all the same",
        (RequestKind::Release | RequestKind::Review, _) => "it is active all the same",
    }
}

/// The computed class with its causes, and who may sign.
fn risk_line(facts: &ApprovalFacts) -> String {
    let assessed = facts.assessed.as_ref().map_or_else(
        || "high: it is not assessed".to_owned(),
        |assessed| {
            let causes: Vec<&str> = assessed.causes.iter().map(|cause| risk_cause(*cause)).collect();
            let class = assessed.class;
            if causes.is_empty() {
                format!("{class}: it changes parameters alone, by a known author")
            } else {
                format!("{class}: {}", causes.join(", "))
            }
        },
    );
    let needed = match (facts.needed, facts.risk) {
        (1, Risk::High) => "takes a safety officer".to_owned(),
        (needed, Risk::High) => format!("takes {needed} people, a safety officer among them"),
        (1, Risk::Low | Risk::Medium) => "takes 1 person".to_owned(),
        (needed, Risk::Low | Risk::Medium) => format!("takes {needed} people"),
    };
    format!("Computed risk {assessed}; {needed}")
}

const fn risk_cause(of: RiskCause) -> &'static str {
    match of {
        RiskCause::Component => "it brings a component",
        RiskCause::NewCode => "its code is new",
        RiskCause::BundleForm => "its code comes in another form",
        RiskCause::MoreZones => "it may enter more zones",
        RiskCause::MoreAuthority => "it may decide more by itself",
        RiskCause::NothingActive => "no active version to compare it with",
        RiskCause::MorePermissions => "it has more permissions",
        RiskCause::MoreSpeed => "it may move faster",
        RiskCause::MoreForce => "it may press harder",
        RiskCause::FirstOfAuthor => "no signed version of its author was confirmed here",
        RiskCause::Estimated => "its author estimates so",
    }
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

fn signer_line(person: &RequestedSigner, signed_before: &[EarlierSignature]) -> String {
    let RequestedSigner { name, role, void } = person;
    let counts = match void {
        None if signed_before.iter().any(|signature| signature.name == *name) => {
            "your approval is recorded and counts as one".to_owned()
        }
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

fn changes(facts: &ApprovalFacts, lines: &mut Lines) {
    let new = &facts.new_permissions;
    let mark = if new.is_empty() { LineMark::Plain } else { LineMark::Caution };
    lines.add(mark, format!("New permissions: {}", listed(new)));
    let changes = version_diff::folded_lines(&facts.changes);
    if changes.is_empty() {
        let none = "Changes: none known of permissions, parameters and interface";
        lines.add(LineMark::Plain, none.to_owned());
    }
    lines.extend(LineMark::Plain, changes.iter().map(|line| format!("Change: {line}")));
    let conditions =
        facts.conditions.iter().map(|condition| format!("Condition: {}", condition_of_use(condition)));
    lines.extend(LineMark::Plain, conditions);
}

/// What was measured, without the failed checks.
fn evidence(facts: &ApprovalFacts, lines: &mut Lines) {
    for dimension in &facts.dimensions {
        let mark = match support(dimension.outcome) {
            CheckSupport::Passed => LineMark::Plain,
            CheckSupport::Restricted | CheckSupport::LeftToPeople | CheckSupport::Undecided => {
                LineMark::Caution
            }
            CheckSupport::Failed => continue,
        };
        lines.add(mark, format!("Evidence: {}", dimension_line(dimension)));
    }
    if let Some(pairs) = &facts.pairs {
        let ([low, high], [active_low, active_high]) = (pairs.candidate_interval, pairs.active_interval);
        let text = format!(
            "Sandbox: {} paired episodes, success {:.3} [{low:.3}, {high:.3}] against {:.3} [{active_low:.3}, \
             {active_high:.3}]",
            pairs.n, pairs.candidate, pairs.active
        );
        lines.add(LineMark::Plain, text);
    }
    let counted = facts.counted.as_ref();
    lines.extend(
        LineMark::Plain,
        counted.map(|counted| format!("Evidence: {}", counted_try(&facts.version.family, counted))),
    );
    let shadow = facts.shadow.as_ref();
    lines.extend(
        LineMark::Plain,
        shadow.map(|shadow| format!("Shadow: {} sequences beside the active version", shadow.n)),
    );
    lines.extend(LineMark::Plain, facts.why.iter().map(|line| format!("Why: {line}")));
}

/// What was not tested, and what the evidence does not cover.
fn gaps(facts: &ApprovalFacts, lines: &mut Lines) {
    if facts.untested.is_empty() {
        lines.add(LineMark::Plain, "Not tested: nothing is known to be missing".to_owned());
    }
    let missing = facts.untested.iter().map(|what| format!("Not tested: {}", untested(*what)));
    lines.extend(LineMark::Caution, missing);
    match &facts.covers {
        Some(covers) => {
            lines.add(LineMark::Plain, format!("Covered starts: {}", covered_starts(&covers.domain)));
            let response = outside_response(covers.outside);
            lines.add(LineMark::Caution, format!("Not covered: every other start; {response}"));
        }
        None => lines.add(LineMark::Caution, "Not covered: the covered starts are not known".to_owned()),
    }
}

fn earlier_signature(of: &EarlierSignature) -> String {
    let EarlierSignature { name, role, at, reason } = of;
    format!("{name}, {role}, signed {}: {reason}", at.label())
}

/// What the reader's signature does; the reader's approval counts.
fn effect_line(facts: &ApprovalFacts, effect: SignatureEffect) -> String {
    match (effect, facts.purpose) {
        (SignatureEffect::MoreNeeded, _) => {
            let number = facts.signed_before.len() + 1;
            let needed = usize::try_from(facts.needed).unwrap_or(usize::MAX);
            let officer = if number >= needed { "; a safety officer has to sign, too" } else { "" };
            format!("Your signature is number {number} of {needed} and takes no effect alone{officer}")
        }
        (SignatureEffect::Completes, RequestKind::Activation) => {
            "Your signature is the last: it takes the arm after this sequence".to_owned()
        }
        (SignatureEffect::Completes, RequestKind::Emergency) => {
            "Your signature alone is enough: it takes the arm".to_owned()
        }
        (SignatureEffect::Completes, RequestKind::Release) => {
            "Your signature is the last: it lifts the restriction".to_owned()
        }
        (SignatureEffect::Completes, RequestKind::Review) => {
            "Your signature is the last: the version stays, and the review ends".to_owned()
        }
    }
}

fn deadline_line(facts: &ApprovalFacts) -> String {
    let Some(until) = facts.until else { return "Without a decision the version stays on hold".to_owned() };
    let by = until.label();
    match facts.purpose {
        RequestKind::Activation => format!("If no one decides by {by}, the version stays on hold"),
        RequestKind::Release => format!("If no one decides by {by}, the version stays restricted"),
        RequestKind::Review => {
            format!(
                "If no one decides by {by}, the version is demoted; no version of its family is promoted before"
            )
        }
        RequestKind::Emergency => format!("If no one decides by {by}, the version stays on hold"),
    }
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
