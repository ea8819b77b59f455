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
use serde::{Deserialize, Serialize};

use super::stream::{Upgrade, pool_of};
use super::{Ground, progress};
use crate::experiment::candidate::{CandidateEnd, Thresholds};
use crate::experiment::per_candidate::{Task, one};
use crate::experiment::{ExperimentError, Tell, workers_each};
use crate::pool::Class;
use crate::truth::side_by_side;
use holdpoint_governance::decision::Dimension;

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

/// What became of one candidate of a pool.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
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
    pub end: CandidateEnd,
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
        end: if same { whole } else { end(variant)? },
    })
}

/// A row of a candidate of seed 40 under the profile `sim`.
#[cfg(test)]
pub(super) fn screened(name: &str, class: Class, variant: Variant, fate: Fate) -> ScreenRow {
    use crate::experiment::candidate::{Afterwards, Effort};
    use holdpoint_protocol::standing::Stands;

    let end = CandidateEnd {
        name: name.to_owned(),
        version: "grasp@1.1.1".parse().unwrap(),
        profile: ProfileName::Sim,
        seed: 40,
        dimensions: Vec::new(),
        composite: None,
        stages: Vec::new(),
        state: Stands::Confirmed,
        restricted: false,
        fate,
        effort: Effort::default(),
        afterwards: Afterwards::default(),
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
