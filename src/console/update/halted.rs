//! A cell that somebody stopped: letting it work again, and what whoever does so has to read first.

use super::operating::{make_void, open};
use super::{refuse, tell};
use crate::effect::Effect;
use crate::form::Intent;
use crate::model::{Model, Overlay};
use crate::words::seconds;
use holdpoint_protocol::snapshot::StoppedView;

/// Opens the form that lets a stopped cell work again.
pub(super) fn go(model: &mut Model) -> Vec<Effect> {
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

/// The stop that may be let go; else why not.
pub(super) fn may_go(model: &Model) -> Result<&StoppedView, String> {
    let now = model.told.snapshot.as_deref();
    if let Some(why) = now.and_then(|now| now.holding.as_ref()) {
        // An engine that holds refuses it: it is no way out.
        return Err(format!("the engine holds, and lets nothing work before it is started again: {why}"));
    }
    now.and_then(|now| now.stopped.as_ref()).ok_or_else(|| "the cell is not stopped".to_owned())
}

/// What letting the cell work does: who stopped it, and what takes control with it.
fn go_lines(model: &Model, stopped: &StoppedView) -> Vec<String> {
    let mut lines = vec!["The arm moves again at once; make sure that nobody is in the cell".to_owned()];
    let prompts = model.told.snapshot.iter().flat_map(|now| &now.prompts);
    let granted = prompts.filter(|prompt| prompt.granted);
    lines.extend(granted.map(|prompt| format!("{} is approved and takes control at once", prompt.version)));
    lines.extend(stop_lines(stopped));
    lines
}

/// Everybody who stopped the cell.
fn stop_lines(stopped: &StoppedView) -> Vec<String> {
    let somebody = |by: &str| if by.is_empty() { "somebody".to_owned() } else { by.to_owned() };
    let why = |reason: &str| if reason.is_empty() { String::new() } else { format!(": {reason}") };
    let (by, since) = (somebody(&stopped.by), seconds(stopped.since_ms));
    let mut lines =
        vec![format!("Stopped by {by}, {}, since {since}{}", stopped.caller, why(&stopped.reason))];
    if stopped.unnamed > 0 {
        lines.push(format!("and {} more times, by whom the record says", stopped.unnamed));
    }
    lines.extend(stopped.again.iter().map(|stop| {
        let (by, at) = (somebody(&stop.by), seconds(stop.at_ms));
        format!("and by {by}, {}, at {at}{}", stop.caller, why(&stop.reason))
    }));
    lines
}

/// What the open form says now of the stop that was read, or why it is for nothing any more.
pub(super) fn still_stopped(model: &Model, read: (u64, u64)) -> Result<Vec<String>, String> {
    match model.told.snapshot.as_ref().and_then(|snapshot| snapshot.stopped.as_ref()) {
        None => Err("somebody has let it work already".to_owned()),
        Some(stopped) if (stopped.since_ms, stopped.stops) != read => {
            let by = stopped.again.last().map_or(&stopped.by, |stop| &stop.by);
            Err(stopped_anew(by, stopped.last_ms()))
        }
        Some(stopped) => Ok(go_lines(model, stopped)),
    }
}

/// Somebody stopped the cell while it was stopped already: whoever is about to let it work has to know.
pub(super) fn stopped_again(model: &mut Model, by: &str, at_ms: u64) {
    let Some(Overlay::Form(form)) = &model.entry.overlay else { return };
    // One from before the last that was read is told late.
    if !matches!(form.intent, Intent::Go { last_ms, .. } if at_ms > last_ms) {
        return;
    }
    let is_asked = form.signing.as_ref().is_some_and(|signing| signing.asked.is_some());
    if is_asked {
        tell(
            model,
            format!(
                "{}; what you asked knows nothing of it and will be refused if it comes later",
                stopped_anew(by, at_ms)
            ),
            true,
        );
    } else if form.void.is_none() {
        make_void(model, stopped_anew(by, at_ms));
    }
}

fn stopped_anew(by: &str, at_ms: u64) -> String {
    let by = if by.is_empty() { "somebody" } else { by };
    format!("{by} has stopped it anew at {}: read why first", seconds(at_ms))
}
