//! The short explanation of a version in words, part by part: a front end arranges the lines.

use holdpoint_governance::behavior::BehaviorComponent;
use holdpoint_governance::evidence::{DrillKind, DrillTally};
use holdpoint_governance::explanation::{
    ActiveTerms, DecisionRemark, DecisiveReason, DrillComparison, EvidenceExtent, ExplanationSummary,
    FailureCounts, PassedCheck, PendingStep, ReasonContent, ReasonMeasurement, RecordMoment, Remedy,
    SummaryRemark, VersionPosition,
};
use holdpoint_governance::failure_cause::FailureCause;
use holdpoint_governance::finding::Finding;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::phase::WorkPhase;
use holdpoint_governance::record::ActivationCause;
use holdpoint_governance::rollback::PostStatus;
use holdpoint_governance::wall_time::WallTime;
use holdpoint_text::shell_word;

use crate::check::number;
use crate::condition::conditions_of_use;
use crate::coverage::covered_starts;
use crate::explanation::{
    amount, amount_size, component_noun, decision_remark, episode_reduction, permission_excess,
    reason_content, remedy, remedy_action,
};
use crate::finding::twin_signal;
use crate::past_limit::after_event;
use crate::stage::early_end;
use crate::{counted, counted_try, failure_cause, notice, reason, version_status};

/// The lines of a short explanation, each one sentence without a full stop.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SummaryLines {
    /// What the version is.
    pub head: String,
    /// The reasons against it, the strongest first.
    pub against: Vec<String>,
    /// How it is active, what it passed, and what its operators have to know.
    pub details: Vec<String>,
    /// What would change the result.
    pub changes: Vec<String>,
    /// What ends this; empty where nothing does.
    pub end: String,
    /// The next commands.
    pub commands: Vec<String>,
}

/// The short explanation in words. `data` is the folder that the commands have to name.
#[must_use]
pub fn summary_lines(of: &ExplanationSummary, data: Option<&str>) -> SummaryLines {
    let compared = of.compared.as_ref();
    let mut changes: Vec<String> = Vec::new();
    for change in of.remedies.iter().filter_map(brief_remedy) {
        let change = format!("to change: {change}");
        if !changes.contains(&change) {
            changes.push(change);
        }
    }
    SummaryLines {
        head: head(of),
        against: of.against.iter().map(|reason| decisive_reason(reason, compared)).collect(),
        details: details(of),
        changes,
        end: end(of),
        commands: commands(of, data),
    }
}

/// How many reasons are left out of a short explanation.
#[must_use]
pub fn omitted_reasons(count: usize) -> String {
    format!("and {count} more, which --full lists")
}

/// How many reasons of a decision stand under an earlier one.
#[must_use]
pub fn repeated_reasons(count: usize, record: u64) -> String {
    let reasons = if count == 1 { "reason" } else { "reasons" };
    format!("unchanged since the sandbox (record {record}): {count} {reasons}")
}

