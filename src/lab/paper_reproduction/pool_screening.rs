//! Pools of candidates through the stages, under each profile, and under `sim` with parts of the pipeline left out.
//!
//! Each candidate meets the first versions; a variant is re-run only from the stage that it leaves out.

use holdpoint_engine::Experiment;
use holdpoint_governance::ablation::{AblatedParts, AblationPart};
use holdpoint_governance::ids::Family;
use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::metrics::Fate;
use holdpoint_governance::profile::ProfileName;

use super::PaperSetup;
use super::candidate_stream::{PlantedCandidate, pool_of};
use super::regression::{Regression, categories};
use crate::candidate_pool::Class;
use crate::pipeline_experiments::candidate_run::{CandidateEnd, EpisodeEffort, PostRunCheck, ThresholdScale};
use crate::pipeline_experiments::per_candidate::{CandidateJob, run_or_reuse};
use crate::pipeline_experiments::{ExperimentError, ProgressFn, workers_each};
use crate::side_by_side::side_by_side;
use crate::wording::progress;
use holdpoint_governance::decision::Dimension;
use holdpoint_protocol::scenario_state::ScenarioState;
use std::collections::BTreeSet;

holdpoint_governance::closed_set! {
    /// The part of the pipeline that is left out.
    Variant, "variant", {
        /// Nothing.
        Full = "full",
        /// The sandbox.
        NoSandbox = "no-sandbox",
        /// Shadow.
        NoShadow = "no-shadow",
        /// `kappa_R`.
        NoRecovery = "no-recovery-compat",
        /// Everything that rejects before shadow, for what shadow alone finds.
        ShadowAlone = "shadow-alone",
        /// The decision of stage 2: a compatibility that was never assessed.
        NoValidation = "no-validation",
        /// Nothing; the thresholds are half of what they are, the least that a profile may say: a misconfiguration.
        Halved = "thresholds-50",
        /// Nothing; the thresholds are a tenth lower.
        Relaxed = "thresholds-90",
        /// Nothing; the thresholds are a tenth higher, and at most 1.
        Strict = "thresholds-110",
        /// Nothing; the threshold of `kappa_B` is .88, and with it a tenth lower and a tenth higher.
        B88 = "kappa-b-88",
        B88Relaxed = "kappa-b-88-thresholds-90",
        B88Strict = "kappa-b-88-thresholds-110",
    }
}

impl Variant {
    const fn parts(self) -> &'static [AblationPart] {
        match self {
            Self::Full
            | Self::Halved
            | Self::Relaxed
            | Self::Strict
            | Self::B88
            | Self::B88Relaxed
            | Self::B88Strict => &[],
            Self::NoValidation => &[AblationPart::Validation],
            Self::NoSandbox => &[AblationPart::Sandbox],
            Self::NoShadow => &[AblationPart::Shadow],
            Self::NoRecovery => &[AblationPart::Recovery],
            Self::ShadowAlone => &[AblationPart::Validation, AblationPart::Sandbox],
        }
    }

    const fn thresholds(self) -> ThresholdScale {
        match self {
            Self::Relaxed => ThresholdScale::Lower,
            Self::Strict => ThresholdScale::Higher,
            Self::Halved => ThresholdScale::Halved,
            Self::B88 => ThresholdScale::B88,
            Self::B88Relaxed => ThresholdScale::B88Lower,
            Self::B88Strict => ThresholdScale::B88Higher,
            _ => ThresholdScale::AsTheyAre,
        }
    }

    /// Whether a candidate with this end of the whole pipeline has the same end in the variant.
    const fn is_same(self, fate: Fate) -> bool {
        match (self, fate) {
            (Self::Full, _) => true,
            (
                Self::ShadowAlone
                | Self::NoValidation
                | Self::Halved
                | Self::Relaxed
                | Self::Strict
                | Self::B88
                | Self::B88Relaxed
                | Self::B88Strict,
                _,
            ) => false,
            (_, Fate::Blocked { stage: Stage::Validation })
            | (Self::NoShadow, Fate::Blocked { stage: Stage::Sandbox }) => true,
            (Self::NoSandbox | Self::NoShadow | Self::NoRecovery, _) => false,
        }
    }
}

/// The four dimensions of compatibility, in the order of their columns.
pub const DIMENSIONS: [Dimension; 4] =
    [Dimension::Interface, Dimension::Policy, Dimension::Behavior, Dimension::Recovery];

/// How a candidate ended, as far as a report needs it.
#[derive(Clone, Debug, PartialEq)]
pub struct ScreenEnd {
    pub profile: ProfileName,
    pub fate: Fate,
    pub state: ScenarioState,
    pub restricted: bool,
    /// By [`DIMENSIONS`]; absent if no stage measured it.
    pub kappas: [Option<f64>; 4],
    pub composite: Option<f64>,
    pub effort: EpisodeEffort,
    pub afterwards: PostRunCheck,
    /// The finding of the stage that stopped it.
    pub found: BTreeSet<Regression>,
    /// The code of the last stage's first reason.
    pub first_reason: Option<String>,
}

