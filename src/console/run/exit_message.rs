//! The last line: the state that the console left.

use crate::model::ConsoleModel;
use holdpoint_governance::lifecycle::Stage;
use holdpoint_protocol::snapshot::{CandidateView, Snapshot};
use holdpoint_service::control_socket::ControlSocketError;
use holdpoint_service::engine_handle::EngineEndError;
use holdpoint_text::{Hint as _, Untrusted};
use holdpoint_wording::console::run as wording;
use holdpoint_wording::console::shared;

/// Why the console ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExitCause {
    /// The operator asked for it.
    Requested,
    Signalled,
    /// The terminal is lost: no message can appear there.
    TerminalLost,
}

/// The state that a console left.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ExitReport {
    pub cause: ExitCause,
    /// Whether there was an engine here.
    pub engine_started: bool,
    /// Whether the engine shut down cleanly.
    pub in_order: bool,
    /// One line on the state that the console left, sanitized.
    pub text: String,
}

/// The exit report: the console's cause, the engine's end, and the work in progress at the last snapshot.
pub(super) fn exit_report(
    cause: ExitCause,
    came_up: bool,
    ended: Option<Result<(), EngineEndError>>,
    last: Option<&Snapshot>,
) -> ExitReport {
    let (in_order, engine) = match ended {
        Some(Ok(())) => (true, shared::ENGINE_SHUT_DOWN_CLEANLY.to_owned()),
        Some(Err(why)) if !came_up => (false, wording::did_not_come_up(why)),
        Some(Err(why)) => (false, wording::ended_with_a_fault(why)),
        None => (false, wording::DID_NOT_END_IN_TIME.to_owned()),
    };
    let mut parts = vec![engine];
    parts.extend(last.into_iter().flat_map(pending_work));
    let text = Untrusted::new(parts.join("; ")).line().into_string();
    ExitReport { cause, engine_started: came_up, in_order, text }
}

/// The exit report if the engine keeps running: `reply` answers the request to run without a console,
/// `ends_alone_s` how long it does so by itself.
pub(super) fn at_work(
    model: &ConsoleModel,
    cause: ExitCause,
    reply: &Result<(), ControlSocketError>,
    ends_alone_s: Option<u64>,
) -> ExitReport {
    let (back, stop) = (model.in_shell(""), model.in_shell("stop"));
    let mut text = wording::left_running(&back, &stop);
    if let Some(secs) = ends_alone_s {
        text.push_str(&wording::ends_alone_after(secs));
    }
    if let Err(error) = reply {
        text.push_str(&wording::request_failed(&error.sentence()));
    }
    let text = Untrusted::new(text).line().into_string();
    ExitReport { cause, engine_started: true, in_order: reply.is_ok(), text }
}

/// The exit report if the engine has not finished its shutdown.
pub(super) fn still_ending(model: &ConsoleModel, cause: ExitCause) -> ExitReport {
    let status = model.in_shell("status");
    let text = wording::still_shutting_down(&status);
    let text = Untrusted::new(text).line().into_string();
    ExitReport { cause, engine_started: true, in_order: false, text }
}

/// The exit report if an engine in another process is gone.
pub(super) fn ended_elsewhere(cause: ExitCause, why: &EngineEndError) -> ExitReport {
    let text = Untrusted::new(wording::engine_is_gone(why)).line().into_string();
    // Another client ended it on purpose.
    ExitReport { cause, engine_started: true, in_order: why.orderly, text }
}

/// The work that continues at the next start, one part for each kind.
fn pending_work(snapshot: &Snapshot) -> Vec<String> {
    let count =
        |is: &dyn Fn(&CandidateView) -> bool| snapshot.candidates.iter().filter(|one| is(one)).count();
    let mut parts = Vec::new();
    for stage in [Stage::Validation, Stage::Sandbox, Stage::Shadow, Stage::Activation] {
        let here = count(&|one| one.flags.running == Some(stage) && !one.flags.awaiting_approval);
        if here > 0 {
            parts.push(wording::stage_runs_again(&candidates(here), stage.name()));
        }
    }
    let waiting = snapshot.prompts.len();
    if waiting > 0 {
        parts.push(wording::held_for_approval(&candidates(waiting)));
    }
    let watched = count(&|one| one.flags.provisional);
    if watched > 0 {
        parts.push(wording::provisional(&candidates(watched)));
    }
    parts
}

fn candidates(count: usize) -> String {
    if count == 1 { "1 candidate is".to_owned() } else { format!("{count} candidates are") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exit_message_reports_the_end_of_the_engine() {
        let fault = || Some(Err(EngineEndError::of("disk full\u{7}")));
        for (came_up, ended, in_order, expected) in [
            (true, Some(Ok(())), true, shared::ENGINE_SHUT_DOWN_CLEANLY.to_owned()),
            (true, fault(), false, wording::ended_with_a_fault(r"disk full\u{7}")),
            (false, fault(), false, wording::did_not_come_up(r"disk full\u{7}")),
            (true, None, false, wording::DID_NOT_END_IN_TIME.to_owned()),
        ] {
            let report = exit_report(ExitCause::Requested, came_up, ended, None);
            assert_eq!(report.in_order, in_order);
            assert_eq!(report.text, expected);
        }
        assert_eq!(candidates(1), "1 candidate is");
        assert_eq!(candidates(3), "3 candidates are");
    }
}
