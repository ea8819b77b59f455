//! `holdpoint run`: its arguments.

use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::builder::PossibleValue;
use clap::{Args, ValueEnum};

use super::data;
use super::profile_authorization;
use super::profile_choice::{RequestedProfile, RequestedProfileParser, chosen, possible_value};
use super::result_cache::CacheKeyArgs;
use super::site_choice;
use crate::cells::PACED_CELLS;
use crate::cli::context::CliContext;
use crate::error::CliError;
use crate::scenes::{self, SceneOptions};
#[cfg(feature = "console")]
use holdpoint_console::look::ColorChoice;
#[cfg(feature = "console")]
use holdpoint_console::options::CommandLineFlags;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::site_profile::ChosenProfile;
use holdpoint_protocol::command::PACE_ALLOWED;
use holdpoint_service::engine_handle::LaunchConfig;
use holdpoint_store::StoreError;
use holdpoint_trials::seeds::EpisodeSeeds;
use holdpoint_trials::site::LoadedSite;

/// The longest time an engine runs without an attached console, s: a day. `holdpoint serve` has no limit.
pub(super) const LINGER_SECS_MAX: i64 = 24 * 60 * 60;

/// The most evaluation workers.
pub const JOBS_MAX: u16 = 64;

/// The arguments of `run`. `default()` is `holdpoint` without a command on a terminal.
#[derive(Clone, Debug, Default, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint run --profile real
  holdpoint run --profile human --as mara --pace 4
  holdpoint run --view
  holdpoint run --plain --jobs 2")]
pub struct RunArgs {
    /// Runs a scenario, as `scenario run` does; for scripts of earlier versions.
    #[arg(long, hide = true, requires = "script", conflicts_with = "profile")]
    pub headless: bool,
    /// The scenario file; needs --headless. Its store is temporary, unless --data names one.
    #[arg(long, hide = true, value_name = "FILE", requires = "headless")]
    pub script: Option<PathBuf>,
    /// The script's seed; the seeds of every other engine are secret.
    #[arg(long, hide = true, value_name = "N", requires = "script")]
    pub seed: Option<u32>,
    /// Prints one event a line instead of the screen, until every waiting version is settled; also the default
    /// without a terminal. With this option the verb reads commands on its input, a verb a line; on a terminal it
    /// runs until `quit`.
    #[arg(long, conflicts_with = "headless")]
    pub plain: bool,
    /// The options of the engine.
    #[command(flatten)]
    pub engine: EngineArgs,
    /// A folder of cached episodes that runs share; needs --headless.
    #[arg(long, hide = true, value_name = "DIR", requires = "headless")]
    pub cache: Option<PathBuf>,
    /// The key of the folder.
    #[command(flatten)]
    pub cache_key: CacheKeyArgs,
    /// Simulated seconds of the live cell in each second, or `max` [default: 1 in the console, max without it].
    #[arg(long, value_name = "N|max", value_parser = parse_pace, conflicts_with = "headless")]
    pub pace: Option<LivePace>,
    /// Runs the engine inside the console's process: it ends with this console, even if other consoles are
    /// attached.
    #[cfg(feature = "console")]
    #[arg(long, conflicts_with_all = ["headless", "plain"])]
    pub in_process: bool,
    /// Seconds that an engine started by this console keeps running without an attached console before it ends
    /// cleanly [default: 60].
    #[cfg(feature = "console")]
    #[arg(long, value_name = "SECS", value_parser = clap::value_parser!(u32).range(1..=LINGER_SECS_MAX),
        conflicts_with_all = ["headless", "plain", "in_process"])]
    pub linger: Option<u32>,
    /// Recordings and the live viewer.
    #[command(flatten)]
    pub scenes: SceneArgs,
    /// The look of the console and its operator.
    #[cfg(feature = "console")]
    #[command(flatten)]
    pub console: ConsoleArgs,
}

