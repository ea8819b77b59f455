//! The paper's experiments one by one or all, and what they leave: raw cells as CSV, and the report.

use std::path::PathBuf;

use holdpoint_governance::profile::ProfileName;
use serde::{Deserialize, Serialize};

use super::pool_screening::{ScreenRow, Variant};
use super::preset::PresetSize;
use super::raw_rows::RawRows;
use super::{Arm, PaperSetup, Preset, RoundRow, overhead, pool_screening, report, rounds};
use crate::pipeline_experiments::drift::{self, DriftOptions};
use crate::pipeline_experiments::{ExperimentError, ProgressFn, layer_failure};
use crate::wording::answers;

/// Which of the experiments.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ExperimentPart {
    E1,
    E2,
    /// The findings of shadow that the sandbox does not have.
    E3,
    E4,
    E5,
    /// The thresholds a tenth lower and a tenth higher.
    Sensitivity,
    /// Failures of the governance layer itself.
    MetaFaults,
    /// The cost of a candidate, stage by stage.
    Overhead,
    Ablation,
    All,
}

impl ExperimentPart {
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

    fn variants(self) -> Vec<(ProfileName, Variant)> {
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

/// What to run, and where to write the results.
#[derive(Clone, Debug)]
pub struct PaperPlan {
    pub part: ExperimentPart,
    pub preset: Preset,
    pub size: PresetSize,
    pub out: PathBuf,
}

impl PaperPlan {
    /// The part of the drift experiment that it includes.
    fn drifts(&self, setup: &PaperSetup) -> Option<DriftOptions> {
        let smoke = self.preset == Preset::Smoke;
        (self.part == ExperimentPart::E4 || self.part.layers()).then(|| DriftOptions {
            runs: self.size.drifts,
            seed: self.size.first_seed,
            jobs: setup.jobs,
            out: self.out.join("drift"),
            cache: setup.cache.clone(),
            horizon: if smoke { 10 } else { 200 },
            pairs: if smoke { 5 } else { 60 },
        })
    }
}

/// The results.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct PaperOutcome {
    /// The summary, a line each.
    pub summary: Vec<String>,
}

/// Runs the plan and writes its results.
///
/// # Errors
/// If a candidate does not come to an end, or a file cannot be used.
pub fn run(
    setup: &PaperSetup,
    plan: &PaperPlan,
    tell: &ProgressFn<'_>,
) -> Result<PaperOutcome, ExperimentError> {
    if setup.shard.1 > 1 && matches!(plan.part, ExperimentPart::E4 | ExperimentPart::Overhead) {
        return Err(ExperimentError::Option {
            option: "--shard",
            value: format!("{}/{}", setup.shard.0 + 1, setup.shard.1),
            allowed: "e4 and overhead run whole",
        });
    }
    if plan.part == ExperimentPart::Overhead {
        // Times vary from run to run: they stand apart from the reproducible results.
        let section = overhead::section(&overhead::measure(setup, plan.size, tell)?);
        return Ok(PaperOutcome { summary: report::write_section_page(&plan.out, "overhead.md", section)? });
    }
    let of_rounds: Vec<RoundRow> =
        if plan.part.has_rounds() { rounds(setup, plan.size, &plan.part.arms(), tell)? } else { Vec::new() };
    let (pools, ablated) = (seeds_of(plan.size, plan.size.pools), seeds_of(plan.size, plan.size.ablated));
    let (whole, left_out): (Vec<_>, Vec<_>) =
        plan.part.variants().into_iter().partition(|(_, variant)| *variant == Variant::Full);
    let mut of_pools: Vec<ScreenRow> =
        pool_screening::screen(setup, &pools, plan.size.candidates, &whole, tell)?;
    of_pools.extend(pool_screening::screen(setup, &ablated, plan.size.candidates, &left_out, tell)?);
    let drifts = plan.drifts(setup);
    if setup.shard.1 > 1 {
        let (part, of) = setup.shard;
        return Ok(PaperOutcome { summary: vec![answers::shard_is_run(part + 1, of)] });
    }
    let mut rows = RawRows { rounds: of_rounds, pools: of_pools, ..RawRows::default() };
    if let Some(options) = drifts {
        rows.drift = Some(drift::run(&options, tell)?);
        if plan.part.layers() {
            rows.layers = layer_failure::run(&options, tell)?;
        }
    }
    rows.write(plan.preset, &plan.out)?;
    Ok(PaperOutcome { summary: report::write(&plan.out)? })
}

/// The first run seeds, so many.
fn seeds_of(size: PresetSize, count: u64) -> Vec<u64> {
    size.run_seeds().take(usize::try_from(count).unwrap_or(usize::MAX)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::candidate_pool::Class;
    use crate::paper_reproduction::pool_screening::screened;
    use holdpoint_governance::lifecycle::Stage;
    use holdpoint_governance::metrics::Fate;

    /// Each experiment has its own variants, and its report needs no others.
    #[test]
    fn every_pool_experiment_writes_a_report_of_its_variants() {
        for part in [
            ExperimentPart::E1,
            ExperimentPart::E3,
            ExperimentPart::E5,
            ExperimentPart::Sensitivity,
            ExperimentPart::MetaFaults,
            ExperimentPart::Ablation,
        ] {
            let folder = tempfile::tempdir().unwrap();
            let mut pools = Vec::new();
            for (profile, variant) in part.variants() {
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
            let rows = RawRows { pools, ..RawRows::default() };
            rows.write(Preset::Claims, folder.path()).unwrap();
            let lines = report::write(folder.path());
            let lines = lines.unwrap_or_else(|error| panic!("{part:?}: {error}"));
            assert!(lines.iter().any(|line| line.starts_with("E1: ")), "{part:?}: {lines:?}");
            let page = std::fs::read_to_string(folder.path().join("report.md")).unwrap();
            assert!(page.contains("## E1: screening") && page.contains("(1 of 40 seeds)"), "{part:?}");
            assert_eq!(page.contains("## Ablation"), part == ExperimentPart::Ablation, "{part:?}");
            let faults = "## Failures of the governance layer itself";
            assert_eq!(page.contains(faults), part == ExperimentPart::MetaFaults, "{part:?}");
        }
    }
}
