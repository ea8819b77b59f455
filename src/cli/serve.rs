//! `holdpoint serve`: arguments of the engine as a service.

use std::path::PathBuf;

use clap::Args;

use super::run::{EngineArgs, LINGER_SECS_MAX, LivePace, SceneArgs, parse_pace};

/// The arguments of `serve`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Args)]
#[command(after_help = "\
Ends with 0 on SIGTERM or SIGINT, in good order, and with 3 if the engine held because of a fault of its own. Tells a
service manager when it is ready, that it is alive and that it stops (NOTIFY_SOCKET, WATCHDOG_USEC).

Examples:
  holdpoint serve --data /var/lib/holdpoint --profile real
  holdpoint serve --data /var/lib/holdpoint/store --seats /run/holdpoint
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
    /// Ends in good order once nobody has sat at it, from a console, for so many seconds; `:detach` there lifts that.
    #[arg(long, value_name = "SECS", value_parser = clap::value_parser!(u32).range(1..=LINGER_SECS_MAX))]
    pub attended: Option<u32>,
    /// Listens in this folder as well, for the accounts of its group: see the guide's page `security`.
    #[arg(long, value_name = "DIR")]
    pub seats: Option<PathBuf>,
    /// Leaves the terminal that started it, for a session of its own, and prints faults alone.
    #[arg(long, hide = true)]
    pub own_session: bool,
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
