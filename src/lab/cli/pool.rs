//! `holdpoint-lab pool generate | show`: pools of candidates for experiments.
//!
//! Prints the index. Never opens or prints the hidden ground truth.

use std::path::PathBuf;

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{Args, Subcommand};

use super::table;
use crate::candidate_pool::generate::{self, PoolSpec, SETS_MAX};
use crate::candidate_pool::{Pool, PoolError, PoolIndex, Preset, display_path, truth_path};
use crate::wording::answers;
use holdpoint::cli::output::CommandOutput;
use holdpoint::error::{CliError, Exit};

/// The arguments of `pool`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint-lab pool generate --seed 1 --out pool-1
  holdpoint-lab pool generate --seed 7 --out pool-7 --sets 3 --preset paper-8 --json
  holdpoint-lab pool show manifests/pool")]
pub struct PoolArgs {
    /// The verb with its arguments.
    #[command(subcommand)]
    pub verb: PoolVerb,
}

/// The verbs of `pool`.
#[derive(Clone, Debug, PartialEq, Eq, Subcommand)]
pub enum PoolVerb {
    /// Samples a pool and writes it; the true classes of its candidates go to a file beside the folder.
    Generate(GenerateArgs),
    /// Prints the candidates of a pool.
    #[command(after_help = "\
Example:
  holdpoint-lab pool show manifests/pool --json")]
    Show {
        /// The folder of the pool to print.
        #[arg(value_name = "DIR")]
        dir: PathBuf,
    },
}

/// The arguments of `pool generate`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Example:
  holdpoint-lab pool generate --seed 1 --out pool-1 --sets 2")]
pub struct GenerateArgs {
    /// The seed of the pool; from 100 on for calibration.
    #[arg(long)]
    pub seed: u64,
    /// The folder to create.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// How often each kind occurs in a family.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=i64::from(SETS_MAX)))]
    pub sets: u32,
    /// The kinds: all sixteen, or the paper's eight faulty ones.
    #[arg(long, default_value_t = Preset::Full10, value_parser = presets())]
    pub preset: Preset,
}

/// The presets with their content.
fn presets() -> impl TypedValueParser<Value = Preset> {
    let described = |preset: Preset| PossibleValue::new(preset.name()).help(answers::preset(preset));
    PossibleValuesParser::new(Preset::ALL.map(described)).try_map(|name| name.parse::<Preset>())
}

/// Runs the verb.
///
/// # Errors
/// [`CliError`]: a folder that exists or cannot be written, or a file that is not an index.
pub fn run(args: &PoolArgs, out: &mut CommandOutput<'_>) -> Result<Exit, CliError> {
    match &args.verb {
        PoolVerb::Generate(args) => {
            let order = PoolSpec { seed: args.seed, sets: args.sets, preset: args.preset };
            let index = generate::write(order, &args.out).map_err(error)?;
            let [folder, truth] = [&args.out, &truth_path(&args.out)].map(|path| display_path(path));
            let lines = answers::generated(&index, &folder, &truth);
            out.answer(&index, |out| lines.iter().try_for_each(|line| out.line(line)))?;
        }
        PoolVerb::Show { dir } => {
            let pool = Pool::read(dir).map_err(error)?;
            out.answer(&pool.index, |out| show(&pool.index, out))?;
        }
    }
    Ok(Exit::Confirmed)
}

fn show(index: &PoolIndex, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    out.line(&answers::pool(index))?;
    let mut table = table(answers::POOL_COLUMNS);
    for candidate in &index.candidates {
        table.row([candidate.name.clone(), candidate.family.to_string(), candidate.version.to_string()]);
    }
    out.table(&table)
}

/// Errors that the caller can correct are usage errors; others are internal.
fn error(error: PoolError) -> CliError {
    match error {
        PoolError::Generated { .. } => CliError::internal(error),
        PoolError::File { .. }
        | PoolError::Content { .. }
        | PoolError::Tampered { .. }
        | PoolError::Sets { .. }
        | PoolError::Exists(_) => CliError::usage(error),
    }
}
