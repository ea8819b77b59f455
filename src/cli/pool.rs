//! `holdpoint pool generate | show`: pools of candidates for experiments.
//!
//! Prints what stands in the index. Must not open the truth, or print anything of it.

use std::path::PathBuf;

use clap::builder::{PossibleValue, PossibleValuesParser, TypedValueParser};
use clap::{Args, Subcommand};

use super::output::Table;
use crate::cli::output::Output;
use crate::error::{CliError, Exit};
use holdpoint_lab::pool::generate::{self, Order, SETS_MAX};
use holdpoint_lab::pool::{Pool, PoolError, PoolIndex, Preset, shown, truth_path};

/// The arguments of `pool`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint pool generate --seed 1 --out pool-1
  holdpoint pool generate --seed 7 --out pool-7 --sets 3 --preset paper-8 --json
  holdpoint pool show manifests/pool")]
pub struct PoolArgs {
    /// The verb that was given, with its arguments.
    #[command(subcommand)]
    pub verb: PoolVerb,
}

/// What can be done with pools.
#[derive(Clone, Debug, PartialEq, Eq, Subcommand)]
pub enum PoolVerb {
    /// Draws a pool and writes it; what its candidates really are goes to a file beside the folder.
    Generate(GenerateArgs),
    /// Prints what a pool holds.
    #[command(after_help = "\
Example:
  holdpoint pool show manifests/pool --json")]
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
  holdpoint pool generate --seed 1 --out pool-1 --sets 2")]
pub struct GenerateArgs {
    /// What it is drawn from; from 100 on for calibration.
    #[arg(long)]
    pub seed: u64,
    /// Where to; the folder must not be there yet.
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    /// How many times each kind occurs in a family.
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u32).range(1..=i64::from(SETS_MAX)))]
    pub sets: u32,
    /// Which kinds: all sixteen, or the paper's eight faulty ones.
    #[arg(long, default_value_t = Preset::Full10, value_parser = presets())]
    pub preset: Preset,
}

/// The presets there are, each with what it holds.
fn presets() -> impl TypedValueParser<Value = Preset> {
    let described = |preset: Preset| {
        PossibleValue::new(preset.name()).help(match preset {
            Preset::Full10 => {
                "Six benign, two overt faulty ones of each dimension, two marginal ones: 16 a family"
            }
            Preset::Paper8 => "The paper's eight faulty ones alone: I I P P B B M1 M2",
            Preset::AppendixC => {
                "The sixteen, and the kinds of the paper's appendix C that they leave out: 23 a family"
            }
            Preset::Mutants => "One blindly damaged version: as many a family as there are sets",
            Preset::Components => {
                "The controllers as components, once with each fault that code can have, and without one: 15 a family"
            }
        })
    };
    PossibleValuesParser::new(Preset::ALL.map(described)).try_map(|name| name.parse::<Preset>())
}

/// Does what was asked for.
///
/// # Errors
/// [`CliError`]: a place that is taken or cannot be written, an index that is none.
pub fn run(args: &PoolArgs, out: &mut Output<'_>) -> Result<Exit, CliError> {
    match &args.verb {
        PoolVerb::Generate(args) => {
            let order = Order { seed: args.seed, sets: args.sets, preset: args.preset };
            let index = generate::write(order, &args.out).map_err(error)?;
            out.answer(&index, |out| {
                out.line(&format!("{} candidates in {}", index.candidates.len(), shown(&args.out)))?;
                out.line(&format!("sealed in {}", shown(&truth_path(&args.out))))?;
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

fn show(index: &PoolIndex, out: &mut Output<'_>) -> Result<(), CliError> {
    out.line(&format!(
        "seed {}, {} sets, made by holdpoint {}; truth sha256 {}",
        index.seed, index.sets, index.generator, index.truth_digest
    ))?;
    let mut table = Table::new(&["name", "family", "version"]);
    for candidate in &index.candidates {
        table.row([candidate.name.clone(), candidate.family.to_string(), candidate.version.to_string()]);
    }
    out.table(&table)
}

/// What the asker can mend is usage; a fault of the generator is the program's own.
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
