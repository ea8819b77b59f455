//! A check in words: what decided it, with its numbers, and what was found.
//!
//! States everything in one direction: more is worse.

use holdpoint_governance::behavior::ComponentName;
use holdpoint_governance::decision::Dimension;
use holdpoint_governance::explanation::{
    CheckFinding, CheckReason, ComponentFinding, ComponentValues, DecidingBound, DecidingFact,
    DrillComparison, Support,
};
use holdpoint_governance::finding::Finding;
use holdpoint_governance::policy::PolicyProblem;
use holdpoint_protocol::film::{CodeFaultCount, FilmSubject, SelectionReason};

use crate::explanation::reason_content;
use crate::film::{code_fault_count, selection_reason};
use crate::harm::harm_measure;
use crate::reason::with_limit;
use crate::{hard_stop, harm_comparison, harm_decider, sequence_measure};

/// What decided a check, one sentence; how confined code failed stands first.
#[must_use]
pub fn check_decision(faults: &[CodeFaultCount], fact: &DecidingFact) -> String {
    let faults = faults.iter().map(|fault| code_fault_count(*fault));
    faults.chain([deciding_fact(fact)]).collect::<Vec<_>>().join("; ")
}

/// What decided a check, after the name of the part of the rules.
#[must_use]
pub fn decided_check(about: Dimension, fact: &DecidingFact) -> String {
    format!("{about}: {}", deciding_fact(fact))
}

/// The fact that decided a check.
#[must_use]
pub fn deciding_fact(of: &DecidingFact) -> String {
    match of {
        DecidingFact::Against { finding, reason: None } => check_finding(finding),
        DecidingFact::Against { finding, reason: Some(reason) } => {
            format!("{}: {}", check_finding(finding), check_reason(reason))
        }
        DecidingFact::InFavor { kappa, support } => {
            let value = kappa.map_or_else(String::new, |kappa| format!("{:.3}: ", kappa.get()));
            match support {
                // A failure of the candidate alone is never "nothing".
                Support::NearestToLimit(finding) if fails_alone(finding) => {
                    format!("{value}{}; within the limits", finding_clause(finding))
                }
                Support::NearestToLimit(finding) => {
                    let nearest = finding_clause(finding);
                    format!("{value}nothing speaks against it; nearest to a limit: {nearest}")
                }
                Support::Reason(reason) => format!("{value}{}", check_reason(reason)),
                Support::NoFinding => format!("{value}nothing speaks against it"),
            }
        }
        DecidingFact::NotMeasured => "not measured yet: the sandbox does that".to_owned(),
    }
}

/// What is wrong with policies that compile.
#[must_use]
pub fn policy_problem(of: &PolicyProblem) -> String {
    match of {
        PolicyProblem::Errs { error } => format!("{error}; what it is about is denied"),
        PolicyProblem::CoversNothing { policy } => {
            format!(
                "the policy {policy:?} has no effect: no command in any zone and no activation is ruled by it"
            )
        }
    }
}

/// Which work on record shows a finding best, and why; `beyond` more failed than are on record one by one.
#[must_use]
pub fn worst_work(of: FilmSubject, number: u32, count: u32, beyond: u32, why: SelectionReason) -> String {
    let reason = selection_reason(why);
    if why == SelectionReason::NowhereWorse {
        // There is no worst one where none is worse.
        return format!("{reason} (of {count})");
    }
    let what = match of {
        FilmSubject::Episode => "episode",
        FilmSubject::Confirmation => "episode of its confirmation",
        FilmSubject::Drill => "failed drill",
        FilmSubject::Alone => "episode that it ran alone",
    };
    if count == 1 && beyond == 0 {
        return format!("the only {what}: {reason}");
    }
    let more = if beyond > 0 { format!(" on record, {beyond} more failed") } else { String::new() };
    format!("the worst {what} is number {number} of {count}{more}: {reason}")
}

