//! The program: parses the command line, and exits with the code of the outcome.

use std::process::ExitCode;

use holdpoint::cli::{RealEngine, entry};

fn main() -> ExitCode {
    entry(std::env::args_os(), &mut RealEngine).into()
}
