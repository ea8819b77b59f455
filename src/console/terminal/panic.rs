//! The panic policy: a fault of the screen gives the terminal back, a fault elsewhere leaves the screen up.
//!
//! Installed last, so that no other hook restores a screen that is still drawn. Must not decide what the engine
//! does after a fault of its own: its host holds and raises the alarm.

use std::io::Write as _;
use std::panic::PanicHookInfo;

use holdpoint_text::{LINE_WIDTH_MAX, sanitise};

/// Installs the hook. The calling thread is the screen's from now on.
pub fn install() {
    let screen = std::thread::current().id();
    std::panic::set_hook(Box::new(move |info| {
        if std::thread::current().id() == screen {
            super::modes::restore();
        }
        // fd 2 is the log while the screen is up. Where it cannot be written to nobody is left to tell.
        let mut stderr = std::io::stderr().lock();
        drop(writeln!(stderr, "{}", line_of(info)));
        let trace = std::backtrace::Backtrace::capture();
        if trace.status() == std::backtrace::BacktraceStatus::Captured {
            drop(writeln!(stderr, "{trace}"));
        }
    }));
}

/// Gives panics back to the standard hook.
pub fn uninstall() {
    drop(std::panic::take_hook());
}

/// One line: which thread, what, where. What a panic says may hold foreign text.
fn line_of(info: &PanicHookInfo<'_>) -> String {
    let what = info.payload_as_str().unwrap_or("no words");
    let place = info.location().map_or_else(String::new, |at| format!(" at {}:{}", at.file(), at.line()));
    let thread = std::thread::current().name().unwrap_or("unnamed").to_owned();
    format!("error: internal: the thread {thread:?} failed{place}: {}", sanitise(what, LINE_WIDTH_MAX))
}
