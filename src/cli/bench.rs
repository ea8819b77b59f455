//! `holdpoint bench`: arguments.

use clap::Args;

/// The arguments of `bench`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint bench
  holdpoint bench --quick --json")]
pub struct BenchArgs {
    /// Fewer repetitions; the numbers are then rougher.
    #[arg(long)]
    pub quick: bool,
}
