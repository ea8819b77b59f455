//! `holdpoint serve`: its arguments.

use std::path::PathBuf;

use clap::Args;

use super::run::{EngineArgs, LINGER_SECS_MAX, LivePace, SceneArgs, parse_pace};

/// The arguments of `serve`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Args)]
#[command(after_help = "\
Exits with 0 after SIGTERM or SIGINT, and with 3 if the engine halted because of a fault of its
own. Notifies a service manager of its start, its health and its end (NOTIFY_SOCKET,
WATCHDOG_USEC).

Examples:
  holdpoint serve --data /var/lib/holdpoint --profile real
  holdpoint serve --data /var/lib/holdpoint/store --seats /run/holdpoint
  holdpoint serve --quiet --view
  holdpoint serve --json --pace 10")]
pub struct ServeArgs {
    /// The options of the engine.
    #[command(flatten)]
    pub engine: EngineArgs,
    /// Simulated seconds of the live cell in each second, or `max` [default: 1].
    #[arg(long, value_name = "N|max", value_parser = parse_pace)]
    pub pace: Option<LivePace>,
    /// Omits the sequences of the live cell, which are most events.
    #[arg(long)]
    pub quiet: bool,
    /// Ends cleanly after this many seconds without an attached console; `:detach` in a console removes the limit.
    #[arg(long, value_name = "SECS", value_parser = clap::value_parser!(u32).range(1..=LINGER_SECS_MAX))]
    pub attended: Option<u32>,
    /// Listens in this folder, too, for the accounts of its group: see the guide's page `run-as-a-service`.
    #[arg(long, value_name = "DIR")]
    pub seats: Option<PathBuf>,
    /// Leaves the terminal for a new process session, and prints only faults.
    #[arg(long, hide = true)]
    pub own_session: bool,
    /// Recordings and the live viewer.
    #[command(flatten)]
    pub scenes: SceneArgs,
}

impl ServeArgs {
    /// Simulated seconds of the live cell in each second; absent for as fast as it computes.
    #[must_use]
    pub fn pace(&self) -> Option<f64> {
        self.pace.unwrap_or(LivePace::CLOCK).times()
    }
}
