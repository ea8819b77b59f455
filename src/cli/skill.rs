//! `holdpoint skill new | build | test | run`: from nothing to a candidate of one's own code.
//!
//! Parses arguments and prints; [`holdpoint_builder`] writes folders and builds, `trial.rs` works episodes. Registers and decides
//! nothing.

mod measured;
mod trial;

use std::path::{Path, PathBuf};

use clap::{Args, Subcommand, ValueEnum};
use holdpoint_builder::{Lang, Name};
use serde_json::json;

use crate::cli::context::CliContext;
use crate::cli::output::Output;
use crate::error::{CliError, Exit};
use holdpoint_governance::manifest::Bundle;
use holdpoint_runtime::capability::shown;

/// The arguments of `skill`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
From nothing to a registered candidate:
  holdpoint skill new my-grasp --lang rust
  holdpoint skill build my-grasp
  holdpoint skill test my-grasp
  holdpoint candidate check my-grasp
  holdpoint candidate register my-grasp")]
pub struct SkillArgs {
    /// The verb that was given, with its arguments.
    #[command(subcommand)]
    pub verb: SkillVerb,
}

/// What can be done with a skill's folder.
#[derive(Clone, Debug, PartialEq, Eq, Subcommand)]
pub enum SkillVerb {
    /// Writes a folder to begin with: a grasp that works, with all that it is built from.
    New(NewArgs),
    /// Builds a folder to a component, and puts it beside the manifest.
    Build(BuildArgs),
    /// Works ten episodes in the simulated cell, and says what the code keeps of its contract and what it costs.
    Test(TestArgs),
    /// Works one episode in the simulated cell, beside the version that a cell is commissioned with.
    Run(RunArgs),
}

/// The arguments of `skill new`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint skill new my-grasp --lang rust
  holdpoint skill new my-grasp --lang c skills/my-grasp")]
pub struct NewArgs {
    /// What the component is called: lower-case letters, digits and hyphens.
    #[arg(value_name = "NAME")]
    pub name: Name,
    /// What it is written in.
    #[arg(long, value_enum)]
    pub lang: LangArg,
    /// The folder [default: one of that name].
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
    /// What Rust is built for. A target of WASI brings imports, which the manifest has to list.
    #[arg(long, value_name = "TARGET", default_value = holdpoint_builder::target::RUST)]
    pub target: String,
}

/// The arguments of `skill test`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
It exits with 1 if the code does not keep its contract: the manifest is not
admitted, its code failed, or the same seed gave other commands. How well
it works is for sandbox and shadow to measure.

Examples:
  holdpoint skill test my-grasp
  holdpoint skill test my-grasp --seed 100 --json")]
pub struct TestArgs {
    /// The skill's folder; that of any candidate will do.
    #[arg(value_name = "DIR", default_value = ".")]
    pub folder: PathBuf,
    /// Seed of the first episode; the others follow.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
}

/// The arguments of `skill run`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint skill run my-grasp --terminal
  holdpoint skill run my-grasp --seed 7")]
pub struct RunArgs {
    /// The skill's folder; that of any candidate will do.
    #[arg(value_name = "DIR", default_value = ".")]
    pub folder: PathBuf,
    /// Seed of the episode.
    #[arg(long, value_name = "N", default_value_t = 1)]
    pub seed: u64,
    /// Draws it in this terminal; if there is none it prints two moments a second.
    #[cfg(feature = "console")]
    #[arg(long)]
    pub terminal: bool,
}

/// Does what was asked for.
///
/// # Errors
/// [`CliError`].
pub fn run(context: &CliContext, args: &SkillArgs, out: &mut Output<'_>) -> Result<Exit, CliError> {
    match &args.verb {
        SkillVerb::New(args) => new(args, out),
        SkillVerb::Build(args) => build(args, out),
        SkillVerb::Test(args) => trial::test(args, out),
        SkillVerb::Run(args) => trial::run(context, args, out),
    }
}

fn new(args: &NewArgs, out: &mut Output<'_>) -> Result<Exit, CliError> {
    let folder = args.folder.clone().unwrap_or_else(|| args.name.to_string().into());
    holdpoint_builder::scaffold(&folder, &args.name, args.lang.into())
        .map_err(|error| CliError::usage(error.to_string()))?;
    let there = shown(&folder);
    out.answer(&json!({ "folder": there }), |out| {
        out.line(&format!("wrote {there}: a grasp that works, with its manifest and what it is built from"))?;
        out.line(&format!("next: holdpoint skill build {there}"))
    })?;
    Ok(Exit::Confirmed)
}

fn build(args: &BuildArgs, out: &mut Output<'_>) -> Result<Exit, CliError> {
    let component = component(&args.folder)?;
    let built = holdpoint_builder::build(&args.folder, &component, &args.target).map_err(CliError::usage)?;
    let there = shown(&built.path);
    out.answer(&json!({ "component": there, "bytes": built.bytes }), |out| {
        out.line(&format!("built {there}, {} bytes", built.bytes))?;
        out.line(&format!("next: holdpoint skill test {}", shown(&args.folder)))
    })?;
    Ok(Exit::Confirmed)
}

/// The file that the manifest of a folder names as its component; it need not be there.
fn component(folder: &Path) -> Result<PathBuf, CliError> {
    let manifest = folder.join("manifest.toml");
    let name = shown(&manifest);
    let text = std::fs::read_to_string(&manifest)
        .map_err(|error| CliError::usage(format!("cannot read {name}: {error}")))?;
    let parsed = holdpoint_governance::manifest::Manifest::parse(&name, &text).map_err(CliError::usage)?;
    match parsed.deployment.bundle {
        Bundle::Wasm(file) => Ok(file.as_str().into()),
        Bundle::Native(controller) => {
            Err(CliError::usage(format!("{name}: the bundle is native:{controller}, which is built in"))
                .with_hint("a component's is a file, e.g. bundle = \"my-grasp.wasm\""))
        }
    }
}

#[cfg(test)]
mod tests;
