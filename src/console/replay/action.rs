//! What a replay's keys ask for: one table that makes the help and the hints.

use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};

macro_rules! actions {
    ($($(#[doc = $help:literal])+ $name:ident = $word:literal, $keys:literal;)*) => {
        /// What can be asked for.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Action {
            $($(#[doc = $help])+ $name,)*
        }

        impl Action {
            /// Every action, in the order of the help.
            pub const ALL: &'static [Self] = &[$(Self::$name),*];

            /// Its name in the hints.
            #[must_use]
            pub const fn word(self) -> &'static str {
                match self { $(Self::$name => $word,)* }
            }

            /// Its keys, with blanks between them, the one for the hints first.
            #[must_use]
            pub const fn keys(self) -> &'static str {
                match self { $(Self::$name => $keys,)* }
            }

            /// What it does.
            #[must_use]
            pub fn help(self) -> &'static str {
                match self { $(Self::$name => concat!($($help),+).trim(),)* }
            }
        }
    };
}

actions! {
    /// Play, or pause
    Play = "play", "space p";
    /// The next picture, paused
    NextPicture = "picture", "right l";
    /// The picture before, paused
    PreviousPicture = "picture back", "left h";
    /// One second on
    SecondOn = "second", ". shift-right";
    /// One second back
    SecondBack = "second back", ", shift-left";
    /// Play faster, up to 64 times
    Faster = "faster", "+ up =";
    /// Play slower, down to a quarter
    Slower = "slower", "- down _";
    /// The next event
    NextEvent = "event", "n ]";
    /// The event before
    PreviousEvent = "event back", "N [";
    /// The next decision, act of the monitor or rollback
    NextTurn = "decision", "d";
    /// The decision, act of the monitor or rollback before
    PreviousTurn = "decision back", "D";
    /// The recording's first moment
    First = "begin", "g home";
    /// The recording's last moment
    Last = "end", "G end";
    /// Jump to a second or tick; typing a number does it too
    Jump = "jump", ":";
    /// The next charts, and after the last those that fit the stage
    NextCharts = "charts", "tab";
    /// The charts before
    PreviousCharts = "charts back", "shift-tab";
    /// Skip what has no pictures while playing, or do not
    SkipGaps = "skip gaps", "s";
    /// This help
    Help = "help", "? f1";
    /// Close what is open, or leave the replay
    Leave = "leave", "q esc ctrl-c";
}

/// What a key asks for; absent where it asks for nothing.
#[must_use]
pub const fn of(key: KeyEvent) -> Option<Action> {
    let shift = key.modifiers.contains(KeyModifiers::SHIFT);
    if key.modifiers.intersects(KeyModifiers::CONTROL.union(KeyModifiers::ALT)) {
        return match key.code {
            KeyCode::Char('c') if key.modifiers.contains(KeyModifiers::CONTROL) => Some(Action::Leave),
            _ => None,
        };
    }
    Some(match key.code {
        KeyCode::Char(' ' | 'p') => Action::Play,
        KeyCode::Right if shift => Action::SecondOn,
        KeyCode::Left if shift => Action::SecondBack,
        KeyCode::Right | KeyCode::Char('l') => Action::NextPicture,
        KeyCode::Left | KeyCode::Char('h') => Action::PreviousPicture,
        KeyCode::Char('.') => Action::SecondOn,
        KeyCode::Char(',') => Action::SecondBack,
        KeyCode::Up | KeyCode::Char('+' | '=') => Action::Faster,
        KeyCode::Down | KeyCode::Char('-' | '_') => Action::Slower,
        KeyCode::Char('n' | ']') => Action::NextEvent,
        KeyCode::Char('N' | '[') => Action::PreviousEvent,
        KeyCode::Char('d') => Action::NextTurn,
        KeyCode::Char('D') => Action::PreviousTurn,
        KeyCode::Home | KeyCode::Char('g') => Action::First,
        KeyCode::End | KeyCode::Char('G') => Action::Last,
        KeyCode::Char(':') => Action::Jump,
        KeyCode::BackTab => Action::PreviousCharts,
        KeyCode::Tab if shift => Action::PreviousCharts,
        KeyCode::Tab => Action::NextCharts,
        KeyCode::Char('s') => Action::SkipGaps,
        KeyCode::Char('?') | KeyCode::F(1) => Action::Help,
        KeyCode::Char('q') | KeyCode::Esc => Action::Leave,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_key_of_the_table_does_what_it_says() {
        for action in Action::ALL {
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