fn head(of: &ExplanationSummary) -> String {
    let ExplanationSummary { version, since, .. } = of;
    let (recorded, since) = (recorded(*since), since_moment(*since));
    match &of.position {
        VersionPosition::Rejected { stage, extent } => {
            format!("{version} was REJECTED {} ({}{recorded})", stage_place(*stage), measured_extent(*extent))
        }
        VersionPosition::RejectedByPeople(DecisionRemark::Answer { person, role, reason, .. }) => {
            format!("{version} was REJECTED by {person} ({role}): {reason} ({recorded})")
        }
        VersionPosition::RejectedByPeople(remark) => {
            format!("{version} was REJECTED: {} ({recorded})", decision_remark(remark))
        }
        VersionPosition::RolledBack { status, target, cause, measured } => {
            let target = target.as_ref().map_or_else(String::new, |target| format!(" to {target}"));
            let rest = match status {
                PostStatus::RolledBack => "",
                PostStatus::Demoted => " and returned to evaluation",
                PostStatus::SafeStopped => ", and its family is safe-stopped",
            };
            let measured = after_event(measured.as_ref());
            format!("{version} was ROLLED BACK{target}{rest} ({recorded}): {}{measured}", notice(cause))
        }
        VersionPosition::Returned { stage, cause } => {
            let place = stage.map_or_else(String::new, |stage| format!(" {}", stage_place(stage)));
            let cause = cause.as_ref().map_or_else(String::new, |cause| format!(": {}", notice(cause)));
            format!("{version} was RETURNED TO EVALUATION{place} ({recorded}){cause}")
        }
        VersionPosition::Superseded { by, .. } => {
            let by = by.as_ref().map_or_else(String::new, |by| format!(" by {by}"));
            format!("{version} was REPLACED{by} ({recorded})")
        }
        VersionPosition::Active(ActiveTerms { is_provisional: true, .. }) => {
            format!("{version} is ACTIVE {since}, in its provisional window")
        }
        VersionPosition::Active(ActiveTerms { cause: ActivationCause::Gate, .. }) => {
            format!("{version} is ACTIVE {since}, confirmed")
        }
        VersionPosition::Active(_) => format!("{version} is ACTIVE {since}"),
        VersionPosition::Waiting(step) => match step {
            PendingStep::Approval { needed, approved_by, .. } => {
                let count = approved_by.len();
                let by = if count == 0 { String::new() } else { format!(" ({})", approved_by.join(", ")) };
                format!("{version} WAITS FOR APPROVAL {since}: {count} of {needed} people approved{by}")
            }
            PendingStep::Unanswered(until) => {
                format!("{version} is ON HOLD {since}: too few people answered by {}", until.label())
            }
            PendingStep::Resumption => format!("{version} is PAUSED {since}"),
            PendingStep::Gate => format!("{version} is ON HOLD at the gate {since}"),
            PendingStep::StageEnd(stage) => format!("{version} is {} {since}", stage_place(*stage)),
            PendingStep::StageStart(stage) => format!("{version} WAITS FOR {} {since}", stage_name(*stage)),
        },
    }
}

/// The number of the record, with its wall time if it has one.
fn recorded(RecordMoment { record, wall, .. }: RecordMoment) -> String {
    let time = wall.map_or_else(String::new, |wall| format!(", {}", wall.label()));
    format!("record {record}{time}")
}

fn since_moment(RecordMoment { record, at_ms, wall }: RecordMoment) -> String {
    let time = wall.map_or_else(|| format!("{:.3} s", at_ms as f64 / 1000.0), WallTime::label);
    format!("since {time} (record {record})")
}

/// What a stage measured, with a comma after each part.
fn measured_extent(EvidenceExtent { pairs, drills, sequences }: EvidenceExtent) -> String {
    let parts = [(pairs, "pairs"), (drills, "drills"), (sequences, "sequences")];
    let measured: Vec<String> = parts
        .into_iter()
        .filter(|(count, _)| *count > 0)
        .map(|(count, what)| format!("{count} {what}, "))
        .collect();
    measured.concat()
}

const fn stage_place(of: Stage) -> &'static str {
    match of {
        Stage::Validation => "at validation",
        Stage::Sandbox => "in the sandbox",
        Stage::Shadow => "in shadow",
        Stage::Activation => "at the gate",
    }
}

const fn stage_name(of: Stage) -> &'static str {
    match of {
        Stage::Validation => "validation",
        Stage::Sandbox => "the sandbox",
        Stage::Shadow => "shadow",
        Stage::Activation => "the gate",
    }
}

/// What was found, beside the version compared with and against the limit. More is worse.
#[must_use]
pub fn decisive_reason(of: &DecisiveReason, compared: Option<&CapabilityId>) -> String {
    let DecisiveReason { content, measured } = of;
    match (measured, &content.finding) {
        (Some(ReasonMeasurement::Component { component, .. }), finding) => {
            component_reason(component, finding.as_ref(), &name(compared))
        }
        (Some(ReasonMeasurement::Drills(drills)), Some(finding)) => match drills_of(finding, drills) {
            Some(found) => format!("{}; {}", with_limit(content), drill_pass_counts(&found, &name(compared))),
            None => with_limit(content),
        },
        (_, Some(Finding::SignalWorse { signal })) => match content.evidence {
            Some(least) => format!(
                "{}: at least {} more often than {} (limit {})",
                twin_signal(*signal),
                number(least),
                name(compared),
                number(content.limit.unwrap_or(0.0))
            ),
            None => with_limit(content),
        },
        _ => with_limit(content),
    }
}

fn name(compared: Option<&CapabilityId>) -> String {
    compared.map_or_else(|| "the active version".to_owned(), CapabilityId::to_string)
}

