//! Terminal input, read on a separate thread, so that a lost terminal or a half-sent sequence blocks that thread and
//! not the console.
//!
//! Must not decide what a key means. Late answers to a question about the terminal's colors are no keys.

use std::io;
use std::time::{Duration, Instant};

use ratatui::crossterm::event::{
    self, Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers, MouseButton, MouseEvent, MouseEventKind,
};
use tokio::sync::mpsc;

use crate::msg::MsgKind;

/// The most inputs in the queue; beyond that the thread stops reading.
const WAITING_MAX: usize = 256;

/// Rows scrolled by a notch of the wheel.
const WHEEL_ROWS: i32 = 3;

/// The longest paste, bytes; a line holds far less.
const PASTE_BYTES_MAX: usize = 64 * 1024;

/// Keys that follow each other faster than this come from a paste or a program, or were held up on their way.
const BURST: Duration = Duration::from_millis(25);

/// The most keys of one late answer; further ones are typed.
const ANSWER_KEYS_MAX: usize = 64;

/// Starts reading. The receiver ends if the terminal can no longer be read.
///
/// # Errors
/// If no thread can be started.
pub fn start() -> io::Result<mpsc::Receiver<MsgKind>> {
    let (sender, receiver) = mpsc::channel(WAITING_MAX);
    std::thread::Builder::new().name("console-input".to_owned()).spawn(move || {
        let mut answers = LateColorReply::default();
        let mut keys = KeyTimes::default();
        while let Ok(event) = event::read() {
            let Some(what) = what(event, &mut answers) else { continue };
            let is_key = matches!(what, MsgKind::Key(_));
            if is_key && keys.is_burst(Instant::now()) && sender.blocking_send(MsgKind::Burst).is_err() {
                return;
            }
            if sender.blocking_send(what).is_err() {
                return;
            }
        }
    })?;
    Ok(receiver)
}

/// When the last key was read.
#[derive(Debug, Default)]
struct KeyTimes {
    last: Option<Instant>,
}

impl KeyTimes {
    /// Takes in a key and returns whether it follows the one before it faster than a person types.
    fn is_burst(&mut self, now: Instant) -> bool {
        let last = self.last.replace(now);
        last.is_some_and(|last| now.saturating_duration_since(last) < BURST)
    }
}

/// The message for a terminal event; absent if it has none.
fn what(event: Event, answers: &mut LateColorReply) -> Option<MsgKind> {
    match event {
        Event::Key(key) if key.kind == KeyEventKind::Release => None,
        Event::Key(key) if answers.swallow(key) => None,
        Event::Key(key) => Some(MsgKind::Key(key)),
        Event::Paste(text) => Some(MsgKind::Paste(bounded(text))),
        Event::Mouse(mouse) => pointed(mouse),
        Event::Resize(columns, rows) => Some(MsgKind::Resize(columns, rows)),
        // Losing the focus changes nothing on the screen.
        Event::FocusGained | Event::FocusLost => None,
    }
}

/// Only the wheel and the left button have a meaning.
const fn pointed(mouse: MouseEvent) -> Option<MsgKind> {
    match mouse.kind {
        MouseEventKind::ScrollDown => Some(MsgKind::Wheel(WHEEL_ROWS)),
        MouseEventKind::ScrollUp => Some(MsgKind::Wheel(-WHEEL_ROWS)),
        MouseEventKind::Down(MouseButton::Left) => Some(MsgKind::Click(mouse.column, mouse.row)),
        MouseEventKind::Down(_)
        | MouseEventKind::Up(_)
        | MouseEventKind::Drag(_)
        | MouseEventKind::Moved
        | MouseEventKind::ScrollLeft
        | MouseEventKind::ScrollRight => None,
    }
}

fn bounded(mut text: String) -> String {
    let mut end = PASTE_BYTES_MAX.min(text.len());
    while !text.is_char_boundary(end) {
        end -= 1;
    }
    text.truncate(end);
    text
}

/// Discards late answers about colors: they begin with `ESC ] 1 1 ; ...`, which reads as alt-] and keys, and end with
/// `ESC \` or BEL.
#[derive(Debug, Default)]
struct LateColorReply {
    /// Keys of the present answer so far; absent outside one.
    keys: Option<usize>,
}

