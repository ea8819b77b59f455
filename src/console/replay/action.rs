//! The actions of a replay's keys: one table that makes the help and the hints.

use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};

macro_rules! actions {
    ($($(#[doc = $help:literal])+ $variant:ident = $name:literal, $keys:literal;)*) => {
        /// An action of the replay.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum ReplayAction {
            $($(#[doc = $help])+ $variant,)*
        }

        impl ReplayAction {
            /// Every action, in the order of the help.
            pub const ALL: &'static [Self] = &[$(Self::$variant),*];

            /// Its name in the hints.
            #[must_use]
            pub const fn name(self) -> &'static str {
                match self { $(Self::$variant => $name,)* }
            }

            /// Its keys, with blanks between them, the one for the hints first.
            #[must_use]
            pub const fn keys(self) -> &'static str {
                match self { $(Self::$variant => $keys,)* }
            }

            /// What it does.
            #[must_use]
            pub fn help(self) -> &'static str {
                match self { $(Self::$variant => concat!($($help),+).trim(),)* }
            }
        }
    };
}

actions! {
    /// Play, or pause
    Play = "play", "space p";
    /// Next frame
    NextFrame = "frame", "right l";
    /// previous frame
    PreviousFrame = "frame back", "left h";
    /// One second on
    SecondOn = "second", ". shift-right";
    /// one second back
    SecondBack = "second back", ", shift-left";
    /// Play faster, up to 64x
    Faster = "faster", "+ up =";
    /// slower, down to 1/4x
    Slower = "slower", "- down _";
    /// Next event
    NextEvent = "event", "n ]";
    /// the one before
    PreviousEvent = "event back", "N [";
    /// Next decision, monitor act, rollback
    NextTurn = "decision", "d";
    /// before
    PreviousTurn = "decision back", "D";
    /// Where it went wrong; again: the next
    Failure = "went wrong", "m";
    /// To the beginning
    First = "begin", "g home";
    /// to the end
    Last = "end", "G end";
    /// Jump: 12.5s, 1:02, t 3000; or type a number
    Jump = "jump", ":";
    /// Other charts
    NextCharts = "charts", "tab";
    /// the ones before
    PreviousCharts = "charts back", "shift-tab";
    /// Skip gaps without frames while playing, or not
    SkipGaps = "skip gaps", "s";
    /// This help
    Help = "help", "? f1";
    /// Close what is open, or leave
    Leave = "leave", "q esc ctrl-c";
}

/// The action of a key; absent for a key without one.
#[must_use]
pub const fn of(key: KeyEvent) -> Option<ReplayAction> {
    let shift = key.modifiers.contains(KeyModifiers::SHIFT);
    if key.modifiers.intersects(KeyModifiers::CONTROL.union(KeyModifiers::ALT)) {
        return match key.code {
            KeyCode::Char('c') if key.modifiers.contains(KeyModifiers::CONTROL) => Some(ReplayAction::Leave),
            _ => None,
        };
    }
    Some(match key.code {
        KeyCode::Char(' ' | 'p') => ReplayAction::Play,
        KeyCode::Right if shift => ReplayAction::SecondOn,
        KeyCode::Left if shift => ReplayAction::SecondBack,
        KeyCode::Right | KeyCode::Char('l') => ReplayAction::NextFrame,
        KeyCode::Left | KeyCode::Char('h') => ReplayAction::PreviousFrame,
        KeyCode::Char('.') => ReplayAction::SecondOn,
        KeyCode::Char(',') => ReplayAction::SecondBack,
        KeyCode::Up | KeyCode::Char('+' | '=') => ReplayAction::Faster,
        KeyCode::Down | KeyCode::Char('-' | '_') => ReplayAction::Slower,
        KeyCode::Char('n' | ']') => ReplayAction::NextEvent,
        KeyCode::Char('N' | '[') => ReplayAction::PreviousEvent,
        KeyCode::Char('d') => ReplayAction::NextTurn,
        KeyCode::Char('D') => ReplayAction::PreviousTurn,
        KeyCode::Char('m') => ReplayAction::Failure,
        KeyCode::Home | KeyCode::Char('g') => ReplayAction::First,
        KeyCode::End | KeyCode::Char('G') => ReplayAction::Last,
        KeyCode::Char(':') => ReplayAction::Jump,
        KeyCode::BackTab => ReplayAction::PreviousCharts,
        KeyCode::Tab if shift => ReplayAction::PreviousCharts,
        KeyCode::Tab => ReplayAction::NextCharts,
        KeyCode::Char('s') => ReplayAction::SkipGaps,
        KeyCode::Char('?') | KeyCode::F(1) => ReplayAction::Help,
        KeyCode::Char('q') | KeyCode::Esc => ReplayAction::Leave,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_key_of_the_table_runs_its_action() {
        for action in ReplayAction::ALL {
            for name in action.keys().split(' ') {
                let (modifiers, plain) = match name.split_once('-') {
                    Some(("shift", rest)) => (KeyModifiers::SHIFT, rest),
                    Some(("ctrl", rest)) => (KeyModifiers::CONTROL, rest),
                    _ => (KeyModifiers::NONE, name),
                };
                let code = match plain {
                    "space" => KeyCode::Char(' '),
                    "right" => KeyCode::Right,
                    "left" => KeyCode::Left,
                    "up" => KeyCode::Up,
                    "down" => KeyCode::Down,
                    "home" => KeyCode::Home,
                    "end" => KeyCode::End,
                    "tab" => KeyCode::Tab,
                    "f1" => KeyCode::F(1),
                    "esc" => KeyCode::Esc,
                    sign => KeyCode::Char(sign.chars().next().unwrap()),
                };
                assert_eq!(of(KeyEvent::new(code, modifiers)), Some(*action), "{name}");
            }
        }
        assert_eq!(of(KeyEvent::new(KeyCode::Char('x'), KeyModifiers::NONE)), None);
        assert_eq!(of(KeyEvent::new(KeyCode::Char('q'), KeyModifiers::ALT)), None);
    }
}
