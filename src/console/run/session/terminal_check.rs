//! The check of the terminal's modes while the console runs: a shell, or another program, may have changed them.
//!
//! Owns when the modes are turned on again. Must not decide what a key means.

use tokio::signal::unix::{Signal, SignalKind, signal};

use super::Session;
use crate::msg::MsgKind;
use crate::run::frame_pace::FrameReason;
use crate::terminal::modes::TerminalCheck;

/// Watches for the signal that continues a suspended program; absent if it cannot be watched. The check at every tick
/// then remains.
pub(super) fn watch_continue() -> Option<Signal> {
    signal(SignalKind::from_raw(rustix::process::Signal::CONT.as_raw())).ok()
}

/// Waits until this program continues after it was suspended.
pub(super) async fn continued(watch: &mut Option<Signal>) {
    let is_signalled = match watch {
        Some(watch) => watch.recv().await.is_some(),
        None => false,
    };
    if !is_signalled {
        std::future::pending::<()>().await;
    }
}

impl Session {
    /// Turns the modes on again where another program turned them off, and shows whether keys arrive.
    pub(super) fn check_terminal(&mut self, continued: bool) {
        if self.screen_lost {
            return;
        }
        let check = self.terminal.check(continued);
        if check == TerminalCheck::Regained {
            match self.screen.size() {
                Ok((columns, rows)) => self.input(MsgKind::Resize(columns, rows)),
                Err(_) => self.end_signalled(true),
            }
        }
        let line_mode = check == TerminalCheck::LineMode;
        if line_mode != self.model.line_mode {
            self.take(MsgKind::LineMode(line_mode), FrameReason::Key);
        }
    }
}