/// Whether the version failed drills that the active version passed.
const fn fails_alone(of: &CheckFinding) -> bool {
    match of {
        CheckFinding::Drills(DrillComparison { candidate, active, .. }) => {
            candidate.failed_alone > 0 || candidate.failed > active.failed
        }
        CheckFinding::Component(_)
        | CheckFinding::Harm(_)
        | CheckFinding::Sequences { .. }
        | CheckFinding::Reason(_) => false,
    }
}

/// A finding as a clause of its own. What the version does gets its subject.
fn finding_clause(of: &CheckFinding) -> String {
    let finding = check_finding(of);
    match of {
        CheckFinding::Component(_) | CheckFinding::Drills(_) => format!("it {finding}"),
        CheckFinding::Harm(_) | CheckFinding::Sequences { .. } | CheckFinding::Reason(_) => finding,
    }
}

/// What was found in a check, with the numbers of both versions and the limit.
#[must_use]
pub fn check_finding(of: &CheckFinding) -> String {
    match of {
        CheckFinding::Component(component) => component_finding(component),
        CheckFinding::Harm(harm) => {
            let deciding = harm_decider(harm).map_or_else(String::new, |deciding| format!("; {deciding}"));
            format!("{} {}{deciding}", harm_measure(harm.kind), harm_comparison(harm))
        }
        CheckFinding::Sequences { comparison, bound } => format!(
            "whole sequences: {} {} with it, {} with the active version; at most {} more is tolerated{}",
            sequence_measure(comparison.measure),
            number(comparison.candidate),
            number(comparison.active),
            number(comparison.tolerance),
            deciding_bound(*bound, number)
        ),
        CheckFinding::Drills(DrillComparison { kind, candidate, active, .. }) => format!(
            "fails {} of {} {kind} drills, the active version {} of {}",
            candidate.failed,
            candidate.feasible(),
            active.failed,
            active.feasible()
        ),
        CheckFinding::Reason(reason) => check_reason(reason),
    }
}

/// What a reason found, with its numbers; of a passed budget, which overrun of the code it was.
fn check_reason(of: &CheckReason) -> String {
    let CheckReason { content, overrun } = of;
    let text = match (&content.finding, overrun) {
        (Some(Finding::SandboxHardStop { stop }), Some(fault)) => {
            format!("hard stop {stop}: {}", hard_stop(*stop, Some(*fault)))
        }
        _ => reason_content(content),
    };
    with_limit(text, content, ["limit ", ""])
}

/// `passes a limit in 38 of 120 episodes, the active version in 0; at most 5 % more is tolerated`.
fn component_finding(of: &ComponentFinding) -> String {
    let ComponentFinding { name, values, tolerance, bound } = *of;
    let (new, old) = match values {
        ComponentValues::Episodes { candidate, active, of } => {
            (format!("{candidate} of {of} episodes"), active.to_string())
        }
        ComponentValues::Mean { candidate, active } if name == ComponentName::Time => {
            (format!("{candidate:.2}"), format!("{active:.2}"))
        }
        ComponentValues::Mean { candidate, active } => (number(candidate), number(active)),
    };
    let percent = |share: f64| format!("{} %", number(100.0 * share));
    let more = format!("at most {} more is tolerated", percent(tolerance));
    let text = match name {
        ComponentName::Violation => format!("passes a limit in {new}, the active version in {old}; {more}"),
        ComponentName::Anomaly => {
            format!("shows a failure to the watcher in {new}, the active version in {old}; {more}")
        }
        ComponentName::Recovery => {
            // A pair in which one of them alone does the task counts as success.
            let compared = "where both or neither does the task";
            format!("needs the recovery manager in {new}, the active version in {old}, {compared}; {more}")
        }
        ComponentName::Success => {
            format!("does not do the task in {new}, the active version in {old}; {more}")
        }
        ComponentName::Retry => format!(
            "tries {new} times more an episode, the active version {old}; at most {} more are tolerated",
            number(tolerance)
        ),
        ComponentName::Time => format!(
            "takes {new} s where both do the task, the active version {old} s; at most {} longer is tolerated",
            percent(tolerance)
        ),
    };
    let bound = match name {
        ComponentName::Retry => deciding_bound(bound, number),
        ComponentName::Success
        | ComponentName::Time
        | ComponentName::Violation
        | ComponentName::Anomaly
        | ComponentName::Recovery => deciding_bound(bound, percent),
    };
    format!("{text}{bound}")
}

