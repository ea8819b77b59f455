//! The terminal's modes: each is noted before it is turned on, so that any thread can undo exactly that.
//!
//! The note is one byte for the whole process, because the panic hook and the guard's thread must reach it. In the
//! middle of a frame, only the end of the program may use it.

use std::io;
use std::sync::atomic::{AtomicU8, Ordering};

use ratatui::crossterm::terminal::{disable_raw_mode, enable_raw_mode};
use rustix::process::getpgrp;
use rustix::stdio::stdin;
use rustix::termios::{LocalModes, OptionalActions, Termios, tcgetattr, tcgetpgrp, tcsetattr};

use super::log;

/// Raw mode: keys come one by one, and no key makes a signal.
const RAW: u8 = 1;

/// A mode that two control sequences turn on and off.
struct Mode {
    bit: u8,
    on: &'static [u8],
    off: &'static [u8],
}

/// In the order in which they are turned on; turning off reverses it.
const MODES: [Mode; 5] = [
    Mode { bit: 1 << 1, on: b"\x1b[?1049h", off: b"\x1b[?1049l" },
    Mode { bit: 1 << 2, on: b"\x1b[?25l", off: b"\x1b[?25h" },
    PASTE,
    Mode { bit: 1 << 4, on: b"\x1b[?1004h", off: b"\x1b[?1004l" },
    MOUSE,
];

/// Bracketed paste.
const PASTE: Mode = Mode { bit: 1 << 3, on: b"\x1b[?2004h", off: b"\x1b[?2004l" };

/// Buttons and the wheel, in coordinates without a limit; moves are unused and not reported.
const MOUSE: Mode = Mode { bit: 1 << 5, on: b"\x1b[?1000h\x1b[?1006h", off: b"\x1b[?1006l\x1b[?1000l" };

/// Ends a frame that was cut off, and resets its last colors.
const END_FRAME: &[u8] = b"\x1b[?2026l\x1b[0m";

/// What is on now.
static ON: AtomicU8 = AtomicU8::new(0);

/// Turns on all modes, with the mouse if requested.
///
/// # Errors
/// If the terminal does not accept it. Modes turned on so far are noted.
pub fn enter(mouse: bool) -> io::Result<()> {
    ON.fetch_or(RAW, Ordering::AcqRel);
    enable_raw_mode()?;
    for mode in MODES.iter().filter(|mode| mouse || mode.bit != MOUSE.bit) {
        turn_on(mode)?;
    }
    Ok(())
}

/// Turns the mouse on or off.
///
/// # Errors
/// If the terminal cannot be written to.
pub fn mouse(take: bool) -> io::Result<()> {
    if take {
        return turn_on(&MOUSE);
    }
    let was = ON.fetch_and(!MOUSE.bit, Ordering::AcqRel);
    if was & MOUSE.bit == 0 { Ok(()) } else { write_all(MOUSE.off) }
}

/// What a check of the terminal found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TerminalCheck {
    /// The modes are as they were set, or the terminal was given back.
    Kept,
    /// The modes were turned on again; the contents of the screen are unknown.
    Regained,
    /// The terminal is in line mode, and cannot be changed from here: no key arrives alone.
    LineMode,
}

/// Turns on again what another program turned off, as a shell does while this one is suspended. `continued`: this
/// program was suspended, so everything is turned on again. Only line mode can be seen; bracketed paste is sent again.
#[must_use]
pub fn regain(continued: bool) -> TerminalCheck {
    let on = ON.load(Ordering::Acquire);
    if on & RAW == 0 {
        return TerminalCheck::Kept;
    }
    let is_raw = tcgetattr(stdin()).is_ok_and(|settings| reads_keys(&settings));
    // A program in the background would be suspended again by a change of the settings.
    let is_foreground = tcgetpgrp(stdin()).map_or(true, |group| group == getpgrp());
    if !is_foreground {
        return if is_raw { TerminalCheck::Kept } else { TerminalCheck::LineMode };
    }
    if is_raw && !continued {
        drop(write_all(PASTE.on));
        return TerminalCheck::Kept;
    }
    if !is_raw && make_raw().is_err() {
        return TerminalCheck::LineMode;
    }
    for mode in MODES.iter().filter(|mode| on & mode.bit != 0) {
        drop(write_all(mode.on));
    }
    TerminalCheck::Regained
}

