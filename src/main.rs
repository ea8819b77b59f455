//! The program: parses the command line, and exits with the code of the outcome.

use std::process::ExitCode;

use holdpoint::cli::{RealEngine, entry};
use rustix::process::Signal;
use tokio::signal::unix::{SignalKind, signal};

fn main() -> ExitCode {
    survive_file_size_limit();
    entry(std::env::args_os(), &mut RealEngine).into()
}

/// A write beyond the limit of a file's size fails with an error; without a handler, its signal ends the process.
fn survive_file_size_limit() {
    let Ok(runtime) = tokio::runtime::Builder::new_current_thread().enable_io().build() else { return };
    let _inside = runtime.enter();
    // The handler stays until the process ends. Without it, the program works as before.
    drop(signal(SignalKind::from_raw(Signal::XFSZ.as_raw())));
}
