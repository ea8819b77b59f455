//! The terminal contract: what the console turns on, and that all of it is undone however the console ends.
//!
//! Owns the modes of the terminal, where fd 2 goes meanwhile, the panic policy and the guard that watches for
//! signals and a lost terminal. Must not draw, read keys, or know the engine: a terminal that is gone means that
//! somebody else holds.

pub mod background;
pub mod guard;
pub mod log;
pub mod modes;
pub mod panic;

use std::io;

use self::log::LogFile;

/// The terminal in the console's hands. Undoes on drop what it did, in reverse; so do the panic hook and the guard.
#[derive(Debug)]
#[must_use = "dropping it gives the terminal back"]
pub struct TerminalGuard {
    log: Option<LogFile>,
}

impl TerminalGuard {
    /// Takes the terminal: fd 2 goes to the log, then raw mode, alternate screen, hidden cursor, bracketed paste,
    /// focus reports and, if wanted, the mouse. Without a log file fd 2 stays, and nothing is written to it.
    ///
    /// # Errors
    /// If the terminal takes no settings; it is as it was then.
    pub fn enter(log: Option<LogFile>, mouse: bool) -> io::Result<Self> {
        if let Some(log) = &log {
            log.take_stderr()?;
        }
        // From here on dropping `guard` undoes what was done so far.
        let guard = Self { log };
        modes::enter(mouse)?;
        Ok(guard)
    }

    /// Where messages go while the screen is up; absent if there is no place for a log.
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

impl Drop for TerminalGuard {
    fn drop(&mut self) {
        modes::restore();
    }
}
