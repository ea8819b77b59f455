//! The panic policy: a fault of the screen restores the terminal, a fault elsewhere leaves the screen up.
//!
//! Installed last, so that no other hook restores a screen that is still drawn. Must not decide about the engine's
//! own faults: its host holds and raises the alarm.

use std::io::Write as _;
use std::panic::PanicHookInfo;

use holdpoint_text::{LINE_WIDTH_MAX, sanitize};

/// Installs the hook. The calling thread is the screen's from now on.
pub fn install() {
    let screen = std::thread::current().id();
    std::panic::set_hook(Box::new(move |info| {
        if std::thread::current().id() == screen {
            super::modes::restore();
        }
        // fd 2 is the log while the screen is up. If it cannot be written to, the message is lost.
        let mut stderr = std::io::stderr().lock();
        drop(writeln!(stderr, "{}", line_of(info)));
        let trace = std::backtrace::Backtrace::capture();
        if trace.status() == std::backtrace::BacktraceStatus::Captured {
            drop(writeln!(stderr, "{trace}"));
        }
    }));
}

/// Restores the standard panic hook.
pub fn uninstall() {
    drop(std::panic::take_hook());
}

/// One line: thread, message, place. A panic's message may contain foreign text.
fn line_of(info: &PanicHookInfo<'_>) -> String {
    let what = info.payload_as_str().unwrap_or("no words");
    let place = info.location().map_or_else(String::new, |at| format!(" at {}:{}", at.file(), at.line()));
    let thread = std::thread::current().name().unwrap_or("unnamed").to_owned();
    format!("error: internal: the thread {thread:?} failed{place}: {}", sanitize(what, LINE_WIDTH_MAX))
}
