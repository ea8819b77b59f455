//! `holdpoint run`: arguments of the main job.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use crate::governance::profile::ProfileName;

/// The most evaluation workers.
pub const JOBS_MAX: u16 = 64;

/// The arguments of `run`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint run --profile real
  holdpoint run --headless --script tests/scenarios/promote.toml --json
  holdpoint run --plain --seed 7 --jobs 2")]
pub struct RunArgs {
    /// Runs without a screen on a virtual clock.
    #[arg(long)]
    pub headless: bool,
    /// What is to happen, as a scenario file; needs --headless.
    #[arg(long, value_name = "FILE", requires = "headless")]
    pub script: Option<PathBuf>,
    /// Prints one event a line in place of the screen; also chosen where there is no terminal.
    #[arg(long, conflicts_with = "headless")]
    pub plain: bool,
    /// Same script and same seed give the same log.
    #[arg(long, value_name = "N", default_value_t = 0)]
    pub seed: u64,
    /// The deployment profile.
    #[arg(long, value_enum, default_value_t = ProfileArg::Sim)]
    pub profile: ProfileArg,
    /// The robot: a URDF file [default: the built-in arm].
    #[arg(long, value_name = "FILE")]
    pub robot: Option<PathBuf>,
    /// How many episodes to evaluate at once [default: one per core]; the log is the same for any number.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=i64::from(JOBS_MAX)))]
    pub jobs: Option<u16>,
}

impl Default for RunArgs {
    /// The main demonstration job: what `holdpoint` without a command runs.
    fn default() -> Self {
        Self {
            headless: false,
            script: None,
            plain: false,
            seed: 0,
            profile: ProfileArg::Sim,
            robot: None,
            jobs: None,
        }
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
