//! The paper's experiments one by one or all, and what they leave: raw cells as CSV, and the report.

use std::path::PathBuf;

use holdpoint_governance::profile::ProfileName;
use serde::{Deserialize, Serialize};

use super::preset::Size;
use super::printed::Printed;
use super::screen::{ScreenRow, Variant};
use super::{Arm, Ground, Preset, RoundRow, overhead, report, rounds, screen, sections};
use crate::experiment::drift::{self, DriftOptions};
use crate::experiment::{ExperimentError, Tell};

/// Which of the experiments.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Part {
    E1,
    E2,
    /// What shadow finds that the sandbox does not.
    E3,
    E4,
    E5,
    /// The thresholds a tenth lower and a tenth higher.
    Sensitivity,
    /// Failures of the governance layer itself.
    MetaFaults,
    /// What a candidate costs, stage by stage.
    Overhead,
    Ablation,
    All,
}

impl Part {
    const fn has_rounds(self) -> bool {
        matches!(self, Self::E2 | Self::Ablation | Self::All)
    }

    fn arms(self) -> Vec<Arm> {
        use Arm::{Canary, Governed, Naive, OfflineOnly, Static, SuccessGate};
        match self {
            Self::E1
            | Self::E3
            | Self::E4
            | Self::E5
            | Self::Sensitivity
            | Self::MetaFaults
            | Self::Overhead => Vec::new(),
            Self::E2 => vec![Static, Naive, SuccessGate, Canary, OfflineOnly, Governed],
            Self::Ablation | Self::All => Arm::ALL.to_vec(),
        }
    }

    fn ways(self) -> Vec<(ProfileName, Variant)> {
        use ProfileName::{Human, Real, Sim};
        let e1 = vec![(Sim, Variant::Full)];
        let e5 = vec![(Sim, Variant::Full), (Real, Variant::Full), (Human, Variant::Full)];
        let without = [Variant::NoSandbox, Variant::NoShadow, Variant::NoRecovery, Variant::ShadowAlone];
        let ablation = without.map(|variant| (Sim, variant)).to_vec();
        let meta = vec![(Sim, Variant::NoValidation), (Sim, Variant::Halved)];
        let scaled =
            [Variant::Relaxed, Variant::Strict, Variant::B88, Variant::B88Relaxed, Variant::B88Strict];
        let scaled = scaled.map(|variant| (Sim, variant)).to_vec();
        match self {
            Self::E1 => e1,
            Self::E2 | Self::E4 | Self::Overhead => Vec::new(),
            Self::E3 => [e1, vec![(Sim, Variant::ShadowAlone), (Sim, Variant::NoShadow)]].concat(),
            Self::Sensitivity => [e1, scaled].concat(),
            Self::E5 => e5,
            Self::MetaFaults => [e1, vec![(Sim, Variant::NoShadow)], meta].concat(),
            Self::Ablation => [e1, ablation].concat(),
            Self::All => [e5, ablation, scaled, meta].concat(),
        }
    }
}

/// What is to be worked, and where it is left.
#[derive(Clone, Debug)]
pub struct Plan {
    pub part: Part,
    pub preset: Preset,
    pub size: Size,
    pub out: PathBuf,
}

impl Plan {
    /// What of the drift experiment is part of it.
    fn drifts(&self, ground: &Ground) -> Option<DriftOptions> {
        let smoke = self.preset == Preset::Smoke;
        matches!(self.part, Part::E4 | Part::All).then(|| DriftOptions {
            runs: self.size.drifts,
            seed: self.size.first_seed,
            jobs: ground.jobs,
            out: self.out.join("drift"),
            kept: ground.cells.clone(),
            horizon: if smoke { 10 } else { 200 },
            pairs: if smoke { 5 } else { 60 },
        })
    }
}

/// What came of it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Outcome {
    /// What to say of it, a line each.
    pub summary: Vec<String>,
}

/// Works the plan and writes what it came to.
///
/// # Errors
/// If a candidate does not come to an end, or a file cannot be used.
pub fn run(ground: &Ground, plan: &Plan, tell: &Tell<'_>) -> Result<Outcome, ExperimentError> {
    if ground.shard.1 > 1 && matches!(plan.part, Part::E4 | Part::Overhead) {
        return Err(ExperimentError::Option {
            option: "--shard",
            value: format!("{}/{}", ground.shard.0 + 1, ground.shard.1),
            allowed: "e4 and overhead are worked whole",
        });
    }
    if plan.part == Part::Overhead {
        // Times are not the same twice: they stand apart from what has to come out the same.
        let section = overhead::section(&overhead::measure(ground, plan.size, tell)?);
        return Ok(Outcome { summary: report::write_apart(&plan.out, "overhead.md", section)? });
    }
    let of_rounds: Vec<RoundRow> =
        if plan.part.has_rounds() { rounds(ground, plan.size, &plan.part.arms(), tell)? } else { Vec::new() };
    let (pools, ablated) = (seeds_of(plan.size, plan.size.pools), seeds_of(plan.size, plan.size.ablated));
    let (whole, left_out): (Vec<_>, Vec<_>) =
        plan.part.ways().into_iter().partition(|(_, variant)| *variant == Variant::Full);
    let mut of_pools: Vec<ScreenRow> = screen(ground, &pools, plan.size.candidates, &whole, tell)?;
    of_pools.extend(screen(ground, &ablated, plan.size.candidates, &left_out, tell)?);
    let drifts = plan.drifts(ground);
    if ground.shard.1 > 1 {
        let (part, of) = ground.shard;
        let line = format!("part {} of {of} is worked; a run without --shard writes the report", part + 1);
        return Ok(Outcome { summary: vec![line] });
    }
    let mut more = Vec::new();
    if let Some(options) = drifts {
        more.push(sections::rollback(&drift::run(&options, tell)?, &Printed::builtin()?)?);
    }
    Ok(Outcome { summary: report::write(plan, &of_rounds, &of_pools, more)? })
}

/// The first run seeds, so many.
fn seeds_of(size: Size, count: u64) -> Vec<u64> {
    size.run_seeds().take(usize::try_from(count).unwrap_or(usize::MAX)).collect()
}
