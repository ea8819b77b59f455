//! `holdpoint run`: arguments of the main job.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use crate::governance::profile::ProfileName;

/// The most evaluation workers.
pub const JOBS_MAX: u16 = 64;

/// The arguments of `run`.
/// `default()` is the main demonstration job: what `holdpoint` without a command runs.
#[derive(Clone, Debug, Default, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint run --profile real
  holdpoint run --headless --script tests/scenarios/promote.toml --json
  holdpoint run --plain --seed 7 --jobs 2")]
pub struct RunArgs {
    /// Runs a scenario without a screen on a virtual clock; the scenario names the profile.
    #[arg(long, requires = "script", conflicts_with = "profile")]
    pub headless: bool,
    /// What is to happen, as a scenario file; needs --headless. Its store is a fresh one that is removed
    /// afterwards, unless --data names one.
    #[arg(long, value_name = "FILE", requires = "headless")]
    pub script: Option<PathBuf>,
    /// Prints one event a line in place of the screen; also chosen where there is no terminal.
    #[arg(long, conflicts_with = "headless")]
    pub plain: bool,
    /// Same script and same seed give the same log [default: the scenario's, else 1].
    #[arg(long, value_name = "N")]
    pub seed: Option<u64>,
    /// The deployment profile [default: sim].
    #[arg(long, value_enum)]
    pub profile: Option<ProfileArg>,
    /// The robot: a URDF file [default: the built-in arm].
    #[arg(long, value_name = "FILE")]
    pub robot: Option<PathBuf>,
    /// How many episodes to evaluate at once [default: one per core]; the log is the same for any number.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=i64::from(JOBS_MAX)))]
    pub jobs: Option<u16>,
    /// A folder of episodes already simulated, for runs to share; needs --headless.
    #[arg(long, value_name = "DIR", requires = "headless")]
    pub cache: Option<PathBuf>,
}

impl RunArgs {
    /// How many episodes to evaluate at once: what was asked for, else one per core.
    #[must_use]
    pub fn jobs(&self) -> usize {
        let cores = || std::thread::available_parallelism().map_or(1, usize::from);
        self.jobs.map_or_else(cores, usize::from).clamp(1, usize::from(JOBS_MAX))
    }

    /// The profile of a run without a scenario.
    #[must_use]
    pub fn profile(&self) -> ProfileName {
        self.profile.unwrap_or(ProfileArg::Sim).into()
    }
}

/// A profile's name on the command line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum ProfileArg {
    /// Simulation only.
    Sim,
    /// A real cell, no people inside.
    Real,
    /// People nearby.
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
