//! `holdpoint skill new | build | test | run`: makes a candidate of custom code.
//!
//! Parses arguments and prints; [`holdpoint_builder`] writes folders and builds, `trial.rs` runs episodes.
//! Registers and decides nothing.

mod measured_skill;
mod trial;

use std::path::{Path, PathBuf};

use clap::{Args, Subcommand, ValueEnum};
use holdpoint_builder::{CrateName, Lang, ScaffoldError};
use serde_json::json;

use crate::cli::context::CliContext;
use crate::cli::output::CommandOutput;
use crate::error::{CliError, Exit};
use holdpoint_governance::manifest::BundleSource;
use holdpoint_runtime::capability::shown;
use holdpoint_text::{ErrorDetails, ErrorReason};
use holdpoint_wording::program::skill as sentences;

/// The arguments of `skill`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
From an empty folder to a registered candidate:
  holdpoint skill new my-grasp --lang rust
  holdpoint skill build my-grasp
  holdpoint skill test my-grasp
  holdpoint candidate check my-grasp
  holdpoint candidate register my-grasp")]
pub struct SkillArgs {
    /// The verb with its arguments.
    #[command(subcommand)]
    pub verb: SkillVerb,
}

/// The verbs of `skill`.
#[derive(Clone, Debug, PartialEq, Eq, Subcommand)]
pub enum SkillVerb {
    /// Creates a folder with a working grasp and all its sources.
    New(NewArgs),
    /// Builds a folder to a component, beside its manifest.
    Build(BuildArgs),
    /// Runs ten episodes in a trial cell; reports whether the code keeps its contract, and its cost.
    Test(TestArgs),
    /// Runs one episode in a trial cell, beside the baseline of the family.
    Run(SkillRunArgs),
}

/// The arguments of `skill new`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint skill new my-grasp --lang rust
  holdpoint skill new my-grasp --lang c skills/my-grasp")]
pub struct NewArgs {
    /// The component's name: lower-case letters, digits and hyphens.
    #[arg(value_name = "NAME")]
    pub name: CrateName,
    /// The language of its source.
    #[arg(long, value_enum)]
    pub lang: LangArg,
    /// The folder [default: the name].
    #[arg(value_name = "DIR")]
    pub folder: Option<PathBuf>,
}

/// A language on the command line.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum LangArg {
    /// With cargo, for wasm32-unknown-unknown.
    Rust,
    /// With clang and lld.
    C,
}

impl From<LangArg> for Lang {
    fn from(argument: LangArg) -> Self {
        match argument {
            LangArg::Rust => Self::Rust,
            LangArg::C => Self::C,
        }
    }
}

/// The arguments of `skill build`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint skill build my-grasp
  holdpoint skill build my-grasp --target wasm32-wasip2")]
pub struct BuildArgs {
    /// The skill's folder.
    #[arg(value_name = "DIR", default_value = ".")]
    pub folder: PathBuf,
    /// The Rust target. A WASI target adds imports, which the manifest must list.
    #[arg(long, value_name = "TARGET", default_value = holdpoint_builder::target::RUST)]
    pub target: String,
}

/// The arguments of `skill test`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Exits with 1 if the code does not keep its contract: the rules do not admit
the manifest, the code fails, or the same seed gives other commands. Sandbox
and shadow measure its performance.

Examples:
  holdpoint skill test my-grasp
  holdpoint skill test my-grasp --seed 100 --json")]
pub struct TestArgs {
    /// The folder of the skill or of any candidate.
    #[arg(value_name = "DIR", default_value = ".")]
    pub folder: PathBuf,
    /// Seed of the first episode; the others follow.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// The site file whose robot, families and baselines the episodes use [default: the built-in site].
    #[arg(long, value_name = "FILE")]
    pub site: Option<PathBuf>,
}

/// The arguments of `skill run`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint skill run my-grasp --terminal
  holdpoint skill run my-grasp --seed 7")]
pub struct SkillRunArgs {
    /// The folder of the skill or of any candidate.
    #[arg(value_name = "DIR", default_value = ".")]
    pub folder: PathBuf,
    /// Seed of the episode.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// The site file whose robot, families and baselines the episode uses [default: the built-in site].
    #[arg(long, value_name = "FILE")]
    pub site: Option<PathBuf>,
    /// Draws it in this terminal; without a terminal, prints two moments a second.
    #[cfg(feature = "console")]
    #[arg(long)]
    pub terminal: bool,
}

/// Runs the verb.
///
/// # Errors
/// [`CliError`].
pub fn run(context: &CliContext, args: &SkillArgs, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    match &args.verb {
        SkillVerb::New(args) => new(args, out),
        SkillVerb::Build(args) => build(args, out),
        SkillVerb::Test(args) => trial::test(args, out),
        SkillVerb::Run(args) => trial::run(context, args, out),
    }
}

fn new(args: &NewArgs, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    let folder = args.folder.clone().unwrap_or_else(|| args.name.to_string().into());
    holdpoint_builder::scaffold(&folder, &args.name, args.lang.into()).map_err(|error| {
        let details = match &error {
            ScaffoldError::NotEmpty(path) => ErrorDetails::of_path(ErrorReason::Exists, path),
            ScaffoldError::Write { path, .. } => ErrorDetails::of_path(ErrorReason::CannotWrite, path),
        };
        CliError::usage(error.to_string()).with_details(details)
    })?;
    let there = shown(&folder);
    out.answer(&json!({ "folder": there }), |out| {
        sentences::wrote_skill(&there).iter().try_for_each(|line| out.line(line))
    })?;
    Ok(Exit::Confirmed)
}

fn build(args: &BuildArgs, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    let component = component(&args.folder)?;
    let built = holdpoint_builder::build(&args.folder, &component, &args.target).map_err(CliError::usage)?;
    let there = shown(&built.path);
    out.answer(&json!({ "component": there, "bytes": built.bytes }), |out| {
        let lines = sentences::built(&there, built.bytes, &shown(&args.folder));
        lines.iter().try_for_each(|line| out.line(line))
    })?;
    Ok(Exit::Confirmed)
}

/// The component file that a folder's manifest names; it may be missing.
fn component(folder: &Path) -> Result<PathBuf, CliError> {
    let manifest = folder.join("manifest.toml");
    let name = shown(&manifest);
    let text = std::fs::read_to_string(&manifest)
        .map_err(|error| CliError::usage(format!("cannot read {name}: {error}")).with_bad_file(&manifest))?;
    let parsed = holdpoint_governance::manifest::Manifest::parse(&name, &text).map_err(CliError::usage)?;
    match parsed.deployment.bundle {
        BundleSource::Wasm(file) => Ok(file.as_str().into()),
        BundleSource::Native(controller) => Err(CliError::usage(format!(
            "{name}: the bundle is native:{controller}, which is built into the program"
        ))
        .with_hint("a component's bundle is a file, e.g. bundle = \"my-grasp.wasm\"")
        .with_details(ErrorDetails::of_field(name, "deployment.bundle"))),
    }
}

#[cfg(test)]
mod tests;
