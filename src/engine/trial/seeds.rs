//! Which episodes a run uses: disjoint blocks of seeds per purpose.
//!
//! A run's seed below [`CALIBRATION_FROM_RUN`] uses evaluation seeds below 1,000,000, which nothing
//! is ever tuned on; calibration uses run seeds from there on, and so episode seeds from 1,000,000.

/// Episode seeds set aside for one run.
pub const BLOCK: u64 = 10_000;

/// Run seeds from here on use calibration episodes.
pub const CALIBRATION_FROM_RUN: u64 = 100;

/// First practice episode of an optimizer. A calibration seed all the same, and far above the block of any run seed
/// in use (they reach it from 4.6e14 on), so that no verdict rests on practice episodes.
pub const PRACTICE_FROM: u64 = 1 << 62;

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
    const fn range(self) -> (u64, u64) {
        match self {
            Self::Perturbation => (0, 2_000),
            Self::Canonical => (2_000, 250),
            Self::Sequence => (2_250, 250),
            Self::Adversarial => (2_500, 500),
            Self::Drill => (3_000, 1_500),
            Self::Search => (4_500, 250),
            Self::ConfirmationSequence => (4_750, 250),
            Self::Live => (5_000, 3_000),
            Self::ReEvaluation => (8_000, 800),
            Self::ReEvaluationSequence => (8_800, 200),
            Self::Confirmation => (9_000, 800),
            Self::ConfirmationDrill => (9_800, 200),
        }
    }
}

/// The seed of the `index`-th episode of a purpose in a run. Indices wrap within the purpose's block.
#[must_use]
pub const fn episode_seed(run_seed: u64, purpose: SeedPurpose, index: u64) -> u64 {
    let (from, count) = purpose.range();
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
            let (from, count) = purpose.range();
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
}