/// The bound that makes the verdict, after a semicolon; empty where the mean makes it.
fn deciding_bound(of: Option<DecidingBound>, amount: impl Fn(f64) -> String) -> String {
    let decides = "its bound decides";
    match of {
        None => String::new(),
        Some(DecidingBound::Established(lower)) => {
            format!("; {decides}: worse by {} at least is established", amount(lower))
        }
        Some(DecidingBound::NotExcluded(upper)) => {
            format!("; {decides}: up to {} worse is not excluded", amount(upper))
        }
        Some(DecidingBound::Unbounded) => format!("; {decides}: so few episodes exclude nothing"),
    }
}

/// A number in as few digits as tell it.
pub(crate) fn number(value: f64) -> String {
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
    use holdpoint_governance::evidence::{DrillKind, DrillTally};
    use holdpoint_governance::explanation::ReasonContent;

    #[test]
    fn a_number_is_as_short_as_its_size_allows() {
        let texts = [0.0, 5.0, 0.125, 12.345, 1234.5, 0.0004, 100.0].map(number);
        assert_eq!(texts, ["0", "5", "0.125", "12.3", "1234", "0", "100"]);
    }

    /// Regression: such a row was marked as worse beside a mean that is tolerated.
    #[test]
    fn a_deciding_bound_is_stated() {
        let of = |bound| deciding_bound(bound, |share| format!("{} %", number(100.0 * share)));
        assert_eq!(of(None), "");
        assert_eq!(
            of(Some(DecidingBound::NotExcluded(0.085))),
            "; its bound decides: up to 8.5 % worse is not excluded"
        );
        assert_eq!(
            of(Some(DecidingBound::Established(0.01))),
            "; its bound decides: worse by 1 % at least is established"
        );
        assert_eq!(
            of(Some(DecidingBound::Unbounded)),
            "; its bound decides: so few episodes exclude nothing"
        );
    }

    /// Regression: 3 of 40 failed abort drills stood behind "nothing speaks against it".
    #[test]
    fn a_drill_that_the_candidate_alone_fails_is_never_nothing() {
        let of = |failed| {
            let tally = |failed| DrillTally { passed: 40 - failed, failed, ..DrillTally::default() };
            let drills = DrillComparison {
                kind: DrillKind::Abort,
                phase: None,
                candidate: tally(failed),
                active: tally(0),
            };
            let support = Support::NearestToLimit(CheckFinding::Drills(drills));
            deciding_fact(&DecidingFact::InFavor { kappa: None, support })
        };
        assert_eq!(of(3), "it fails 3 of 40 abort drills, the active version 0 of 40; within the limits");
        assert!(of(0).starts_with("nothing speaks against it; nearest to a limit: it fails 0 of 40"));
    }

    #[test]
    fn a_reason_shows_its_number_and_its_limit() {
        let of = |evidence, limit| {
            let older_text = "it is slow".to_owned();
            let content = ReasonContent { finding: None, older_text, evidence, limit };
            check_reason(&CheckReason { content, overrun: None })
        };
        assert_eq!(of(Some(0.25), Some(0.1)), "it is slow (0.25; limit 0.1)");
        assert_eq!(of(Some(0.25), None), "it is slow");
        assert_eq!(of(None, Some(0.1)), "it is slow");
    }
}
