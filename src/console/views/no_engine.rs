//! In place of every view if no engine is running and none has sent data: the reason, and the keys that still work.
//!
//! ```text
//! ─ No engine here ─────────────────────────────────
//! the store "/data" is in use by process 712 …
//! X  stops the arm: the running engine is asked
//! q  ends this console, with exit code 2
//! ```

use ratatui::layout::Rect;

use crate::action::Action;
use crate::look::ThemeRole;
use crate::model::{ConsoleModel, EngineAbsence, EngineState};
use crate::widgets::pen::{Pen, below};

pub fn draw(model: &ConsoleModel, absence: EngineAbsence, pen: &mut Pen<'_>, area: Rect) {
    let mut rest = pen.pane(area, "No engine is running here", true, "");
    let why = match &model.engine_data.engine {
        EngineState::Ended(Err(why)) => why.to_string(),
        EngineState::Ended(Ok(())) | EngineState::Starting | EngineState::Running => {
            "It has ended".to_owned()
        }
    };
    let mut say = |role: ThemeRole, text: &str| {
        let taken = pen.text(rest, 0, role, text);
        rest = below(rest, taken);
    };
    say(ThemeRole::Problem, &why);
    if let Some(seeking) = &model.engine_data.reconnect {
        say(ThemeRole::Stale, &seeking.description());
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
                EngineAbsence::HeldElsewhere =>
                    "stops the arm; the running engine is asked, and its answer is shown",
                EngineAbsence::Ended => "asks any running engine of this store to stop the arm",
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
            "in a shell, {} shows the state, and {} stops the arm as well",
            model.in_shell("status"),
            model.in_shell("stop")
        ),
    );
}
