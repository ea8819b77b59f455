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
use holdpoint_wording::console::no_engine as wording;
use holdpoint_wording::console::shared;

pub fn draw(model: &ConsoleModel, absence: EngineAbsence, pen: &mut Pen<'_>, area: Rect) {
    let mut rest = pen.pane(area, shared::NO_ENGINE_HERE_TITLE, true, "");
    let why = match &model.engine_data.engine {
        EngineState::Ended(Err(why)) => why.to_string(),
        EngineState::Ended(Ok(())) | EngineState::Starting | EngineState::Running => {
            wording::HAS_ENDED.to_owned()
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
    say(ThemeRole::Title, wording::WHAT_WORKS);
    let keys = |action| model.keymap.keys(action).join(" or ");
    say(
        ThemeRole::Text,
        &format!(
            "{}: {}",
            keys(Action::Stop),
            match absence {
                EngineAbsence::HeldElsewhere => wording::STOPS_ELSEWHERE,
                EngineAbsence::Ended => wording::ASKS_ANY,
            }
        ),
    );
    say(ThemeRole::Text, &wording::ends_this_console(&keys(Action::Quit)));
    say(ThemeRole::Text, &wording::in_a_shell(&model.in_shell("status"), &model.in_shell("stop")));
}
