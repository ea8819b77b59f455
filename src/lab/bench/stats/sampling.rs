//! Random draws for the study: reproducible, one stream per figure.

use holdpoint_cell::rng::Stream;

use super::tables::RecordedTable;
use holdpoint_governance::evidence::{EvidenceBinding, Pair};
use holdpoint_governance::ids::Digest;

/// A stream of draws, named by what it is for.
pub(super) struct SampleStream(Stream);

impl SampleStream {
    pub(super) fn new(name: &str) -> Self {
        let digest = Digest::of_parts("holdpoint.bench.stats.v1", &[name.as_bytes()]);
        let state = digest.bytes().iter().take(8).fold(0, |state, byte| state << 8 | u64::from(*byte));
        Self(Stream::from_state(state))
    }

    pub(super) fn chance(&mut self, probability: f64) -> bool {
        self.0.unit() < probability
    }

    /// A number below `count`; 0 if that is 0.
    #[allow(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "a unit number times a length"
    )]
    pub(super) fn below(&mut self, count: usize) -> usize {
        ((self.0.unit() * count as f64) as usize).min(count.saturating_sub(1))
    }

    /// One of the values.
    pub(super) fn of<T: Copy>(&mut self, values: &[T]) -> Option<T> {
        values.get(self.below(values.len())).copied()
    }

    pub(super) fn shuffle<T>(&mut self, values: &mut [T]) {
        for last in (1..values.len()).rev() {
            values.swap(last, self.below(last + 1));
        }
    }

    /// Pairs of a table, sampled with replacement. A coin per pair selects the candidate, so that both are exactly
    /// equally good and differ as often as the real ones.
    pub(super) fn equal_pairs(&mut self, table: &RecordedTable, count: u32) -> Vec<Pair> {
        let mut pairs = Vec::with_capacity(count as usize);
        for seed in 0..u64::from(count) {
            if let Some(pair) = self.of(&table.pairs) {
                let swapped = Pair { active: pair.candidate, candidate: pair.active, ..pair };
                pairs.push(Pair { seed, ..if self.chance(0.5) { swapped } else { pair } });
            }
        }
        pairs
    }
}

/// The digests that the study's evidence is bound to.
pub(super) fn binding() -> EvidenceBinding {
    let of = |name: &str| Digest::of_parts("holdpoint.bench.stats.v1", &[name.as_bytes()]);
    EvidenceBinding {
        candidate: of("candidate"),
        active: Some(of("active")),
        profile: of("profile"),
        policy: of("policy"),
        environment: of("environment"),
        neighbours: None,
        anchor: None,
    }
}

#[cfg(test)]
mod tests {
    use holdpoint_governance::evidence::EpisodeValues;

    use super::*;
    use holdpoint::bench::CLEAN;

    #[test]
    fn sample_stream_is_determined_by_its_name() {
        let units = |name: &str| {
            let mut draw = SampleStream::new(name);
            (0..20).map(|_| draw.below(1_000)).collect::<Vec<_>>()
        };
        assert_eq!(units("one"), units("one"));
        assert_ne!(units("one"), units("two"));
        assert!(units("one").iter().all(|value| *value < 1_000));
        assert_eq!(SampleStream::new("one").below(0), 0);
    }

    #[test]
    fn equal_pairs_are_equally_good_and_differ_as_recorded() {
        let failed = EpisodeValues { success: false, ..CLEAN };
        let worse = Pair { seed: 7, active: CLEAN, candidate: failed, live_like: false };
        let table = RecordedTable { name: "x", provenance: String::new(), pairs: vec![worse] };
        let pairs = SampleStream::new("pairs").equal_pairs(&table, 1_000);
        let lost = pairs.iter().filter(|pair| !pair.candidate.success).count();
        // Six standard errors of a fair coin.
        assert!((405..=595).contains(&lost), "{lost}");
        assert!(pairs.iter().all(|pair| pair.active.success != pair.candidate.success));
        assert!(pairs.windows(2).all(|two| two[0].seed + 1 == two[1].seed), "seeds are distinct");
    }

    #[test]
    fn shuffle_keeps_every_item() {
        let mut values: Vec<u32> = (0..50).collect();
        SampleStream::new("order").shuffle(&mut values);
        assert_ne!(values, (0..50).collect::<Vec<_>>());
        values.sort_unstable();
        assert_eq!(values, (0..50).collect::<Vec<_>>());
    }
}
