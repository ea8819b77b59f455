//! The paper's experiments one by one or all, and what they leave: raw cells as CSV, and the report.

use std::path::PathBuf;

use holdpoint_governance::profile::ProfileName;
use serde::{Deserialize, Serialize};

use super::preset::Size;
use super::rows::Rows;
use super::screen::{ScreenRow, Variant};
use super::{Arm, Ground, Preset, RoundRow, overhead, report, rounds, screen};
use crate::experiment::drift::{self, DriftOptions};
use crate::experiment::{ExperimentError, Tell, layer};

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
    /// Whether parts of the layer fail under drift.
    const fn layers(self) -> bool {
        matches!(self, Self::MetaFaults | Self::All)
    }

    const fn has_rounds(self) -> bool {
        matches!(self, Self::E2 | Self::Sensitivity | Self::Ablation | Self::All)
    }

    fn arms(self) -> Vec<Arm> {
        use Arm::{Canary, Governed, Naive, OfflineOnly, Relaxed, Static, Strict, SuccessGate};
        match self {
            Self::E1 | Self::E3 | Self::E4 | Self::E5 | Self::MetaFaults | Self::Overhead => Vec::new(),
            Self::Sensitivity => vec![Static, Governed, Relaxed, Strict],
            Self::E2 => vec![Static, Naive, SuccessGate, Canary, OfflineOnly, Governed],
            Self::Ablation => Arm::of_the_ablation(),
            Self::All => Arm::ALL.to_vec(),
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
        (self.part == Part::E4 || self.part.layers()).then(|| DriftOptions {
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
    let mut rows = Rows { rounds: of_rounds, pools: of_pools, ..Rows::default() };
    if let Some(options) = drifts {
        rows.drift = Some(drift::run(&options, tell)?);
        if plan.part.layers() {
            rows.layers = layer::run(&options, tell)?;
        }
    }
    rows.write(plan.preset, &plan.out)?;
    Ok(Outcome { summary: report::write(&plan.out)? })
}

/// The first run seeds, so many.
fn seeds_of(size: Size, count: u64) -> Vec<u64> {
    size.run_seeds().take(usize::try_from(count).unwrap_or(usize::MAX)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::paper::screen::screened;
    use crate::pool::Class;
    use holdpoint_governance::lifecycle::Stage;
    use holdpoint_governance::metrics::Fate;

    /// Each experiment works ways of its own, and its report asks for no others.
    #[test]
    fn every_experiment_of_pools_writes_a_report_of_the_ways_that_it_works() {
        for part in [Part::E1, Part::E3, Part::E5, Part::Sensitivity, Part::MetaFaults, Part::Ablation] {
            let folder = tempfile::tempdir().unwrap();
            let mut pools = Vec::new();
            for (profile, variant) in part.ways() {
                for (name, class) in [("a", Class::Faulty), ("b", Class::Marginal), ("c", Class::Benign)] {
                    let fate = match class {
                        Class::Faulty => Fate::Blocked { stage: Stage::Validation },
                        _ => Fate::Kept,
                    };
                    let mut row = screened(name, class, variant, fate);
                    row.end.profile = profile;
                    pools.push(row);
                }
            }
            let rows = Rows { pools, ..Rows::default() };
            rows.write(Preset::Claims, folder.path()).unwrap();
            let lines = report::write(folder.path());
            let lines = lines.unwrap_or_else(|error| panic!("{part:?}: {error}"));
            assert!(lines.iter().any(|line| line.starts_with("E1: ")), "{part:?}: {lines:?}");
            let page = std::fs::read_to_string(folder.path().join("report.md")).unwrap();
            assert!(page.contains("## E1: screening") && page.contains("(1 of 40 seeds)"), "{part:?}");
            assert_eq!(page.contains("## Ablation"), part == Part::Ablation, "{part:?}");
            let faults = "## Failures of the governance layer itself";
            assert_eq!(page.contains(faults), part == Part::MetaFaults, "{part:?}");
        }
    }
}