impl ScreenEnd {
    /// The report's part of a candidate's end.
    #[must_use]
    pub fn of(end: &CandidateEnd) -> Self {
        let kappa = |of| end.dimensions.iter().find(|one| one.dimension == of).and_then(|one| one.kappa);
        let last = end.stages.last().and_then(|stage| stage.reasons.first());
        Self {
            profile: end.profile,
            fate: end.fate,
            state: end.state,
            restricted: end.restricted,
            kappas: DIMENSIONS.map(kappa),
            composite: end.composite,
            effort: end.effort,
            afterwards: end.afterwards,
            found: categories(end),
            first_reason: last.map(|reason| reason.code.to_string()),
        }
    }
}

/// The result of one candidate of a pool.
#[derive(Clone, Debug, PartialEq)]
pub struct ScreenRow {
    pub seed: u64,
    pub name: String,
    pub family: Family,
    /// The planted fault.
    pub class: Class,
    pub kind: String,
    /// The dimension it is worse in.
    pub dimension: Option<Dimension>,
    pub variant: Variant,
    /// It ran for this variant; otherwise it has the whole pipeline's end.
    pub is_own_run: bool,
    pub end: ScreenEnd,
}

/// One piece of work.
#[derive(Clone, Copy)]
struct ScreenJob<'a> {
    seed: u64,
    upgrade: &'a PlantedCandidate,
    profile: ProfileName,
    variant: Variant,
}

/// Takes the candidates of every seed's pool, up to a limit, through each variant. The rows come in the order of
/// profiles and variants, seeds and candidates.
///
/// # Errors
/// If a candidate does not come to an end, or a result cannot be cached.
pub fn screen(
    setup: &PaperSetup,
    seeds: &[u64],
    candidates: usize,
    variants: &[(ProfileName, Variant)],
    tell: &ProgressFn<'_>,
) -> Result<Vec<ScreenRow>, ExperimentError> {
    let pools = seeds.iter().map(|seed| Ok((*seed, pool_of(*seed)?)));
    let pools: Vec<(u64, Vec<PlantedCandidate>)> = pools.collect::<Result<_, ExperimentError>>()?;
    let mut pieces = Vec::new();
    for (profile, variant) in variants {
        for (seed, pool) in &pools {
            let piece = |upgrade| ScreenJob { seed: *seed, upgrade, profile: *profile, variant: *variant };
            pieces.extend(pool.iter().take(candidates).map(piece));
        }
    }
    let pieces: Vec<ScreenJob<'_>> = setup.of_shard(pieces);
    let workers = workers_each(setup.jobs, pieces.len());
    side_by_side(
        setup.jobs,
        pieces.len(),
        |_, at| row(setup, pieces[at], workers),
        |_, row| progress::screened(row),
        tell,
    )
}

fn row(setup: &PaperSetup, piece: ScreenJob<'_>, workers: usize) -> Result<ScreenRow, ExperimentError> {
    let ScreenJob { seed, upgrade, profile, variant } = piece;
    let end = |variant: Variant| {
        let experiment = Experiment { omitted: AblatedParts::of(variant.parts()), first: Vec::new() };
        let (name, package, thresholds) = (&upgrade.name, &upgrade.package, variant.thresholds());
        let job = CandidateJob { name, package, profile, seed, experiment, thresholds, workers };
        run_or_reuse(&setup.cell, &setup.cache, &job)
    };
    let whole = end(Variant::Full)?;
    let same = variant.is_same(whole.fate);
    Ok(ScreenRow {
        seed,
        name: upgrade.name.clone(),
        family: upgrade.family.clone(),
        class: upgrade.planted.class,
        kind: upgrade.planted.kind.clone(),
        dimension: upgrade.planted.dimension,
        variant,
        is_own_run: !same,
        end: ScreenEnd::of(&if same { whole } else { end(variant)? }),
    })
}

/// A row of a candidate of seed 40 under the profile `sim`.
#[cfg(test)]
pub(super) fn screened(name: &str, class: Class, variant: Variant, fate: Fate) -> ScreenRow {
    let end = ScreenEnd {
        profile: ProfileName::Sim,
        fate,
        state: ScenarioState::Confirmed,
        restricted: false,
        kappas: [None; 4],
        composite: None,
        effort: EpisodeEffort::default(),
        afterwards: PostRunCheck::default(),
        found: BTreeSet::new(),
        first_reason: None,
    };
    ScreenRow {
        seed: 40,
        name: name.to_owned(),
        family: Family::from(holdpoint_body::TaskKind::Grasp),
        class,
        kind: "k".to_owned(),
        dimension: None,
        variant,
        is_own_run: true,
        end,
    }
}
