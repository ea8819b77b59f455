//! Starting a stopped cell, and what the operator has to read first.

use super::operations::{dismiss_form, open};
use super::{refuse, show_message};
use crate::effect::Effect;
use crate::form::Intent;
use crate::model::{ConsoleModel, Overlay};
use holdpoint_protocol::command::Caller;
use holdpoint_protocol::snapshot::StoppedView;
use holdpoint_wording::console::cell_restart as wording;
use holdpoint_wording::event::stop_author;

/// Opens the form that starts a stopped cell.
pub(super) fn go(model: &mut ConsoleModel) -> Vec<Effect> {
    match may_go(model).cloned() {
        Ok(stopped) => {
            let (since_ms, stops) = (stopped.since_ms, stopped.stops);
            let intent = Intent::Go { since_ms, stops, last_ms: stopped.last_ms() };
            let lines = go_lines(model, &stopped);
            open(model, intent, lines)
        }
        Err(why) => refuse(model, &why),
    }
}

/// The stop that the operator can end, or why not.
pub(super) fn may_go(model: &ConsoleModel) -> Result<&StoppedView, String> {
    let now = model.engine_data.snapshot.as_deref();
    if let Some(why) = now.and_then(|now| now.holding.as_ref()) {
        // A halted engine refuses it.
        return Err(wording::engine_is_halted(why));
    }
    now.and_then(|now| now.stopped.as_ref()).ok_or_else(|| wording::NOT_STOPPED.to_owned())
}

/// The consequences of starting the cell: its stops, and the version that takes control.
fn go_lines(model: &ConsoleModel, stopped: &StoppedView) -> Vec<String> {
    let mut lines = vec![wording::ARM_MOVES_AGAIN.to_owned()];
    let prompts = model.engine_data.snapshot.iter().flat_map(|now| &now.prompts);
    let granted = prompts.filter(|prompt| prompt.granted);
    lines.extend(granted.map(|prompt| wording::takes_control_at_once(&prompt.version)));
    lines.extend(stop_lines(model, stopped));
    lines
}

/// All stops of the cell, with their authors.
fn stop_lines(model: &ConsoleModel, stopped: &StoppedView) -> Vec<String> {
    let why = |reason: &str| if reason.is_empty() { String::new() } else { format!(": {reason:?}") };
    let author = stop_author(&stopped.by, &stopped.caller);
    let since = model.recorded_moment(stopped.since_ms, stopped.wall);
    let mut lines = vec![wording::stopped_by(&author, &since, &why(&stopped.reason))];
    if stopped.unnamed > 0 {
        lines.push(wording::stopped_again_unnamed(stopped.unnamed));
    }
    lines.extend(stopped.again.iter().map(|stop| {
        let author = stop_author(&stop.by, &stop.caller);
        let at = model.recorded_moment(stop.at_ms, stop.wall);
        wording::and_by(&author, &at, &why(&stop.reason))
    }));
    lines
}

/// The open form's current consequences, or why it is void.
pub(super) fn still_stopped(model: &ConsoleModel, read: (u64, u64)) -> Result<Vec<String>, String> {
    match model.engine_data.snapshot.as_ref().and_then(|snapshot| snapshot.stopped.as_ref()) {
        None => Err(wording::ALREADY_STARTED.to_owned()),
        Some(stopped) if (stopped.since_ms, stopped.stops) != read => {
            let first = (&stopped.by, &stopped.caller);
            let (by, caller) = stopped.again.last().map_or(first, |stop| (&stop.by, &stop.caller));
            Err(restop_message(model, (by, caller), stopped.last_ms()))
        }
        Some(stopped) => Ok(go_lines(model, stopped)),
    }
}

/// Another stop of a stopped cell: the operator who is about to start it has to know.
pub(super) fn stopped_again(model: &mut ConsoleModel, author: (&str, &Caller), at_ms: u64) {
    let Some(Overlay::Form(form)) = &model.input.overlay else { return };
    // A stop from before the last one that was read arrives late.
    if !matches!(form.intent, Intent::Go { last_ms, .. } if at_ms > last_ms) {
        return;
    }
    let is_sent = form.signing.as_ref().is_some_and(|signing| signing.request_id.is_some());
    let is_void = form.void.is_some();
    let message = restop_message(model, author, at_ms);
    if is_sent {
        let refused = wording::not_included(&message);
        show_message(model, refused, true);
    } else if !is_void {
        dismiss_form(model, message);
    }
}

fn restop_message(model: &ConsoleModel, (by, caller): (&str, &Caller), at_ms: u64) -> String {
    wording::stopped_it_again(&stop_author(by, caller), &model.moment(at_ms))
}
