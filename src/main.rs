//! The program: what was asked for, and how it ended.

use std::process::ExitCode;

use holdpoint::cli::{RealEngine, entry};

fn main() -> ExitCode {
    entry(std::env::args_os(), &mut RealEngine).into()
}
