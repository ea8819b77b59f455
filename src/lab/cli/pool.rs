//! `holdpoint-lab pool generate | show`: pools of candidates for experiments.
//!
//! Prints the index. Never opens or prints the hidden ground truth.

use std::path::PathBuf;

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{Args, Subcommand};

use crate::candidate_pool::generate::{self, PoolSpec, SETS_MAX};
use crate::candidate_pool::{Pool, PoolError, PoolIndex, Preset, display_path, truth_path};
use holdpoint::cli::output::{CommandOutput, TextTable};
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
    let described = |preset: Preset| {
        PossibleValue::new(preset.name()).help(match preset {
            Preset::Full10 => {
                "Six benign, two with obvious faults in each dimension, two with borderline faults: 16 a family"
            }
            Preset::Paper8 => "The paper's eight faulty ones alone: I I P P B B M1 M2",
            Preset::AppendixC => {
                "The sixteen, and the other kinds of the paper's appendix C: 23 a family"
            }
            Preset::Equal => "The baseline under another number, and with a parameter changed by 1 in 1,000: 2 a family",
            Preset::Mutants => "One mutant for each family and set",
            Preset::Components => {
                "The controllers as components, with each fault that code can have and without a fault: 15 a family"
            }
        })
    };
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
            out.answer(&index, |out| {
                out.line(&format!("{} candidates in {}", index.candidates.len(), display_path(&args.out)))?;
                out.line(&format!("hidden ground truth in {}", display_path(&truth_path(&args.out))))?;
                out.line(&format!("truth     sha256 {}", index.truth_digest))
            })?;
        }
        PoolVerb::Show { dir } => {
            let pool = Pool::read(dir).map_err(error)?;
            out.answer(&pool.index, |out| show(&pool.index, out))?;
        }
    }
    Ok(Exit::Confirmed)
}

fn show(index: &PoolIndex, out: &mut CommandOutput<'_>) -> Result<(), CliError> {
    out.line(&format!(
        "seed {}, {} sets, made by holdpoint {}; truth sha256 {}",
        index.seed, index.sets, index.generator, index.truth_digest
    ))?;
    let mut table = TextTable::new(&["name", "family", "version"]);
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
