//! Opens the replay of a recording made by hand on this terminal, to be looked at.
//!
//!     cargo run --example replay_screen [-- --ascii]
#![allow(clippy::unwrap_used, reason = "a tool that shows what there is, or fails")]

#[allow(dead_code, reason = "the tests use the rest")]
mod shift;
#[allow(dead_code, reason = "the tests use the rest")]
mod upgrade;

use holdpoint::console::options::{CommandLineFlags, Options, SettingsFile};
use holdpoint::console::replay::speed::Speed;
use holdpoint::console::replay::{ReplayError, ReplayOptions, run};
use holdpoint::console::theme::Themes;

fn main() -> Result<(), ReplayError> {
    let ascii = std::env::args().any(|argument| argument == "--ascii");
    let console =
        Options::new(CommandLineFlags { ascii, ..CommandLineFlags::default() }, SettingsFile::default());
    let options =
        ReplayOptions { start_tick: None, speed: Speed::default(), console, themes: Themes::default() };
    run(upgrade::recording(), options)
}
