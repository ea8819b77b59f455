//! `holdpoint run`: arguments of the main job.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};

use super::chosen::{AskedProfile, AskedProfileParser, chosen};
use super::data;
use super::kept::CacheKeyArgs;
use super::profile_on_record;
use crate::error::CliError;
use crate::scenes::{self, SceneOptions};
#[cfg(feature = "console")]
use holdpoint_console::look::ColorChoice;
#[cfg(feature = "console")]
use holdpoint_console::options::CommandLineFlags;
use holdpoint_engine::bound;
use holdpoint_governance::own_profile::ChosenProfile;
use holdpoint_governance::profile::ProfileName;
use holdpoint_protocol::command::PACE_ALLOWED;
use holdpoint_registry::StoreError;

/// The seed of a run that names none.
const SEED_DEFAULT: u64 = 1;

/// The longest time an engine goes on with nobody, s: a day. One that is to go on for ever is `holdpoint serve`.
pub(super) const LINGER_SECS_MAX: i64 = 24 * 60 * 60;

/// The most evaluation workers.
pub const JOBS_MAX: u16 = 64;

/// The arguments of `run`. `default()` is what `holdpoint` without a command runs on a terminal.
#[derive(Clone, Debug, Default, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint run --profile real
  holdpoint run --profile human --as mara --pace 4
  holdpoint run --view
  holdpoint run --headless --script tests/scenarios/promote-benign.toml --json
  holdpoint run --plain --seed 7 --jobs 2")]
pub struct RunArgs {
    /// Runs a scenario without a screen on a virtual clock; the scenario names the profile.
    #[arg(long, requires = "script", conflicts_with = "profile")]
    pub headless: bool,
    /// What is to happen, as a scenario file; needs --headless. Its store is a fresh one that is removed
    /// afterwards, unless --data names one.
    #[arg(long, value_name = "FILE", requires = "headless")]
    pub script: Option<PathBuf>,
    /// Prints one event a line in place of the screen, until every version that waits is settled; also chosen if
    /// there is no terminal. Asked for by name it takes commands on its input, a verb a line; on a terminal it stays
    /// until `quit`.
    #[arg(long, conflicts_with = "headless")]
    pub plain: bool,
    /// What the engine is started with.
    #[command(flatten)]
    pub engine: EngineArgs,
    /// A folder of episodes already simulated, for runs to share; needs --headless.
    #[arg(long, value_name = "DIR", requires = "headless")]
    pub cache: Option<PathBuf>,
    /// Whose folder it is.
    #[command(flatten)]
    pub cache_key: CacheKeyArgs,
    /// Simulated seconds of the live cell in a second, or `max` [default: 1 in the console, max without it].
    #[arg(long, value_name = "N|max", value_parser = parse_pace, conflicts_with = "headless")]
    pub pace: Option<LivePace>,
    /// Recordings and the live viewer.
    #[command(flatten)]
    pub scenes: SceneArgs,
    /// Has the console's engine in the console's own process: it ends with the console, whoever else sits at it.
    #[cfg(feature = "console")]
    #[arg(long, conflicts_with_all = ["headless", "plain"])]
    pub in_process: bool,
    /// For how many seconds an engine that this console starts goes on with nobody at it, before it ends in good order
    /// [default: 60].
    #[cfg(feature = "console")]
    #[arg(long, value_name = "SECS", value_parser = clap::value_parser!(u32).range(1..=LINGER_SECS_MAX),
        conflicts_with_all = ["headless", "plain", "in_process"])]
    pub linger: Option<u32>,
    /// How the console looks and who sits at it.
    #[cfg(feature = "console")]
    #[command(flatten)]
    pub console: ConsoleArgs,
}

#[cfg(feature = "console")]
impl RunArgs {
    /// The arguments given that mean something at the start of an engine alone.
    #[must_use]
    pub fn for_a_start(&self) -> Vec<&'static str> {
        let given = [
            ("--profile", self.engine.profile.is_some()),
            ("--seed", self.engine.seed.is_some()),
            ("--robot", self.engine.robot.is_some()),
            ("--jobs", self.engine.jobs.is_some()),
            ("--pace", self.pace.is_some()),
            ("--view", self.scenes.view.is_some()),
            ("--no-recording", self.scenes.no_recording),
            ("--in-process", self.in_process),
            ("--linger", self.linger.is_some()),
        ];
        given.into_iter().filter_map(|(name, is_given)| is_given.then_some(name)).collect()
    }
}

