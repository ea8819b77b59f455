//! The seed a bundle is given: it tells nothing of the episode it is given for.
//!
//! An episode's own seed is one of a row: from it code could tell the sandbox from the live world, or one engine's
//! episodes from another's. Bundles get a keyed digest of it. Nothing else in a run depends on it.

use holdpoint_governance::ids::Digest;

/// What the seeds of bundles are drawn under.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SeedKey(Digest);

impl SeedKey {
    /// The key of a run; 0 where the seeds of episodes are secret themselves. A bundle's seed follows from it and its
    /// episode's seed, and neither the place nor the purpose of the episode shows in it.
    #[must_use]
    pub fn of_run(seed: u64) -> Self {
        Self(Digest::of_parts("holdpoint.bundle-seeds.run.v1", &[&seed.to_le_bytes()]))
    }

    /// A name of the key that does not give it away.
    #[must_use]
    pub fn name(&self) -> Digest {
        Digest::of_parts("holdpoint.bundle-seeds.name.v1", &[self.0.bytes()])
    }

    /// The seed of a bundle's run in an episode.
    #[must_use]
    pub fn seed(&self, episode: u64) -> BundleSeed {
        let digest = Digest::of_parts("holdpoint.bundle-seed.v1", &[self.0.bytes(), &episode.to_le_bytes()]);
        BundleSeed(digest.bytes().iter().take(8).fold(0, |seed, byte| seed << 8 | u64::from(*byte)))
    }
}

/// A seed for a bundle; made by a [`SeedKey`] alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BundleSeed(u64);

impl BundleSeed {
    /// As the bundle is given it.
    #[must_use]
    pub const fn number(self) -> u64 {
        self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seed_is_determined_by_key_and_episode() {
        let key = SeedKey::of_run(1);
        assert_eq!(key.seed(7), SeedKey::of_run(1).seed(7));
        assert_ne!(key.seed(7), key.seed(8));
        assert_ne!(key.seed(7), SeedKey::of_run(2).seed(7));
    }

    /// Seeds of adjacent episodes share no visible range or bit.
    #[test]
    fn seeds_of_adjacent_episodes_are_independent() {
        let key = SeedKey::of_run(1);
        for first in [0_u64, 1 << 40] {
            let seeds: Vec<u64> = (first..first + 2_000).map(|episode| key.seed(episode).number()).collect();
            for bit in 0..64 {
                let set = seeds.iter().filter(|seed| *seed >> bit & 1 == 1).count();
                // Six standard deviations of a fair coin.
                assert!((866..=1134).contains(&set), "bit {bit} is set in {set} of 2000");
            }
        }
    }
}