impl LateColorReply {
    /// Whether a key belongs to an answer and is discarded.
    fn swallow(&mut self, key: KeyEvent) -> bool {
        let Some(keys) = self.keys else {
            let begins = key.code == KeyCode::Char(']') && key.modifiers == KeyModifiers::ALT;
            self.keys = begins.then_some(1);
            return begins;
        };
        let ends = matches!(
            (key.code, key.modifiers),
            (KeyCode::Char('\\'), KeyModifiers::ALT) | (KeyCode::Char('g'), KeyModifiers::CONTROL)
        );
        self.keys = (!ends && keys + 1 < ANSWER_KEYS_MAX).then_some(keys + 1);
        // Only keys that an answer can contain are discarded: any other key is typed, and ends the answer.
        let belongs = ends
            || matches!(key.code, KeyCode::Char(sign) if sign.is_ascii_hexdigit() || "rgb:;/".contains(sign));
        if !belongs {
            self.keys = None;
        }
        belongs
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn typed(keys: &[(char, KeyModifiers)]) -> String {
        let mut answers = LateColorReply::default();
        keys.iter()
            .filter(|(sign, modifiers)| {
                let key = KeyEvent::new(KeyCode::Char(*sign), *modifiers);
                what(Event::Key(key), &mut answers).is_some()
            })
            .map(|(sign, _)| *sign)
            .collect()
    }

    fn plain(text: &str) -> Vec<(char, KeyModifiers)> {
        text.chars().map(|sign| (sign, KeyModifiers::NONE)).collect()
    }

    #[test]
    fn only_the_left_button_and_the_wheel_are_read_from_the_mouse() {
        let mouse = |kind| MouseEvent { kind, column: 7, row: 3, modifiers: KeyModifiers::NONE };
        for (kind, taken) in [
            (MouseEventKind::Down(MouseButton::Left), Some(MsgKind::Click(7, 3))),
            (MouseEventKind::Down(MouseButton::Right), None),
            (MouseEventKind::Up(MouseButton::Left), None),
            (MouseEventKind::Drag(MouseButton::Left), None),
            (MouseEventKind::Moved, None),
            (MouseEventKind::ScrollDown, Some(MsgKind::Wheel(WHEEL_ROWS))),
        ] {
            assert_eq!(pointed(mouse(kind)), taken, "{kind:?}");
        }
    }

    #[test]
    fn late_terminal_answers_are_not_read_as_keys() {
        let mut keys = plain("ab");
        keys.push((']', KeyModifiers::ALT));
        keys.extend(plain("11;rgb:1e1e/1e1e/1e1e"));
        keys.push(('\\', KeyModifiers::ALT));
        keys.extend(plain("1q"));
        assert_eq!(typed(&keys), "ab1q");
        // A key outside an answer ends it: only the keys since alt-] are lost.
        let mut broken = vec![(']', KeyModifiers::ALT)];
        broken.extend(plain("xab"));
        assert_eq!(typed(&broken), "xab");
        let mut endless = vec![(']', KeyModifiers::ALT)];
        endless.extend(plain(&"1".repeat(ANSWER_KEYS_MAX)));
        assert_eq!(typed(&endless), "1");
    }

    #[test]
    fn keys_faster_than_typing_are_a_burst() {
        let (mut keys, start) = (KeyTimes::default(), Instant::now());
        let at = |ms| start + Duration::from_millis(ms);
        let is_burst = [0, 24, 48, 73, 200].map(|ms| keys.is_burst(at(ms)));
        assert_eq!(is_burst, [false, true, true, false, false]);
    }

    #[test]
    fn releases_and_moves_are_ignored_and_pastes_are_bounded() {
        let mut answers = LateColorReply::default();
        let released = KeyEvent::new_with_kind(KeyCode::Char('x'), KeyModifiers::NONE, KeyEventKind::Release);
        assert_eq!(what(Event::Key(released), &mut answers), None);
        let repeated = KeyEvent::new_with_kind(KeyCode::Char('x'), KeyModifiers::NONE, KeyEventKind::Repeat);
        assert_eq!(what(Event::Key(repeated), &mut answers), Some(MsgKind::Key(repeated)));
        assert_eq!(what(Event::FocusGained, &mut answers), None);
        let Some(MsgKind::Paste(text)) = what(Event::Paste("é".repeat(PASTE_BYTES_MAX)), &mut answers)
        else {
            panic!("a paste is a paste");
        };
        assert_eq!(text.len(), PASTE_BYTES_MAX);
    }
}