/// A worse component. Which bound counts, and against which limit, follows from what the rule found.
fn component_reason(component: &BehaviorComponent, finding: Option<&Finding>, compared: &str) -> String {
    let BehaviorComponent { name, worsening, lower, upper, tolerance, .. } = *component;
    let noun = component_noun(name);
    let of = |value: f64| amount(name, value);
    let limit = amount_size(name, tolerance);
    match finding {
        Some(Finding::ComponentPossiblyWorse { .. }) => match upper {
            Some(upper) => {
                format!("{noun}: up to {} than {compared} is not excluded (limit {limit})", of(upper))
            }
            None => format!("{noun}: so few episodes exclude no difference from {compared} (limit {limit})"),
        },
        Some(Finding::SafetyTraded { .. }) => {
            format!("{noun}: at least {} than {compared}, while success rose (limit 0)", of(lower))
        }
        Some(Finding::ComponentWorse { .. }) if name.is_bad_at_any_rise() && worsening <= tolerance => {
            format!("{noun}: at least {} than {compared} (limit 0)", of(lower))
        }
        _ => {
            let limit = amount_size(name, component.limit());
            format!("{noun}: {} than {compared} (limit {limit})", of(worsening))
        }
    }
}

/// What was found, with its number and what is needed or allowed.
fn with_limit(of: &ReasonContent) -> String {
    let text = reason_content(of);
    // More is worse in every further comparison, so a value below its limit lacks nothing.
    let is_worsening = matches!(
        of.finding,
        Some(
            Finding::AnchorWorse { .. }
                | Finding::AnchorPossiblyWorse { .. }
                | Finding::LiveLikeWorse { .. }
                | Finding::LiveLikePossiblyWorse { .. }
        )
    );
    let words = if is_worsening {
        ["limit ", ""]
    } else if of.evidence < of.limit {
        ["at least ", " is needed"]
    } else {
        ["at most ", " is allowed"]
    };
    crate::reason::with_limit(text, of, words)
}

/// The drills that a finding is about: of the kind and the phase that it names, or else the kind that passes least.
fn drills_of(finding: &Finding, drills: &[DrillComparison]) -> Option<DrillComparison> {
    let of = |kind: DrillKind, phase: Option<WorkPhase>| {
        drills.iter().copied().find(|drills| drills.kind == kind && drills.phase == phase)
    };
    match finding {
        Finding::RollbackDrillsFail => of(DrillKind::Rollback, None),
        Finding::DrillsLean { drill } | Finding::DrillsWorse { drill } => of(*drill, None),
        Finding::PhaseFails { drill, phase } | Finding::PhaseWorse { drill, phase } => {
            of(*drill, Some(*phase))
        }
        Finding::RecoveryWorse
        | Finding::RecoveryFarBelowFloor
        | Finding::RecoveryFragile
        | Finding::RecoveryConditional => {
            let whole = drills.iter().copied().filter(|drills| drills.phase.is_none());
            whole.min_by(|a, b| pass_share(&a.candidate).total_cmp(&pass_share(&b.candidate)))
        }
        _ => None,
    }
}

fn pass_share(of: &DrillTally) -> f64 {
    f64::from(of.passed) / f64::from(of.feasible())
}

fn drill_pass_counts(of: &DrillComparison, compared: &str) -> String {
    let DrillComparison { kind, phase, candidate, active } = of;
    let place = phase.map_or_else(String::new, |phase| format!(" in {phase}"));
    format!(
        "{kind} drills{place}: {} of {} passed, {compared} {} of {}",
        candidate.passed,
        candidate.feasible(),
        active.passed,
        active.feasible()
    )
}

fn details(of: &ExplanationSummary) -> Vec<String> {
    let mut details = match &of.position {
        VersionPosition::Active(terms) => active_terms(terms),
        VersionPosition::Superseded { is_target: true, .. } => vec!["it is the rollback target".to_owned()],
        VersionPosition::Superseded { is_target: false, .. } => {
            vec!["it is not the rollback target".to_owned()]
        }
        VersionPosition::Rejected { .. }
        | VersionPosition::RejectedByPeople(_)
        | VersionPosition::RolledBack { .. }
        | VersionPosition::Returned { .. }
        | VersionPosition::Waiting(_) => Vec::new(),
    };
    if !of.passed.is_empty() {
        let passed: Vec<String> = of.passed.iter().map(passed_check).collect();
        details.push(format!("passed: {}", passed.join(", ")));
    }
    details.extend(of.remarks.iter().map(|remark| summary_remark(remark, of)));
    details
}