#[cfg(feature = "console")]
impl RunArgs {
    /// The given arguments that apply only at the start of an engine.
    #[must_use]
    pub fn start_options(&self) -> Vec<&'static str> {
        let options = [
            ("--profile", self.engine.profile.is_some()),
            ("--robot", self.engine.robot.is_some()),
            ("--site", self.engine.site.is_some()),
            ("--jobs", self.engine.jobs.is_some()),
            ("--pace", self.pace.is_some()),
            ("--view", self.scenes.view.is_some()),
            ("--no-recording", self.scenes.no_recording),
            ("--in-process", self.in_process),
            ("--linger", self.linger.is_some()),
        ];
        options.into_iter().filter_map(|(name, is_given)| is_given.then_some(name)).collect()
    }
}

/// The options of an engine, for every front end.
#[derive(Clone, Debug, Default, PartialEq, Eq, Args)]
pub struct EngineArgs {
    /// The deployment profile: a built-in one, the name of one in the store's folder `profiles`, or a file
    /// [default: that of --site, else the one the store was last used with, else sim].
    #[arg(long, value_name = "NAME|FILE", value_parser = RequestedProfileParser, hide_possible_values = true)]
    pub profile: Option<RequestedProfile>,
    /// The robot: a URDF file [default: that of the site].
    #[arg(long, value_name = "FILE")]
    pub robot: Option<PathBuf>,
    /// The site file: robot, cells, families and profile [default: the one the store was last used with, else the
    /// built-in site].
    #[arg(long, value_name = "FILE")]
    pub site: Option<PathBuf>,
    /// Episodes evaluated at once [default: one per core]; the log is the same for any number.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=i64::from(JOBS_MAX)))]
    pub jobs: Option<u16>,
}

/// The default address for viewers: the viewer's own default.
pub const VIEW_DEFAULT: &str = "127.0.0.1:9876";

/// Recording and display of the live cell.
#[derive(Clone, Debug, Default, PartialEq, Eq, Args)]
#[command(next_help_heading = "Scenes")]
pub struct SceneArgs {
    /// Serves the live scene to rerun viewers at this address; without a value only to this machine [default
    /// without a value: 127.0.0.1:9876].
    #[arg(long, value_name = "ADDR", num_args = 0..=1, default_missing_value = VIEW_DEFAULT)]
    pub view: Option<SocketAddr>,
    /// Keeps no recordings; a script with a temporary store keeps none anyway.
    #[arg(long)]
    pub no_recording: bool,
}

impl SceneArgs {
    /// The scenes to produce, for a permanent or a temporary store.
    #[must_use]
    pub const fn options(&self, store_stays: bool) -> SceneOptions {
        SceneOptions { record: scenes::BUILT_IN && store_stays && !self.no_recording, view: self.view }
    }
}

#[cfg(feature = "console")]
/// The console's options; they override its settings file.
#[derive(Clone, Debug, Default, PartialEq, Eq, Args)]
#[command(next_help_heading = "Console")]
pub struct ConsoleArgs {
    /// Refuses all changes but a stop; starts no engine and ends none. Without an engine it waits for one.
    #[arg(long)]
    pub read_only: bool,
    /// The name of the operator's identity.
    #[arg(long = "as", value_name = "NAME", value_parser = super::decide::parse_identity)]
    pub operator: Option<String>,
    /// The theme [default: by the terminal's background].
    #[arg(long, value_name = "NAME")]
    pub theme: Option<String>,
    /// Whether to use colors; overrides `NO_COLOR`.
    #[arg(long, value_enum, value_name = "WHEN")]
    pub color: Option<ColorArg>,
    /// Draws with ASCII only.
    #[arg(long)]
    pub ascii: bool,
    /// Uses the mouse for scrolling; the terminal's own selection is then off.
    #[arg(long)]
    pub mouse: bool,
    /// Starts without the tour.
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
/// When to use colors, on the command line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ColorArg {
    /// As `NO_COLOR` and the terminal indicate.
    Auto,
    /// Always colors.
    Always,
    /// No colors.
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

/// The speed of the live cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum LivePace {
    /// Simulated seconds in each second.
    Times(f64),
    /// As fast as it computes.
    Max,
}

// A pace is never NaN.
impl Eq for LivePace {}

