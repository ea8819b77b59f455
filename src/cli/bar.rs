//! How far a verb is, on the standard error of a terminal, once it has taken a while.

use std::cell::RefCell;
use std::io::IsTerminal;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

/// What is done sooner shows no bar.
const AFTER: Duration = Duration::from_secs(2);

/// A bar that comes after two seconds, and only on a terminal.
pub(super) struct LateBar {
    began: Instant,
    wanted: bool,
    bar: RefCell<Option<ProgressBar>>,
}

impl LateBar {
    pub(super) fn new() -> Self {
        Self { began: Instant::now(), wanted: std::io::stderr().is_terminal(), bar: RefCell::new(None) }
    }

    /// What is looked at, how much of it was, and how much there is.
    pub(super) fn tell(&self, what: &str, done: u64, total: u64) {
        if !self.wanted || self.began.elapsed() < AFTER {
            return;
        }
        let mut slot = self.bar.borrow_mut();
        let bar = slot.get_or_insert_with(|| {
            let bar = ProgressBar::with_draw_target(None, ProgressDrawTarget::stderr());
            if let Ok(style) = ProgressStyle::with_template("{bar:24} {pos}/{len} {msg}") {
                bar.set_style(style.progress_chars("=> "));
            }
            bar
        });
        bar.set_length(total);
        bar.set_position(done);
        bar.set_message(what.to_owned());
    }
}

impl Drop for LateBar {
    fn drop(&mut self) {
        if let Some(bar) = self.bar.borrow().as_ref() {
            bar.finish_and_clear();
        }
    }
}