fn active_terms(of: &ActiveTerms) -> Vec<String> {
    let approvers: Vec<String> =
        of.approvers.iter().map(|approver| format!("{} ({})", approver.person, approver.role)).collect();
    let by = approvers.join(", ");
    let approved = match of.cause {
        ActivationCause::Bootstrap => "approved by: no one; the store was created with it".to_owned(),
        ActivationCause::Gate if of.is_break_glass && of.reviewed_by.is_empty() => {
            format!("approved by: {by}, alone by break-glass")
        }
        ActivationCause::Gate if of.is_break_glass => {
            format!("approved by: {by}, alone by break-glass; reviewed by {}", of.reviewed_by.join(", "))
        }
        ActivationCause::Gate if approvers.is_empty() => {
            "approved by: no one; the profile required no approval".to_owned()
        }
        ActivationCause::Gate => format!("approved by: {by}"),
        ActivationCause::Restore | ActivationCause::Vacate => {
            "approved by: no one; a rollback made it active again".to_owned()
        }
        ActivationCause::Rearm => "approved by: no one; an operator reactivated it".to_owned(),
    };
    let target = of.target.as_ref().map_or_else(|| "none".to_owned(), CapabilityId::to_string);
    let tightened =
        of.is_restricted.then(|| "its envelope is tightened until an operator lifts that".to_owned());
    let conditions = conditions_of_use(&of.conditions);
    let restrictions: Vec<String> = tightened.into_iter().chain(conditions).collect();
    let restrictions = if restrictions.is_empty() { "none".to_owned() } else { restrictions.join("; ") };
    vec![approved, format!("rollback target: {target}"), format!("restrictions: {restrictions}")]
}

fn passed_check(of: &PassedCheck) -> String {
    let PassedCheck { of, kappa, is_restricted, sequences } = of;
    let value = kappa.map_or_else(String::new, |kappa| format!(" {kappa:.2}"));
    let conditions = if *is_restricted { " with conditions" } else { "" };
    let sequences = sequences.map_or_else(String::new, |count| format!(" ({})", counted(count, "sequence")));
    format!("{of}{value}{conditions}{sequences}")
}

fn summary_remark(remark: &SummaryRemark, of: &ExplanationSummary) -> String {
    let compared = of.compared.as_ref();
    match remark {
        SummaryRemark::BeyondDeclaration(excess) => {
            format!("beyond its declaration: {}", permission_excess(excess))
        }
        SummaryRemark::FewerDrillsPassed(drills) => drill_pass_counts(drills, &name(compared)),
        SummaryRemark::FailureCauses(counts) => failure_causes(counts, &name(compared)),
        SummaryRemark::TwinFailures(of) => {
            format!("failed tasks in {} of its twins: {}", of.tasks, failed_by_cause(&of.own))
        }
        SummaryRemark::Covered(domain) => format!("covered: {}", covered_starts(domain)),
        SummaryRemark::Counted(counted) => counted_try(&of.version.family, counted),
        SummaryRemark::OpenConcern(found) => format!("open concern: {}", reason(found)),
        SummaryRemark::ReviewUntil(until) => {
            format!(
                "waits for the review of its break-glass activation by {}; else it is demoted",
                until.label()
            )
        }
        SummaryRemark::Limited(status) => version_status(&of.version, status),
    }
}

/// How many causes of failed tasks are named, the most frequent first.
const CAUSES_NAMED: usize = 3;

fn failure_causes(of: &FailureCounts, compared: &str) -> String {
    let (own, other) = (failed_by_cause(&of.own), failed_by_cause(&of.other));
    format!("failed tasks in {}: {own}; {compared}: {other}", counted(of.pairs, "pair"))
}

/// How many tasks failed, and by which causes.
fn failed_by_cause(counts: &[(FailureCause, usize)]) -> String {
    let all: usize = counts.iter().map(|(_, count)| count).sum();
    let named = counts.iter().take(CAUSES_NAMED);
    let mut each: Vec<String> =
        named.map(|(cause, count)| format!("{}: {count}", failure_cause(*cause))).collect();
    let others: usize = counts.iter().skip(CAUSES_NAMED).map(|(_, count)| count).sum();
    each.extend((others > 0).then(|| format!("other causes: {others}")));
    let each = if each.is_empty() { String::new() } else { format!(" ({})", each.join(", ")) };
    format!("{all}{each}")
}

