//! `holdpoint scenario run`: a scripted upgrade without a screen, on a virtual clock.

use std::path::PathBuf;

use clap::{Args, Subcommand};

use super::result_cache::CacheKeyArgs;
use super::run::{EngineArgs, RunArgs, SceneArgs};

/// The arguments of `scenario`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Example:
  holdpoint scenario run tests/scenarios/promote-benign.toml --json")]
pub struct ScenarioArgs {
    /// The verb with its arguments.
    #[command(subcommand)]
    pub verb: ScenarioVerb,
}

/// The verbs of `scenario`.
#[derive(Clone, Debug, PartialEq, Eq, Subcommand)]
pub enum ScenarioVerb {
    /// Run a scenario; the exit code says how its last version ended.
    Run(ScenarioRunArgs),
}

/// The arguments of `scenario run`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Equal scenarios with equal seeds give equal logs. The exit code says how the version ended: see
`holdpoint help exit-codes`.

Examples:
  holdpoint scenario run tests/scenarios/promote-benign.toml
  holdpoint scenario run tests/scenarios/reject-low-flight.toml --seed 7 --json --data try-out")]
pub struct ScenarioRunArgs {
    /// The scenario file; it names the profile. Its store is temporary, unless --data names one.
    #[arg(value_name = "FILE")]
    pub file: PathBuf,
    /// Seed; the same scenario and the same seed give the same log [default: the scenario's, else 1].
    #[arg(long, value_name = "N")]
    pub seed: Option<u32>,
    /// The options of the engine; the scenario has its own profile.
    #[command(flatten)]
    pub engine: EngineArgs,
    /// A folder of cached episodes that runs share.
    #[arg(long, value_name = "DIR")]
    pub cache: Option<PathBuf>,
    /// The key of the folder.
    #[command(flatten)]
    pub cache_key: CacheKeyArgs,
    /// Recordings and the live viewer.
    #[command(flatten)]
    pub scenes: SceneArgs,
}

impl From<ScenarioRunArgs> for RunArgs {
    fn from(args: ScenarioRunArgs) -> Self {
        Self {
            headless: true,
            script: Some(args.file),
            seed: args.seed,
            engine: args.engine,
            cache: args.cache,
            cache_key: args.cache_key,
            scenes: args.scenes,
            ..Self::default()
        }
    }
}