/// Whether keys come one by one, and are not echoed.
fn reads_keys(settings: &Termios) -> bool {
    !settings.local_modes.intersects(LocalModes::ICANON | LocalModes::ECHO)
}

/// Sets raw mode. The library sets it once only, whatever the terminal's state is.
fn make_raw() -> rustix::io::Result<()> {
    let mut settings = tcgetattr(stdin())?;
    settings.make_raw();
    tcsetattr(stdin(), OptionalActions::Now, &settings)
}

/// Undoes what is on, in reverse, and restores fd 2. Does nothing the second time. Failures are ignored: the terminal
/// may be gone.
pub fn restore() {
    let on = ON.swap(0, Ordering::AcqRel);
    if on != 0 {
        drop(write_all(&leaving(on)));
        if on & RAW != 0 {
            drop(disable_raw_mode());
        }
    }
    log::restore_stderr();
}

/// As [`restore`], for a terminal that may accept no more bytes: the settings first, because they never wait.
pub fn restore_settings_first() {
    drop(disable_raw_mode());
    restore();
}

/// Whether anything is on.
#[must_use]
pub fn is_on() -> bool {
    ON.load(Ordering::Acquire) != 0
}

fn turn_on(mode: &Mode) -> io::Result<()> {
    ON.fetch_or(mode.bit, Ordering::AcqRel);
    write_all(mode.on)
}

/// The sequences that undo what is on.
fn leaving(on: u8) -> Vec<u8> {
    let mut bytes = END_FRAME.to_vec();
    for mode in MODES.iter().rev().filter(|mode| on & mode.bit != 0) {
        bytes.extend_from_slice(mode.off);
    }
    bytes
}

/// Bypasses all buffers: a half-written frame in one must not follow this.
fn write_all(mut bytes: &[u8]) -> io::Result<()> {
    while !bytes.is_empty() {
        let written = rustix::io::retry_on_intr(|| rustix::io::write(rustix::stdio::stdout(), bytes))?;
        if written == 0 {
            return Err(io::ErrorKind::WriteZero.into());
        }
        bytes = bytes.get(written..).unwrap_or_default();
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn leaving_turns_off_only_active_modes_in_reverse_order() {
        let all = MODES.iter().fold(RAW, |on, mode| on | mode.bit);
        let text = String::from_utf8(leaving(all)).unwrap();
        let places: Vec<usize> = ["[?1006l", "[?1000l", "[?1004l", "[?2004l", "[?25h", "[?1049l"]
            .iter()
            .map(|sequence| text.find(sequence).unwrap())
            .collect();
        assert!(places.is_sorted(), "{text:?}");
        let without = String::from_utf8(leaving(all & !MOUSE.bit)).unwrap();
        assert!(!without.contains("1000") && without.ends_with("\u{1b}[?1049l"), "{without:?}");
        assert_eq!(leaving(0), END_FRAME);
    }

    #[test]
    fn a_terminal_that_was_given_back_is_left_alone() {
        // Nothing is on in a test.
        for continued in [false, true] {
            assert_eq!(regain(continued), TerminalCheck::Kept);
        }
    }

    #[test]
    fn every_mode_has_its_own_bit() {
        let bits = MODES.iter().fold(RAW, |seen, mode| {
            assert_eq!(seen & mode.bit, 0, "{:?}", mode.on);
            seen | mode.bit
        });
        assert_eq!(bits.count_ones(), 6);
    }
}
