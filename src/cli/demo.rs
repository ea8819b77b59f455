//! `holdpoint demo`: arguments of the demonstration.

use clap::Args;

use super::run::{EngineArgs, LivePace, parse_pace};
use crate::error::CliError;
use holdpoint_text::ErrorReason;
use holdpoint_trials::seeds::EpisodeSeeds;

/// The seed of the demonstration.
const SEED_DEFAULT: u32 = 1;

/// The arguments of `demo`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint demo
  holdpoint demo --seed 7 --json
  holdpoint --data try-out demo")]
pub struct DemoArgs {
    /// Seed of the demonstration in its temporary store; the seeds of a store that you name are secret [default: 1].
    #[arg(long, value_name = "N")]
    pub seed: Option<u32>,
    /// The options of the engine.
    #[command(flatten)]
    pub engine: EngineArgs,
    /// Simulated seconds of the live cell in each second, or `max` [default: max].
    #[arg(long, value_name = "N|max", value_parser = parse_pace)]
    pub pace: Option<LivePace>,
}

impl DemoArgs {
    /// The seeds of the demonstration: known in its temporary store, secret in a store that the user names.
    ///
    /// # Errors
    /// If a seed is requested for a named store.
    pub fn seeds(&self, is_named_store: bool) -> Result<EpisodeSeeds, CliError> {
        match (is_named_store, self.seed) {
            (true, None) => Ok(EpisodeSeeds::Secret),
            (true, Some(seed)) => {
                let text =
                    format!("--seed {seed} is not allowed: the seeds of a store that you name are secret");
                let hint = "omit --seed, or omit --data: the demonstration then has a temporary store";
                Err(CliError::usage(text).with_hint(hint).with_details(ErrorReason::SecretSeeds))
            }
            (false, seed) => Ok(EpisodeSeeds::OfRun(u64::from(seed.unwrap_or(SEED_DEFAULT)))),
        }
    }
}
