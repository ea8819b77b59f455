//! Which episodes a run uses: disjoint blocks of seeds per purpose, or seeds under a secret key.
//!
//! A run's seed below [`CALIBRATION_FROM_RUN`] uses evaluation seeds below 1,000,000, which nothing
//! is ever tuned on; calibration uses run seeds from there on, and so episode seeds from 1,000,000. Seeds under a key
//! are at [`KEYED_FROM`] and above, practice seeds at [`PRACTICE_FROM`] and above.

use holdpoint_governance::evaluation_key::EvaluationKey;
use holdpoint_governance::ids::Digest;

/// Episode seeds set aside for one run.
pub const BLOCK: u64 = 10_000;

/// Run seeds from here on use calibration episodes.
pub const CALIBRATION_FROM_RUN: u64 = 100;

/// First practice episode of an optimizer. A calibration seed all the same, and far above the block of any run seed
/// in use (they reach it from 4.6e14 on), so that no verdict rests on practice episodes.
pub const PRACTICE_FROM: u64 = 1 << 62;

/// First seed under a key, and their number: 52 random bits. They end at `2^53`, so that every reader of JSON keeps them.
pub const KEYED_FROM: u64 = 1 << 52;

/// The seeds of a session's episodes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EpisodeSeeds {
    /// Secret: each evaluation and each stretch of live work has a key of its own.
    Secret,
    /// Known, and equal in every store: for scripts, experiments and the demonstration.
    OfRun(u64),
}

impl EpisodeSeeds {
    /// The run's seed, unless the seeds are secret.
    #[must_use]
    pub const fn of_run(self) -> Option<u64> {
        match self {
            Self::Secret => None,
            Self::OfRun(seed) => Some(seed),
        }
    }
}

/// Gives the seeds of one evaluation, or of a stretch of live work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SeedSource {
    /// The blocks of a run's seed.
    OfRun(u64),
    /// A keyed generator.
    Keyed(EvaluationKey),
}

impl SeedSource {
    /// The seed of the `index`-th episode of a purpose.
    #[must_use]
    pub fn seed(&self, purpose: SeedPurpose, index: u64) -> u64 {
        match self {
            Self::OfRun(run_seed) => episode_seed(*run_seed, purpose, index),
            Self::Keyed(key) => KEYED_FROM + key.number(purpose.row().0, index) % KEYED_FROM,
        }
    }

    /// The commitment to the key; absent for a run's seed.
    #[must_use]
    pub fn commitment(&self) -> Option<Digest> {
        match self {
            Self::OfRun(_) => None,
            Self::Keyed(key) => Some(key.commitment()),
        }
    }

    /// The state in which the search for the worst episode begins.
    #[must_use]
    pub fn search_state(&self) -> u64 {
        match self {
            Self::OfRun(run_seed) => *run_seed,
            Self::Keyed(key) => key.number("search-state", 0),
        }
    }
}

/// What episodes are for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SeedPurpose {
    /// Sandbox, perturbation mode: the paired comparison.
    Perturbation,
    /// Sandbox, canonical mode: no perturbation.
    Canonical,
    /// Sandbox, adversarial-governance mode: the envelope leaves less speed and force.
    Adversarial,
    Drill,
    Live,
    /// Pairs of the confirmation, which the sandbox has not seen.
    Confirmation,
    /// Drills of the confirmation.
    ConfirmationDrill,
    /// Noise of the episodes that a search tries.
    Search,
    /// Whole sequences of the sandbox.
    Sequence,
    /// Whole sequences of the confirmation.
    ConfirmationSequence,
    /// Pairs of a suspicious version in the live world's conditions.
    ReEvaluation,
    /// Whole sequences of it.
    ReEvaluationSequence,
}

impl SeedPurpose {
    /// The name under which a key gives its seeds; and of its block in a run the first seed and their number.
    const fn row(self) -> (&'static str, u64, u64) {
        match self {
            Self::Perturbation => ("perturbation", 0, 2_000),
            Self::Canonical => ("canonical", 2_000, 250),
            Self::Sequence => ("sequence", 2_250, 250),
            Self::Adversarial => ("adversarial", 2_500, 500),
            Self::Drill => ("drill", 3_000, 1_500),
            Self::Search => ("search", 4_500, 250),
            Self::ConfirmationSequence => ("confirmation-sequence", 4_750, 250),
            Self::Live => ("live", 5_000, 3_000),
            Self::ReEvaluation => ("re-evaluation", 8_000, 800),
            Self::ReEvaluationSequence => ("re-evaluation-sequence", 8_800, 200),
            Self::Confirmation => ("confirmation", 9_000, 800),
            Self::ConfirmationDrill => ("confirmation-drill", 9_800, 200),
        }
    }
}

