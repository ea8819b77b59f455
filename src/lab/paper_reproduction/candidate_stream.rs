//! The candidates of a seed: the pool of it, and which of them comes in which round (readings X28).
//!
//! In each round one family yields a candidate, the families in turn; its candidate is sampled. Every arm gets the same
//! ones.

use holdpoint_cell::rng::Stream;
use holdpoint_governance::ids::Family;
use holdpoint_governance::submission::Package;

use crate::candidate_pool::generate::{FAMILIES, PAPER_FROM, PoolSpec, SampledPool, draw, shuffle};
use crate::candidate_pool::{self, PoolTruth, TruthEntry};
use crate::pipeline_experiments::ExperimentError;

/// A candidate with its planted fault, which only the scoring reads.
#[derive(Clone, Debug)]
pub struct PlantedCandidate {
    pub name: String,
    pub family: Family,
    pub package: Package,
    pub planted: TruthEntry,
}

/// Every candidate of a seed's pool: six benign ones, fifteen faulty and two marginal ones a family.
///
/// # Errors
/// If the pool cannot be generated.
pub fn pool_of(seed: u64) -> Result<Vec<PlantedCandidate>, ExperimentError> {
    let order = PoolSpec { seed: PAPER_FROM + seed, sets: 1, preset: candidate_pool::Preset::AppendixC };
    let SampledPool { index, packages, truth } = draw(order)?;
    let truth: PoolTruth = serde_json::from_slice(&truth)?;
    let mut upgrades = Vec::new();
    for ((candidate, package), planted) in index.candidates.into_iter().zip(packages).zip(truth.entries) {
        upgrades.push(PlantedCandidate { name: candidate.name, family: candidate.family, package, planted });
    }
    Ok(upgrades)
}

/// The candidates of a seed's rounds, the first round's first.
///
/// # Errors
/// As [`pool_of`].
pub fn rounds_of(seed: u64, rounds: u32) -> Result<Vec<PlantedCandidate>, ExperimentError> {
    let pool = pool_of(seed)?;
    let mut stream = Stream::from_state(PAPER_FROM + seed);
    let mut families = FAMILIES;
    shuffle(&mut families, &mut stream);
    let mut left = Vec::new();
    for family in families {
        let mut of_family: Vec<PlantedCandidate> =
            pool.iter().filter(|one| one.family.as_str() == family).cloned().collect();
        shuffle(&mut of_family, &mut stream);
        left.push(of_family);
    }
    let mut found = Vec::new();
    for round in 0..rounds as usize {
        let place = round % left.len().max(1);
        found.extend(left.get_mut(place).and_then(Vec::pop));
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::candidate_pool::Class;

    #[test]
    fn candidate_stream_is_determined_by_its_seed() {
        let names = |seed, rounds| -> Vec<(String, String)> {
            let of = rounds_of(seed, rounds).unwrap();
            of.into_iter().map(|one| (one.name, one.package.params)).collect()
        };
        assert_eq!(names(1_000, 5), names(1_000, 5));
        assert_eq!(names(1_000, 3), names(1_000, 5)[..3], "more rounds begin like fewer");
        assert_ne!(names(1_000, 5), names(1_001, 5));
    }

    #[test]
    fn families_take_turns_and_no_candidate_comes_twice() {
        let found = rounds_of(1_002, 9).unwrap();
        for (round, upgrade) in found.iter().enumerate() {
            assert_eq!(upgrade.family, found[round % 3].family);
            assert!(found[..round].iter().all(|before| before.name != upgrade.name));
        }
    }

    #[test]
    fn pool_holds_the_candidates_of_the_paper_and_its_appendix_c() {
        let pool = pool_of(1_000).unwrap();
        let of = |class| pool.iter().filter(|one| one.planted.class == class).count();
        assert_eq!((of(Class::Benign), of(Class::Faulty), of(Class::Marginal)), (18, 45, 6));
    }
}
