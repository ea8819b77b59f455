//! In place of every view while no engine is at work here and none ever told anything: why, and what works all the same.
//!
//! ```text
//! ─ No engine here ─────────────────────────────────
//! the store "/data" is in use by process 712 …
//! X  stops the arm: the engine that is at work is asked
//! q  ends this console, with exit code 2
//! ```

use ratatui::layout::Rect;

use crate::action::Action;
use crate::look::ThemeRole;
use crate::model::{Absence, EngineState, Model};
use crate::widgets::pen::{Pen, below};

pub fn draw(model: &Model, absence: Absence, pen: &mut Pen<'_>, area: Rect) {
    let mut rest = pen.pane(area, "No engine is at work here", true, "");
    let why = match &model.told.engine {
        EngineState::Ended(Err(why)) => why.text.as_str(),
        EngineState::Ended(Ok(())) | EngineState::Starting | EngineState::Running => "It has ended",
    };
    let mut say = |role: ThemeRole, text: &str| {
        let taken = pen.text(rest, 0, role, text);
        rest = below(rest, taken);
    };
    say(ThemeRole::Problem, why);
    if let Some(seeking) = &model.told.seeking {
        say(ThemeRole::Stale, &seeking.words());
    }
    say(ThemeRole::Text, "");
    say(ThemeRole::Title, "What works from here:");
    let keys = |action| model.keymap.keys(action).join(" or ");
    say(
        ThemeRole::Text,
        &format!(
            "{}: {}",
            keys(Action::Stop),
            match absence {
                Absence::HeldElsewhere =>
                    "stops the arm; the engine that is at work is asked, and its answer is shown",
                Absence::Ended => "asks whatever engine is at work on this store to stop the arm",
            }
        ),
    );
    say(
        ThemeRole::Text,
        &format!("{}: ends this console, with exit code 2; no other engine ends by it", keys(Action::Quit)),
    );
    say(
        ThemeRole::Text,
        &format!(
            "in a shell, {} shows how things stand, and {} stops the arm as well",
            model.in_shell("status"),
            model.in_shell("stop")
        ),
    );
}