impl LivePace {
    /// The clock's default pace: people can follow it.
    pub const CLOCK: Self = Self::Times(1.0);

    /// Simulated seconds in each second; absent for as fast as it computes.
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

/// Episodes evaluated at once: the requested number, else one per core.
#[must_use]
pub fn jobs(requested: Option<u16>) -> usize {
    let cores = || std::thread::available_parallelism().map_or(1, usize::from);
    requested.map_or_else(cores, usize::from).clamp(1, usize::from(JOBS_MAX))
}

impl EngineArgs {
    /// Episodes evaluated at once: the requested number, else one per core.
    #[must_use]
    pub fn jobs(&self) -> usize {
        jobs(self.jobs)
    }

    /// Workers beside a front end with its own thread: the requested number, else 0, which leaves it a core.
    #[must_use]
    pub fn spare_jobs(&self) -> usize {
        self.jobs.map_or(0, usize::from)
    }

    /// The settings of an engine on the store of a context. Other accounts have no access, and it has no limit without a console.
    ///
    /// # Errors
    /// As [`Self::site`] and [`Self::profile`]; if a listener cannot be made.
    pub fn launch(
        &self,
        context: &CliContext,
        pace: Option<f64>,
        scenes: &SceneArgs,
    ) -> Result<LaunchConfig, CliError> {
        let site = self.site(Some(&context.data))?;
        Ok(LaunchConfig {
            data: context.data.clone(),
            profile: self.profile(&context.data, site.as_ref())?,
            seeds: EpisodeSeeds::Secret,
            jobs: self.spare_jobs(),
            cells: Arc::new(PACED_CELLS),
            robot: self.robot.clone(),
            site,
            pace,
            sinks: scenes.options(true).sinks()?,
            alone_max: None,
            console_access: None,
        })
    }

    /// The site file of a run on the store in this folder, or on a temporary one; `None` for the built-in site.
    ///
    /// # Errors
    /// If the file cannot be used.
    pub fn site(&self, data: Option<&Path>) -> Result<Option<Arc<LoadedSite>>, CliError> {
        match site_choice::named(self.site.as_deref())? {
            Some(site) => Ok(Some(site)),
            None => data.map_or(Ok(None), site_choice::last),
        }
    }

    /// The profile of a run without a scenario, on the store in this folder.
    ///
    /// # Errors
    /// If there is no such profile, its files are invalid, or it needs an administrator's authorization that is
    /// missing. Checked before the terminal, a process or the store is touched.
    pub fn profile(&self, data: &Path, site: Option<&Arc<LoadedSite>>) -> Result<ChosenProfile, CliError> {
        data::require_own(data)?;
        // A site that the store only remembers changes no profile.
        let of_site = site.filter(|_| self.site.is_some()).map(|site| site_choice::profile(site));
        let chosen = chosen(data, self.profile.as_ref().or(of_site.as_ref()))?;
        // The engine that starts on it reports unreadable files.
        match profile_authorization::may_begin(data, &chosen) {
            Err(StoreError::UnauthorizedProfile { named, problem }) => {
                let hint = profile_authorization::allow_hint(data, &named);
                let error = StoreError::UnauthorizedProfile { named, problem };
                Err(CliError::from_engine_fault(error).with_hint(hint))
            }
            Ok(_) | Err(_) => Ok(chosen),
        }
    }
}

/// The name of a built-in profile, on the command line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ProfileArg(ProfileName);

impl ProfileArg {
    const ALL: [Self; ProfileName::ALL.len()] = {
        let mut all = [Self(ProfileName::ALL[0]); ProfileName::ALL.len()];
        let mut at = 0;
        while at < all.len() {
            all[at] = Self(ProfileName::ALL[at]);
            at += 1;
        }
        all
    };
}

impl ValueEnum for ProfileArg {
    fn value_variants<'a>() -> &'a [Self] {
        &Self::ALL
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(possible_value(self.0))
    }
}

impl From<ProfileArg> for ProfileName {
    fn from(argument: ProfileArg) -> Self {
        argument.0
    }
}