/// What an engine is started with, whoever its front end is.
#[derive(Clone, Debug, Default, PartialEq, Eq, Args)]
pub struct EngineArgs {
    /// Same script and same seed give the same log [default: the scenario's, else 1]; a store keeps the one it was begun with.
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// The deployment profile: one that comes with the program, the name of one in the store's folder `profiles`, or
    /// a file [default: the one the store was last used with, else sim].
    #[arg(long, value_name = "NAME|FILE", value_parser = AskedProfileParser, hide_possible_values = true)]
    pub profile: Option<AskedProfile>,
    /// The robot: a URDF file [default: the built-in arm].
    #[arg(long, value_name = "FILE")]
    pub robot: Option<PathBuf>,
    /// How many episodes to evaluate at once [default: one per core]; the log is the same for any number.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=i64::from(JOBS_MAX)))]
    pub jobs: Option<u16>,
}

/// The address at which a viewer may connect, if none is named: the viewer's own default.
pub const VIEW_DEFAULT: &str = "127.0.0.1:9876";

/// What is kept and shown of the live cell.
#[derive(Clone, Debug, Default, PartialEq, Eq, Args)]
#[command(next_help_heading = "Scenes")]
pub struct SceneArgs {
    /// Serves the live scene to rerun viewers at this address, of this machine only unless another is named
    /// [default without a value: 127.0.0.1:9876].
    #[arg(long, value_name = "ADDR", num_args = 0..=1, default_missing_value = VIEW_DEFAULT)]
    pub view: Option<SocketAddr>,
    /// Keeps no recordings; a script whose store is removed afterwards keeps none anyway.
    #[arg(long)]
    pub no_recording: bool,
}

impl SceneArgs {
    /// What is wanted, for a store that stays or one that does not.
    #[must_use]
    pub const fn options(&self, store_stays: bool) -> SceneOptions {
        SceneOptions { record: scenes::BUILT_IN && store_stays && !self.no_recording, view: self.view }
    }
}

#[cfg(feature = "console")]
/// The console's own arguments; they win over its settings file.
#[derive(Clone, Debug, Default, PartialEq, Eq, Args)]
#[command(next_help_heading = "Console")]
pub struct ConsoleArgs {
    /// Refuses everything that would change something.
    #[arg(long)]
    pub read_only: bool,
    /// Who sits here: the name of an identity.
    #[arg(long = "as", value_name = "NAME", value_parser = super::decide::parse_identity)]
    pub operator: Option<String>,
    /// The theme [default: by the terminal's background].
    #[arg(long, value_name = "NAME")]
    pub theme: Option<String>,
    /// Whether colours are used; wins over `NO_COLOR`.
    #[arg(long, value_enum, value_name = "WHEN")]
    pub color: Option<ColorArg>,
    /// Draws with ASCII alone.
    #[arg(long)]
    pub ascii: bool,
    /// Takes the mouse for scrolling; the terminal's own selection is off then.
    #[arg(long)]
    pub mouse: bool,
    /// Begins without the tour.
    #[arg(long)]
    pub no_tour: bool,
}

#[cfg(feature = "console")]
impl ConsoleArgs {
    /// As the console's flags.
    #[must_use]
    pub fn flags(&self) -> CommandLineFlags {
        CommandLineFlags {
            read_only: self.read_only,
            operator: self.operator.clone(),
            theme: self.theme.clone(),
            color: self.color.map(Into::into),
            ascii: self.ascii,
            mouse: self.mouse,
            no_tour: self.no_tour,
        }
    }
}

#[cfg(feature = "console")]
/// When colours are used, on the command line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ColorArg {
    /// As `NO_COLOR` and the terminal say.
    Auto,
    /// Colours, whatever the terminal says.
    Always,
    /// No colours at all.
    Never,
}

#[cfg(feature = "console")]
impl From<ColorArg> for ColorChoice {
    fn from(argument: ColorArg) -> Self {
        match argument {
            ColorArg::Auto => Self::Auto,
            ColorArg::Always => Self::Always,
            ColorArg::Never => Self::Never,
        }
    }
}

