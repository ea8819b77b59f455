//! The terminal contract: what the console turns on, and that all of it is undone however the console ends.
//!
//! Owns the terminal modes, the redirection of fd 2, the panic policy, and the guard for signals and a lost terminal.
//! Must not draw, read keys, or know the engine.

pub mod background;
pub mod guard;
pub mod log;
pub mod modes;
pub mod panic;

use std::io;

use self::log::LogFile;
use self::modes::TerminalCheck;

/// The terminal under the console's control. Dropping it restores the terminal, as the panic hook and the guard do.
#[derive(Debug)]
#[must_use = "dropping it gives the terminal back"]
pub struct TerminalGuard {
    log: Option<LogFile>,
}

impl TerminalGuard {
    /// Takes the terminal: fd 2 goes to the log, then raw mode, alternate screen, hidden cursor, bracketed paste,
    /// focus reports and, if requested, the mouse. Without a log file fd 2 stays, and nothing is written to it.
    ///
    /// # Errors
    /// If the terminal accepts no settings; it is then as it was.
    pub fn enter(log: Option<LogFile>, mouse: bool) -> io::Result<Self> {
        if let Some(log) = &log {
            log.take_stderr()?;
        }
        // From here on dropping `guard` undoes what was done so far.
        let guard = Self { log };
        modes::enter(mouse)?;
        Ok(guard)
    }

    /// The file for messages while the screen is up; absent if there is no log.
    #[must_use]
    pub fn log_path(&self) -> Option<&std::path::Path> {
        self.log.as_ref().map(LogFile::path)
    }

    /// Takes the mouse, or gives it back.
    ///
    /// # Errors
    /// If the terminal cannot be written to.
    pub fn take_mouse(&self, take: bool) -> io::Result<()> {
        modes::mouse(take)
    }
}

impl TerminalGuard {
    /// Turns on again what another program turned off; see [`modes::regain`].
    #[must_use]
    pub fn check(&self, continued: bool) -> TerminalCheck {
        modes::regain(continued)
    }
}

impl Drop for TerminalGuard {
    fn drop(&mut self) {
        modes::restore();
    }
}
