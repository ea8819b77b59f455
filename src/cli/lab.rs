//! `holdpoint lab pool | refine | experiment | bench | metrics`: what research with Holdpoint needs.

use clap::{Args, Subcommand};

use super::{bench, experiment, metrics, pool, refine};

/// The arguments of `lab`.
#[derive(Clone, Debug, PartialEq, Eq, Args)]
#[command(after_help = "\
Examples:
  holdpoint lab pool generate --seed 1 --out pool-1
  holdpoint lab experiment drift --runs 2 --out results/drift
  holdpoint lab bench --quick")]
pub struct LabArgs {
    /// The verb with its arguments.
    #[command(subcommand)]
    pub verb: LabVerb,
}

/// The verbs of `lab`.
#[derive(Clone, Debug, PartialEq, Eq, Subcommand)]
pub enum LabVerb {
    /// Sample pools of candidates for experiments.
    Pool(pool::PoolArgs),
    /// Derive a candidate from a baseline: optimize its parameters for success alone.
    Refine(refine::RefineArgs),
    /// Run an experiment and write its report.
    Experiment(experiment::ExperimentArgs),
    /// Measure the engine on this machine.
    Bench(bench::BenchArgs),
    /// Compute metrics from telemetry and audit log.
    Metrics(metrics::MetricsArgs),
}
