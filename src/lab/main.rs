//! The laboratory: parses the command line, and exits with the code of the outcome.

use std::process::ExitCode;

fn main() -> ExitCode {
    holdpoint::cli::survive_file_size_limit();
    holdpoint_lab::cli::entry(std::env::args_os()).into()
}
