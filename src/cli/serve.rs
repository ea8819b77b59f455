//! `holdpoint serve`: arguments of the engine as a service.

use clap::Args;

use super::run::{EngineArgs, LivePace, SceneArgs, parse_pace};

/// The arguments of `serve`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Args)]
#[command(after_help = "\
Ends with 0 on SIGTERM or SIGINT, in good order, and with 3 if the engine held because of a fault of its own. Tells a
service manager when it is ready, that it is alive and that it stops (NOTIFY_SOCKET, WATCHDOG_USEC).

Examples:
  holdpoint serve --data /var/lib/holdpoint --profile real
  holdpoint serve --quiet --view
  holdpoint serve --json --pace 10")]
pub struct ServeArgs {
    /// What the engine is started with.
    #[command(flatten)]
    pub engine: EngineArgs,
    /// Simulated seconds of the live cell in a second, or `max` [default: 1].
    #[arg(long, value_name = "N|max", value_parser = parse_pace)]
    pub pace: Option<LivePace>,
    /// Does not print the sequences of the live cell, which are most of what happens.
    #[arg(long)]
    pub quiet: bool,
    /// Recordings and the live viewer.
    #[command(flatten)]
    pub scenes: SceneArgs,
}

impl ServeArgs {
    /// Simulated seconds of the live cell in a second; absent for as fast as it computes.
    #[must_use]
    pub fn pace(&self) -> Option<f64> {
        self.pace.unwrap_or(LivePace::CLOCK).times()
    }
}
