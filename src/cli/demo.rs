//! `holdpoint demo`: arguments of the demonstration.

use clap::Args;

use super::run::{EngineArgs, LivePace, parse_pace};

/// The arguments of `demo`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint demo
  holdpoint demo --seed 7 --json
  holdpoint --data try-out demo")]
pub struct DemoArgs {
    /// The options of the engine.
    #[command(flatten)]
    pub engine: EngineArgs,
    /// Simulated seconds of the live cell in each second, or `max` [default: max].
    #[arg(long, value_name = "N|max", value_parser = parse_pace)]
    pub pace: Option<LivePace>,
}