/// How fast the live cell works.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LivePace {
    /// Simulated seconds in a second.
    Times(f64),
    /// As fast as it computes.
    Max,
}

// A pace is never a number that is none.
impl Eq for LivePace {}

impl LivePace {
    /// The pace of the clock: people can follow it.
    pub const CLOCK: Self = Self::Times(1.0);

    /// Simulated seconds in a second; absent for as fast as it computes.
    #[must_use]
    pub const fn times(self) -> Option<f64> {
        match self {
            Self::Times(times) => Some(times),
            Self::Max => None,
        }
    }
}

pub(super) fn parse_pace(text: &str) -> Result<LivePace, String> {
    if text == "max" {
        return Ok(LivePace::Max);
    }
    let times = text.parse::<f64>().ok().filter(|times| PACE_ALLOWED.contains(times));
    let allowed =
        || format!("a number from {} to {}, or max, is allowed", PACE_ALLOWED.start(), PACE_ALLOWED.end());
    times.map(LivePace::Times).ok_or_else(allowed)
}

/// How many episodes to evaluate at once: what was asked for, else one per core.
#[must_use]
pub fn jobs(asked: Option<u16>) -> usize {
    let cores = || std::thread::available_parallelism().map_or(1, usize::from);
    asked.map_or_else(cores, usize::from).clamp(1, usize::from(JOBS_MAX))
}

impl EngineArgs {
    /// How many episodes to evaluate at once: what was asked for, else one per core.
    #[must_use]
    pub fn jobs(&self) -> usize {
        jobs(self.jobs)
    }

    /// Workers beside a front end on a thread of its own: what was asked for, else 0, which leaves it a core.
    #[must_use]
    pub fn spare_jobs(&self) -> usize {
        self.jobs.map_or(0, usize::from)
    }

    /// The seed of an engine's life on the store in this folder: the one it was begun with.
    ///
    /// # Errors
    /// If another one is asked for.
    pub fn seed(&self, data: &Path) -> Result<u64, CliError> {
        let Ok(views) = data::open(data) else { return Ok(self.seed.unwrap_or(SEED_DEFAULT)) };
        let recorded = bound::seed(&views).map_err(CliError::usage)?;
        let was_used = views.profiles().map_err(CliError::usage)?.was_used();
        match (self.seed, recorded) {
            (Some(asked), recorded) if was_used && recorded != Some(asked) => {
                let allowed = recorded.map_or_else(|| SEED_DEFAULT.to_string(), |seed| seed.to_string());
                let text =
                    format!("--seed {asked} is not allowed: the store has a history with the seed {allowed}");
                Err(CliError::usage(text).with_hint(
                    "start without --seed, or choose another store with --data; a script may name any",
                ))
            }
            (asked, recorded) => Ok(recorded.or(asked).unwrap_or(SEED_DEFAULT)),
        }
    }

    /// The profile of a run without a scenario, on the store in this folder.
    ///
    /// # Errors
    /// If there is none of that name, or what is in its files cannot be meant, or if it takes an administrator's authorization that
    /// nobody gave: before the terminal, a process or the store is touched.
    pub fn profile(&self, data: &Path) -> Result<ChosenProfile, CliError> {
        let chosen = chosen(data, self.profile.as_ref())?;
        // What cannot be read the engine tells that starts on it.
        match profile_on_record::may_begin(data, &chosen) {
            Err(error @ StoreError::UnauthorizedProfile { .. }) => Err(CliError::held(error)),
            Ok(_) | Err(_) => Ok(chosen),
        }
    }
}

/// The name of a profile that comes with the program, on the command line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ProfileArg {
    /// Simulation only: nobody is asked.
    Sim,
    /// A real cell, no people inside.
    Real,
    /// People work beside the robot: the tightest limits.
    Human,
}

impl From<ProfileArg> for ProfileName {
    fn from(argument: ProfileArg) -> Self {
        match argument {
            ProfileArg::Sim => Self::Sim,
            ProfileArg::Real => Self::Real,
            ProfileArg::Human => Self::Human,
        }
    }
}
