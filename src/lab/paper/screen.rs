//! Pools of candidates through the stages, under each profile, and under `sim` with parts of the way left out.
//!
//! Each candidate meets the first versions; a variant is worked anew only where the whole way reaches what it leaves out.

use std::time::Instant;

use holdpoint_engine::Experiment;
use holdpoint_governance::ids::Family;
use holdpoint_governance::lifecycle::Stage;
use holdpoint_governance::metrics::Fate;
use holdpoint_governance::omitted::{Omitted, Part};
use holdpoint_governance::profile::ProfileName;

use super::regression::{Regression, found};
use super::stream::{Upgrade, pool_of};
use super::{Ground, progress};
use crate::experiment::candidate::{Afterwards, CandidateEnd, Effort, Thresholds};
use crate::experiment::per_candidate::{Task, one};
use crate::experiment::{ExperimentError, Tell, workers_each};
use crate::pool::Class;
use crate::truth::side_by_side;
use holdpoint_governance::decision::Dimension;
use holdpoint_protocol::standing::Stands;
use std::collections::BTreeSet;

holdpoint_governance::words! {
    /// What is left out of the way of a pool's candidates.
    Variant, "variant", {
        /// Nothing.
        Full = "full",
        /// The sandbox.
        NoSandbox = "no-sandbox",
        /// Shadow.
        NoShadow = "no-shadow",
        /// `kappa_R`.
        NoRecovery = "no-recovery-compat",
        /// Everything that rejects before shadow: what shadow finds by itself.
        ShadowAlone = "shadow-alone",
        /// What stage 2 decides: a compatibility that was never assessed.
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
    const fn parts(self) -> &'static [Part] {
        match self {
            Self::Full
            | Self::Halved
            | Self::Relaxed
            | Self::Strict
            | Self::B88
            | Self::B88Relaxed
            | Self::B88Strict => &[],
            Self::NoValidation => &[Part::Validation],
            Self::NoSandbox => &[Part::Sandbox],
            Self::NoShadow => &[Part::Shadow],
            Self::NoRecovery => &[Part::Recovery],
            Self::ShadowAlone => &[Part::Validation, Part::Sandbox],
        }
    }

    const fn thresholds(self) -> Thresholds {
        match self {
            Self::Relaxed => Thresholds::Lower,
            Self::Strict => Thresholds::Higher,
            Self::Halved => Thresholds::Halved,
            Self::B88 => Thresholds::B88,
            Self::B88Relaxed => Thresholds::B88Lower,
            Self::B88Strict => Thresholds::B88Higher,
            _ => Thresholds::AsTheyAre,
        }
    }

    /// Whether a candidate that the whole way ended so is the same to the variant.
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

/// How a candidate's way ended, as far as a report tells it.
#[derive(Clone, Debug, PartialEq)]
pub struct ScreenEnd {
    pub profile: ProfileName,
    pub fate: Fate,
    pub state: Stands,
    pub restricted: bool,
    /// By [`DIMENSIONS`]; absent where no stage came to it.
    pub kappas: [Option<f64>; 4],
    pub composite: Option<f64>,
    pub effort: Effort,
    pub afterwards: Afterwards,
    /// What the stage that stopped it found.
    pub found: BTreeSet<Regression>,
    /// The code of the last stage's first reason.
    pub first_reason: Option<String>,
}

impl ScreenEnd {
    /// What a report tells of a candidate's end.
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
            found: found(end),
            first_reason: last.map(|reason| reason.code.to_string()),
        }
    }
}

/// What became of one candidate of a pool.
#[derive(Clone, Debug, PartialEq)]
pub struct ScreenRow {
    pub seed: u64,
    pub name: String,
    pub family: Family,
    /// What was planted.
    pub class: Class,
    pub kind: String,
    /// The dimension it is worse in.
    pub dimension: Option<Dimension>,
    pub variant: Variant,
    /// It was worked for this variant; otherwise the whole way's end is its own.
    pub anew: bool,
    pub end: ScreenEnd,
}

/// One piece of work.
#[derive(Clone, Copy)]
struct Piece<'a> {
    seed: u64,
    upgrade: &'a Upgrade,
    profile: ProfileName,
    variant: Variant,
}

/// Takes the candidates of every seed's pool, at most so many, through each way. The rows come in the order of profiles and variants,
/// seeds and candidates.
///
/// # Errors
/// If a candidate does not come to an end, or nothing can be kept.
pub fn screen(
    ground: &Ground,
    seeds: &[u64],
    candidates: usize,
    ways: &[(ProfileName, Variant)],
    tell: &Tell<'_>,
) -> Result<Vec<ScreenRow>, ExperimentError> {
    let pools = seeds.iter().map(|seed| Ok((*seed, pool_of(*seed)?)));
    let pools: Vec<(u64, Vec<Upgrade>)> = pools.collect::<Result<_, ExperimentError>>()?;
    let mut pieces = Vec::new();
    for (profile, variant) in ways {
        for (seed, pool) in &pools {
            let piece = |upgrade| Piece { seed: *seed, upgrade, profile: *profile, variant: *variant };
            pieces.extend(pool.iter().take(candidates).map(piece));
        }
    }
    let pieces: Vec<Piece<'_>> = pieces
        .into_iter()
        .enumerate()
        .filter(|(index, _)| ground.is_ours(*index))
        .map(|(_, piece)| piece)
        .collect();
    let (began, workers) = (Instant::now(), workers_each(ground.jobs, pieces.len()));
    side_by_side(
        ground.jobs,
        pieces.len(),
        |_, at| row(ground, pieces[at], workers),
        &|row: &ScreenRow, finished| {
            let what = format!("{} {} of seed {}: {}", row.end.profile, row.name, row.seed, row.end.state);
            tell(&progress(&what, finished, pieces.len(), began));
        },
    )
}

fn row(ground: &Ground, piece: Piece<'_>, workers: usize) -> Result<ScreenRow, ExperimentError> {
    let Piece { seed, upgrade, profile, variant } = piece;
    let end = |variant: Variant| {
        let experiment = Experiment { omitted: Omitted::of(variant.parts()), first: Vec::new() };
        let (name, package, thresholds) = (&upgrade.name, &upgrade.package, variant.thresholds());
        let task = Task { name, package, profile, seed, experiment, thresholds, workers };
        one(&ground.cell, &ground.cells, &task)
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
        anew: !same,
        end: ScreenEnd::of(&if same { whole } else { end(variant)? }),
    })
}

/// A row of a candidate of seed 40 under the profile `sim`.
#[cfg(test)]
pub(super) fn screened(name: &str, class: Class, variant: Variant, fate: Fate) -> ScreenRow {
    let end = ScreenEnd {
        profile: ProfileName::Sim,
        fate,
        state: Stands::Confirmed,
        restricted: false,
        kappas: [None; 4],
        composite: None,
        effort: Effort::default(),
        afterwards: Afterwards::default(),
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
        anew: true,
        end,
    }
}
