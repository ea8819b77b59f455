//! The last line: how things were left, in words that are true.

use crate::model::Model;
use holdpoint_engine::door::DoorError;
use holdpoint_engine::host::EndFault;
use holdpoint_governance::lifecycle::Stage;
use holdpoint_protocol::snapshot::{CandidateView, Snapshot};
use holdpoint_text::{Hint as _, Untrusted};

/// Why the console ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// Somebody asked for it.
    Asked,
    Told,
    /// The terminal is gone: nothing can be said there.
    Gone,
}

/// How the console left things.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Left {
    pub cause: Cause,
    /// Whether there was an engine here at all.
    pub came_up: bool,
    /// Whether the engine ended in good order.
    pub in_order: bool,
    /// One line on how things were left, sanitised.
    pub text: String,
}

/// How a console left things: why it ended, how the engine did, and what was on its way when it was last seen.
pub(super) fn left(
    cause: Cause,
    came_up: bool,
    ended: Option<Result<(), EndFault>>,
    last: Option<&Snapshot>,
) -> Left {
    let (in_order, engine) = match ended {
        Some(Ok(())) => (true, "the engine ended in good order".to_owned()),
        Some(Err(why)) if !came_up => (false, format!("the engine did not come up: {why}")),
        Some(Err(why)) => (false, format!("the engine ended with a fault: {why}")),
        None => (false, "the engine did not end in time; the next start puts its work in order".to_owned()),
    };
    let mut parts = vec![engine];
    parts.extend(last.into_iter().flat_map(on_the_way));
    let text = Untrusted::new(parts.join("; ")).line().into_string();
    Left { cause, came_up, in_order, text }
}

/// How a console left an engine that works on: `kept` is what that engine said when it was told to go on with nobody, and
/// `ends_alone_s` for how long it does by itself.
pub(super) fn at_work(
    model: &Model,
    cause: Cause,
    kept: &Result<(), DoorError>,
    ends_alone_s: Option<u64>,
) -> Left {
    let (back, stop) = (model.in_shell(""), model.in_shell("stop"));
    let mut text = format!("left the engine at work; {back} comes back to it, {stop} stops its arm");
    if let Some(secs) = ends_alone_s {
        text.push_str(&format!("; with nobody at it, it ends after {secs} s"));
    }
    if let Err(error) = kept {
        text.push_str(&format!("; it was NOT told to go on with nobody: {}", error.sentence()));
    }
    let text = Untrusted::new(text).line().into_string();
    Left { cause, came_up: true, in_order: kept.is_ok(), text }
}

/// How a console left an engine that was told to end and is not done with it.
pub(super) fn still_ending(model: &Model, cause: Cause) -> Left {
    let status = model.in_shell("status");
    let text = format!("the engine was told to end and is at it; {status} says when the store is free");
    let text = Untrusted::new(text).line().into_string();
    Left { cause, came_up: true, in_order: false, text }
}

/// How a console found the end of an engine in another process.
pub(super) fn ended_elsewhere(cause: Cause, why: &EndFault) -> Left {
    let text =
        Untrusted::new(format!("the engine that this console was at is gone: {why}")).line().into_string();
    // Whoever ended it knew what they did.
    Left { cause, came_up: true, in_order: why.orderly, text }
}

/// What goes on at the next start, one part for each kind.
fn on_the_way(snapshot: &Snapshot) -> Vec<String> {
    let count =
        |is: &dyn Fn(&CandidateView) -> bool| snapshot.candidates.iter().filter(|one| is(one)).count();
    let mut parts = Vec::new();
    for stage in [Stage::Validation, Stage::Sandbox, Stage::Shadow, Stage::Activation] {
        let here = count(&|one| one.flags.running == Some(stage) && !one.flags.awaiting_approval);
        if here > 0 {
            parts.push(format!(
                "{} in {}: that stage is run again at the next start",
                candidates(here),
                stage.name()
            ));
        }
    }
    let waiting = snapshot.prompts.len();
    if waiting > 0 {
        parts.push(format!("{} held for approval; people are asked again", candidates(waiting)));
    }
    let watched = count(&|one| one.flags.provisional);
    if watched > 0 {
        parts.push(format!("{} provisional and watched on at the next start", candidates(watched)));
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
    fn says_how_the_engine_ended() {
        let fault = || Some(Err(EndFault::of("disk full\u{7}")));
        for (came_up, ended, in_order, words) in [
            (true, Some(Ok(())), true, "the engine ended in good order"),
            (true, fault(), false, r"with a fault: disk full\u{7}"),
            (false, fault(), false, r"did not come up: disk full\u{7}"),
            (true, None, false, "did not end in time"),
        ] {
            let left = left(Cause::Asked, came_up, ended, None);
            assert_eq!(left.in_order, in_order);
            assert!(left.text.contains(words), "{}", left.text);
        }
        assert_eq!(candidates(1), "1 candidate is");
        assert_eq!(candidates(3), "3 candidates are");
    }
}
