//! The sizes of the experiments: those of the paper, one for a quick look, and one whose numbers support claims.

holdpoint_governance::closed_set! {
    /// A size of the paper's experiments.
    Preset, "preset", {
        /// One seed, one round, ten sequences, two candidates of a pool, and no referee's verdict on versions: about a
        /// minute for all of them.
        Smoke = "smoke",
        /// Five seeds, as the paper's figure 4 and tables 8 to 10.
        PaperFig4 = "paper-fig4",
        /// Fifteen seeds, as the paper's table 7.
        PaperE2 = "paper-e2",
        /// Five seeds and eight rounds, as the paper's section 7.8.
        Protocol = "protocol",
        /// Forty seeds.
        Claims = "claims",
    }
}

/// Run seeds from this on are these experiments' alone.
const FIRST_SEED: u64 = 40;

/// The size of the runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PresetSize {
    /// The first run seed.
    pub first_seed: u64,
    pub seeds: u64,
    /// Rounds of upgrades; round 0 comes before them.
    pub rounds: u32,
    /// Held-out sequences of a round: three tasks each.
    pub sequences: u64,
    /// Pairs of episodes by which the referee judges an activated version; 0: it judges none.
    pub judged_by: u64,
    /// The most candidates of a pool that are taken through the stages.
    pub candidates: usize,
    /// Seeds whose pools go through the stages under each profile.
    pub pools: u64,
    /// Seeds of those whose pools go through with parts left out, too.
    pub ablated: u64,
    /// Independent runs of the drift experiment.
    pub drifts: u64,
}

impl PresetSize {
    /// The run seeds.
    pub fn run_seeds(&self) -> impl Iterator<Item = u64> {
        self.first_seed..self.first_seed + self.seeds
    }

    /// The same from one of its seeds on; `None` for another seed.
    #[must_use]
    pub fn beginning_at(self, first: u64) -> Option<Self> {
        let skipped = first.checked_sub(self.first_seed).filter(|skipped| *skipped < self.seeds)?;
        Some(Self { first_seed: first, seeds: self.seeds - skipped, ..self })
    }
}

impl Preset {
    /// The size of the runs.
    #[must_use]
    pub const fn size(self) -> PresetSize {
        let whole = PresetSize {
            first_seed: FIRST_SEED,
            seeds: 15,
            rounds: 5,
            sequences: 50,
            judged_by: 200,
            candidates: usize::MAX,
            pools: 9,
            ablated: 3,
            drifts: 6,
        };
        match self {
            Self::Smoke => PresetSize {
                // The sandbox soon finds the fault that its round offers, and validation stops its first two
                // candidates. The slow stages run only where a part is left out.
                first_seed: 1_099,
                seeds: 1,
                rounds: 1,
                sequences: 10,
                judged_by: 0,
                candidates: 2,
                pools: 1,
                ablated: 1,
                drifts: 1,
            },
            Self::PaperFig4 => PresetSize { seeds: 5, pools: 5, ..whole },
            Self::PaperE2 => whole,
            Self::Protocol => PresetSize { seeds: 5, rounds: 8, pools: 5, ..whole },
            Self::Claims => PresetSize { seeds: 40, pools: 40, ablated: 40, drifts: 40, ..whole },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_trials::seeds::CALIBRATION_FROM_RUN;

    #[test]
    fn later_first_seed_keeps_the_following_seeds() {
        let size = Preset::Claims.size();
        let later = size.beginning_at(55).unwrap();
        assert!(later.run_seeds().eq(55..80), "{later:?}");
        assert_eq!(size.beginning_at(40), Some(size));
        assert_eq!((size.beginning_at(39), size.beginning_at(80)), (None, None));
    }

    /// Claims rest on episodes that nothing was tuned on; a quick look must not use them up.
    #[test]
    fn claims_use_evaluation_seeds_and_a_quick_look_does_not() {
        for preset in Preset::ALL {
            let size = preset.size();
            let evaluates = size.run_seeds().all(|seed| seed < CALIBRATION_FROM_RUN);
            assert_eq!(evaluates, preset != Preset::Smoke, "{preset}");
        }
    }
}
