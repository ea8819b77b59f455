//! Which results of a comparison were cached, and how many of those were re-run.
//!
//! Plain values for the record. Judges nothing: the caller decides what a cache mismatch means.

use std::fmt;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::evidence::DrillKind;
use super::ids::{CapabilityId, Digest};
use super::stats::spot_check::{assumed_edits, detection_probability};

crate::closed_set! {
    /// The place of a cache.
    CacheLocation, "place of a cache", {
        /// In the store, authenticated with a secret among its keys.
        Store = "store",
        /// In a folder that runs share, authenticated with a key file outside it.
        Folder = "folder",
    }
}

/// The kind of cached work.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum CachedWorkKind {
    /// Sandbox episodes of the version that was compared with.
    Episodes,
    /// Sandbox episodes of the family's anchor.
    AnchorEpisodes,
    /// Recovery drills of one kind of that version.
    Drills(DrillKind),
    /// Whole sequences with that version in its place.
    Sequences,
}

/// A block of cached results from which spot checks are sampled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SampleGroup {
    /// Episodes.
    Episodes,
    /// Drills of all kinds.
    Drills,
    /// Whole sequences.
    Sequences,
}

impl SampleGroup {
    /// In the order in which a record lists them.
    pub const ALL: [Self; 3] = [Self::Episodes, Self::Drills, Self::Sequences];
}

impl CachedWorkKind {
    /// What it is drawn from together with.
    #[must_use]
    pub const fn sample_group(self) -> SampleGroup {
        match self {
            Self::Episodes | Self::AnchorEpisodes => SampleGroup::Episodes,
            Self::Drills(_) => SampleGroup::Drills,
            Self::Sequences => SampleGroup::Sequences,
        }
    }
}

impl fmt::Display for CachedWorkKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Episodes => f.write_str("episodes"),
            Self::AnchorEpisodes => f.write_str("anchor episodes"),
            Self::Drills(kind) => write!(f, "{kind} drills"),
            Self::Sequences => f.write_str("sequences"),
        }
    }
}

/// Seeds in a row, both ends included.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct SeedRange {
    /// The first of them.
    pub from: u64,
    /// The last of them.
    pub to: u64,
}

impl SeedRange {
    /// The fewest ranges that contain these seeds, in order.
    #[must_use]
    pub fn of(seeds: impl IntoIterator<Item = u64>) -> Vec<Self> {
        let mut seeds: Vec<u64> = seeds.into_iter().collect();
        seeds.sort_unstable();
        let mut ranges: Vec<Self> = Vec::new();
        for seed in seeds {
            match ranges.last_mut() {
                Some(last) if seed <= last.to.saturating_add(1) => last.to = seed,
                _ => ranges.push(Self { from: seed, to: seed }),
            }
        }
        ranges
    }

    /// The number of seeds in them.
    #[must_use]
    pub fn count(ranges: &[Self]) -> u64 {
        ranges.iter().map(|range| range.to.saturating_sub(range.from).saturating_add(1)).sum()
    }
}

impl fmt::Display for SeedRange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { from, to } = self;
        if from == to { write!(f, "{from}") } else { write!(f, "{from}-{to}") }
    }
}

/// Cached results of one kind that a comparison rests on.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CachedResultBlock {
    /// Its kind.
    pub work: CachedWorkKind,
    /// The seeds it was taken for.
    pub seeds: Vec<SeedRange>,
    /// How many of them the same process had run itself.
    pub own: u32,
    /// Digest of the used results, in the order of use.
    pub digest: Digest,
    /// The sampled seeds of the others, whose re-run gave the same result, bit for bit.
    pub rerun: Vec<SeedRange>,
}

/// The cached part of a comparison.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct CachedResultUse {
    /// Its place.
    pub place: CacheLocation,
    /// By kind of work.
    pub blocks: Vec<CachedResultBlock>,
    /// Results in the cache without a valid MAC: they were recomputed.
    pub refused: u32,
}

/// A cache mismatch, as recorded: cached results that differ from their re-run.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CachedResultMismatch {
    /// Their place.
    pub place: CacheLocation,
    /// The version that the cache names for them.
    pub active: CapabilityId,
    /// How many had been run again when it was found.
    pub rerun: u64,
    /// The seeds whose results differ.
    pub differing: Vec<(CachedWorkKind, Vec<SeedRange>)>,
}

/// Counts of one draw: episodes and sequences are drawn from each by themselves, drills of all kinds together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RerunSampleCounts {
    /// The results taken from another process's cache.
    pub foreign: u64,
    /// How much of it was run again.
    pub rerun: u64,
}

impl RerunSampleCounts {
    /// The probability that the sample finds the assumed edits; absent where nothing was taken from another process.
    #[must_use]
    pub fn detection_probability(&self) -> Option<f64> {
        let (foreign, rerun) = (u32::try_from(self.foreign).ok()?, u32::try_from(self.rerun).ok()?);
        (foreign > 0).then(|| detection_probability(foreign, assumed_edits(foreign), rerun))
    }
}

impl CachedResultUse {
    /// The three draws: of episodes, of drills, and of sequences.
    #[must_use]
    pub fn sample_counts(&self) -> [RerunSampleCounts; 3] {
        let mut draws = [RerunSampleCounts::default(); 3];
        for block in &self.blocks {
            let draw = &mut draws[block.work.sample_group() as usize];
            draw.foreign += SeedRange::count(&block.seeds).saturating_sub(u64::from(block.own));
            draw.rerun += SeedRange::count(&block.rerun);
        }
        draws
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seeds_in_a_row_are_one_range() {
        let ranges = SeedRange::of([7, 3, 4, 5, 5, 9, u64::MAX, 8]);
        let text: Vec<String> = ranges.iter().map(SeedRange::to_string).collect();
        assert_eq!(text, ["3-5", "7-9", &u64::MAX.to_string()]);
        assert_eq!(SeedRange::count(&ranges), 7);
    }

    #[test]
    fn samples_are_reported_with_power() {
        let block = |work, count, own, rerun| CachedResultBlock {
            work,
            seeds: SeedRange::of(0..count),
            own,
            digest: Digest::of_parts("test", &[]),
            rerun: SeedRange::of(0..rerun),
        };
        let used = CachedResultUse {
            place: CacheLocation::Folder,
            blocks: vec![
                block(CachedWorkKind::Episodes, 320, 20, 54),
                block(CachedWorkKind::Drills(DrillKind::Abort), 40, 40, 0),
                block(CachedWorkKind::Drills(DrillKind::Detect), 40, 0, 31),
            ],
            refused: 2,
        };
        let none = RerunSampleCounts::default();
        assert_eq!(
            used.sample_counts(),
            [
                RerunSampleCounts { foreign: 300, rerun: 54 },
                RerunSampleCounts { foreign: 40, rerun: 31 },
                none
            ]
        );
        let power = used.sample_counts().map(|counts| counts.detection_probability());
        assert!(power[0].is_some_and(|power| (power - 0.953).abs() < 5e-4), "{power:?}");
        assert!(power[1].is_some() && power[2].is_none(), "{power:?}");
        let json = serde_json::to_string(&used).unwrap();
        assert_eq!(serde_json::from_str::<CachedResultUse>(&json).unwrap(), used);
    }
}