/// What would remove a reason that stands above it; `None` if the reason says it.
fn brief_remedy(of: &Remedy) -> Option<String> {
    Some(match of {
        Remedy::Act(action) | Remedy::ActOn(action, _) => remedy_action(*action).to_owned(),
        Remedy::Resolve(_) => return None,
        Remedy::WorsenLess { component, fewer } => {
            let (name, most) = (component.name, component.most_worsening());
            let needed = fewer
                .filter(|fewer| fewer.fewer > 0)
                .map_or_else(|| format!("at most {}", amount(name, most)), episode_reduction);
            format!("{}: {needed}", component_noun(name))
        }
        Remedy::EndSignificance(_)
        | Remedy::RaiseDeclaration { .. }
        | Remedy::PassRollbackDrills { .. }
        | Remedy::StrengthenRecovery { .. }
        | Remedy::Approve { .. }
        | Remedy::RepairRung(_) => remedy(of),
    })
}

fn end(of: &ExplanationSummary) -> String {
    const FINAL: &str = "final: another result needs a new version";
    const RETRY: &str = "ends: an operator has the sandbox or shadow run again";
    match &of.position {
        VersionPosition::Rejected { .. }
        | VersionPosition::RejectedByPeople(_)
        | VersionPosition::RolledBack { status: PostStatus::RolledBack, .. } => FINAL.to_owned(),
        VersionPosition::RolledBack { status: PostStatus::Demoted, .. }
        | VersionPosition::Returned { .. } => RETRY.to_owned(),
        VersionPosition::RolledBack { status: PostStatus::SafeStopped, .. } => {
            "ends: an operator reactivates a version of the family".to_owned()
        }
        VersionPosition::Superseded { .. } | VersionPosition::Active(_) => String::new(),
        VersionPosition::Waiting(step) => match step {
            PendingStep::Approval { needed, until, .. } => {
                let people = if *needed == 1 { "1 person approves" } else { "enough people approve" };
                format!(
                    "ends: {people}, or one rejects; without a decision by {} it stays on hold",
                    until.label()
                )
            }
            PendingStep::Unanswered(_) => {
                "ends: an operator resumes it, and approvers are asked again".to_owned()
            }
            PendingStep::Resumption => "ends: an operator resumes it".to_owned(),
            PendingStep::Gate => {
                "ends: the causes end and an operator resumes it, which asks the gate again".to_owned()
            }
            PendingStep::StageEnd(stage) => match early_end(*stage) {
                "" => "ends: with the stage".to_owned(),
                early => format!("ends: with the stage; {early}"),
            },
            PendingStep::StageStart(_) => {
                "ends: a running engine starts the stage; it runs one candidate at a time".to_owned()
            }
        },
    }
}

/// The next commands, each whole.
fn commands(of: &ExplanationSummary, data: Option<&str>) -> Vec<String> {
    const SIGNED: &str = "--as NAME --reason TEXT";
    let ExplanationSummary { version, position, has_recording, .. } = of;
    let first = match position {
        VersionPosition::Waiting(PendingStep::Approval { .. }) => Some(format!("status {version}")),
        VersionPosition::Waiting(
            PendingStep::Unanswered(_) | PendingStep::Resumption | PendingStep::Gate,
        ) => Some(format!("resume {} {SIGNED}", version.family)),
        VersionPosition::Returned { .. }
        | VersionPosition::RolledBack { status: PostStatus::Demoted, .. } => {
            Some(format!("version retry {version} {SIGNED}"))
        }
        VersionPosition::Rejected { .. }
        | VersionPosition::RejectedByPeople(_)
        | VersionPosition::RolledBack { .. }
        | VersionPosition::Superseded { .. }
        | VersionPosition::Active(_)
        | VersionPosition::Waiting(PendingStep::StageEnd(_) | PendingStep::StageStart(_)) => None,
    };
    let replay = has_recording.then(|| format!("replay {version} --terminal"));
    let data = data.map_or_else(String::new, |data| format!(" --data {}", shell_word(data)));
    let all = first.into_iter().chain([format!("explain {version} --full")]).chain(replay);
    all.map(|command| format!("holdpoint {command}{data}")).collect()
}