/// The seed of the `index`-th episode of a purpose in a run. Indices wrap within the purpose's block.
#[must_use]
pub const fn episode_seed(run_seed: u64, purpose: SeedPurpose, index: u64) -> u64 {
    let (_, from, count) = purpose.row();
    run_seed.wrapping_mul(BLOCK).wrapping_add(from + index % count)
}

/// The seed of the `index`-th practice episode for the search of a seed. Indices wrap within a block.
#[must_use]
pub const fn practice_seed(search_seed: u32, index: u64) -> u64 {
    PRACTICE_FROM + search_seed as u64 * BLOCK + index % BLOCK
}

#[cfg(test)]
mod tests {
    use super::*;

    const PURPOSES: [SeedPurpose; 12] = [
        SeedPurpose::Perturbation,
        SeedPurpose::Canonical,
        SeedPurpose::Sequence,
        SeedPurpose::Adversarial,
        SeedPurpose::Drill,
        SeedPurpose::Search,
        SeedPurpose::ConfirmationSequence,
        SeedPurpose::Live,
        SeedPurpose::ReEvaluation,
        SeedPurpose::ReEvaluationSequence,
        SeedPurpose::Confirmation,
        SeedPurpose::ConfirmationDrill,
    ];

    #[test]
    fn blocks_are_disjoint_and_fill_a_run() {
        let mut next = 0;
        for purpose in PURPOSES {
            let (_, from, count) = purpose.row();
            assert_eq!(from, next, "{purpose:?}");
            next = from + count;
        }
        assert_eq!(next, BLOCK);
    }

    #[test]
    fn evaluation_stays_below_a_million_and_calibration_does_not() {
        for purpose in PURPOSES {
            assert!(episode_seed(CALIBRATION_FROM_RUN - 1, purpose, 9_999) < 1_000_000);
            assert!(episode_seed(CALIBRATION_FROM_RUN, purpose, 0) >= 1_000_000);
        }
    }

    #[test]
    fn practice_seeds_are_disjoint_from_every_run() {
        let last_of_runs = episode_seed(u64::from(u32::MAX), SeedPurpose::ConfirmationDrill, 199);
        assert!(last_of_runs < practice_seed(0, 0));
        // One search does not reach into another's, and the highest is still a seed.
        assert_eq!(practice_seed(7, BLOCK - 1) + 1, practice_seed(8, 0));
        assert!(practice_seed(u32::MAX, BLOCK - 1) > practice_seed(0, 0));
    }

    #[test]
    fn keyed_seeds_are_disjoint_from_runs_and_practice_and_differ_by_key_purpose_and_index() {
        let keys = [1, 2].map(|byte| SeedSource::Keyed(EvaluationKey::from_secret([byte; 32])));
        let mut seen = std::collections::BTreeSet::new();
        for key in keys {
            for purpose in PURPOSES {
                for index in 0..400 {
                    let seed = key.seed(purpose, index);
                    assert!((KEYED_FROM..KEYED_FROM * 2).contains(&seed), "{seed}");
                    assert!(seed > episode_seed(u64::from(u32::MAX), SeedPurpose::ConfirmationDrill, 199));
                    assert!(seed < PRACTICE_FROM);
                    assert!(seen.insert(seed), "{purpose:?} {index} repeats {seed}");
                }
            }
        }
    }

    /// Neither the purpose nor the place of an episode can be seen in its seed.
    #[test]
    fn keyed_seeds_of_adjacent_places_share_no_bit() {
        let key = SeedSource::Keyed(EvaluationKey::from_secret([7; 32]));
        for purpose in [SeedPurpose::Perturbation, SeedPurpose::Live] {
            for bit in 0..52 {
                let set = (0..2_000).filter(|index| key.seed(purpose, *index) >> bit & 1 == 1).count();
                // Six standard deviations of a fair coin.
                assert!((866..=1134).contains(&set), "bit {bit} is set in {set} of 2000");
            }
        }
    }
}
