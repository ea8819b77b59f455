//! The program: parses the command line, and exits with the code of the outcome.

use std::process::ExitCode;

use holdpoint::cli::{RealEngine, entry, survive_file_size_limit};

fn main() -> ExitCode {
    survive_file_size_limit();
    entry(std::env::args_os(), &mut RealEngine).into()
}
