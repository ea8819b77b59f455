//! A progress bar on standard error, if a verb takes long and the output is a terminal.

use std::cell::RefCell;
use std::io::IsTerminal;
use std::time::{Duration, Instant};

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

/// Shorter work shows no bar.
const AFTER: Duration = Duration::from_secs(2);

/// A bar that comes after two seconds, and only on a terminal.
pub(super) struct DelayedProgressBar {
    began: Instant,
    wanted: bool,
    bar: RefCell<Option<ProgressBar>>,
}

impl DelayedProgressBar {
    pub(super) fn new() -> Self {
        Self { began: Instant::now(), wanted: std::io::stderr().is_terminal(), bar: RefCell::new(None) }
    }

    /// The item, the amount done, and the total.
    pub(super) fn update(&self, what: &str, done: u64, total: u64) {
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

impl Drop for DelayedProgressBar {
    fn drop(&mut self) {
        if let Some(bar) = self.bar.borrow().as_ref() {
            bar.finish_and_clear();
        }
    }
}
