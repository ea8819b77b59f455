//! What of a comparison was not worked for it but kept from before, and how much of that was worked again.
//!
//! Plain values for the record. Judges nothing: that a kept result differs is for who finds it.

use std::fmt;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use super::evidence::DrillKind;
use super::ids::{CapabilityId, Digest};
use super::stats::spot_check::{EDITED_ONE_IN, edited, found};

crate::words! {
    /// Where results are kept.
    KeptPlace, "place of kept results", {
        /// In the store, authenticated with a secret among its keys.
        Store = "store",
        /// In a folder that runs share, authenticated with a key file outside it.
        Folder = "folder",
    }
}

/// What was kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "kebab-case")]
pub enum KeptWork {
    /// Sandbox episodes of the version that was compared with.
    Episodes,
    /// Recovery drills of one kind of that version.
    Drills(DrillKind),
    /// Whole sequences with that version in its place.
    Sequences,
}

/// What is drawn from together, to be run again.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DrawOf {
    /// Episodes.
    Episodes,
    /// Drills of all kinds.
    Drills,
    /// Whole sequences.
    Sequences,
}

impl DrawOf {
    /// In the order of [`KeptUse::draws`].
    pub const ALL: [Self; 3] = [Self::Episodes, Self::Drills, Self::Sequences];

    const fn name(self) -> &'static str {
        match self {
            Self::Episodes => "episodes",
            Self::Drills => "drills",
            Self::Sequences => "sequences",
        }
    }
}

impl KeptWork {
    /// What it is drawn from together with.
    #[must_use]
    pub const fn draw(self) -> DrawOf {
        match self {
            Self::Episodes => DrawOf::Episodes,
            Self::Drills(_) => DrawOf::Drills,
            Self::Sequences => DrawOf::Sequences,
        }
    }
}

impl fmt::Display for KeptWork {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Episodes => f.write_str("episodes"),
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
    /// As few ranges as hold these seeds, in order.
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

    /// How many seeds they hold.
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

/// Kept results of one kind that a comparison rests on.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct KeptBlock {
    /// What it was.
    pub work: KeptWork,
    /// The seeds it was taken for.
    pub seeds: Vec<SeedRange>,
    /// How many of them the same process had worked itself and remembered.
    pub own: u32,
    /// Digest of what was taken, in the order of use.
    pub digest: Digest,
    /// The seeds that were drawn of the others, run again, and came to the same, bit for bit.
    pub rerun: Vec<SeedRange>,
}

/// What of a comparison was kept from before.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct KeptUse {
    /// Where it was kept.
    pub place: KeptPlace,
    /// By kind of work.
    pub blocks: Vec<KeptBlock>,
    /// Results that lay where they should, but not as they were kept here: they were worked anew.
    pub refused: u32,
}

/// Kept results that came out otherwise when they were run again, as it is put on record.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct KeptVoid {
    /// Where they were kept.
    pub place: KeptPlace,
    /// The version whose results they were said to be.
    pub active: CapabilityId,
    /// How many had been run again when it was found.
    pub rerun: u64,
    /// The seeds that came out otherwise.
    pub differing: Vec<(KeptWork, Vec<SeedRange>)>,
}

/// Counts of one draw: episodes and sequences are drawn from each by themselves, drills of all kinds together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct KeptDraw {
    /// What was taken of what another process kept.
    pub foreign: u64,
    /// How much of it was run again.
    pub rerun: u64,
}

impl KeptUse {
    /// The three draws: of episodes, of drills, and of sequences.
    #[must_use]
    pub fn draws(&self) -> [KeptDraw; 3] {
        let mut draws = [KeptDraw::default(); 3];
        for block in &self.blocks {
            let draw = &mut draws[block.work.draw() as usize];
            draw.foreign += SeedRange::count(&block.seeds).saturating_sub(u64::from(block.own));
            draw.rerun += SeedRange::count(&block.rerun);
        }
        draws
    }

    /// It in words, a line for each kind of work and each draw.
    #[must_use]
    pub fn lines(&self) -> Vec<String> {
        let list = |ranges: &[SeedRange]| {
            let all: Vec<String> = ranges.iter().map(SeedRange::to_string).collect();
            all.join(", ")
        };
        let mut lines: Vec<String> = self
            .blocks
            .iter()
            .map(|KeptBlock { work, seeds, own, digest, rerun }| {
                let (count, digest) = (SeedRange::count(seeds), digest.to_string());
                let short = digest.get(..12).unwrap_or(&digest);
                let mut line = format!(
                    "{count} {work} of the version compared with were kept in the {} (seeds {}; digest {short}), \
                     {own} of them by the same process",
                    self.place,
                    list(seeds)
                );
                if !rerun.is_empty() {
                    line += &format!("; run again: {}", list(rerun));
                }
                line
            })
            .collect();
        for (of, KeptDraw { foreign, rerun }) in DrawOf::ALL.into_iter().zip(self.draws()) {
            let what = of.name();
            let (Ok(foreign), Ok(rerun)) = (u32::try_from(foreign), u32::try_from(rerun)) else { continue };
            if foreign > 0 {
                let power = found(foreign, edited(foreign), rerun);
                lines.push(format!(
                    "{rerun} of {foreign} {what} that another process kept were drawn, run again, and came to the \
                     same, bit for bit; had 1 in {EDITED_ONE_IN} been edited, that finds it with probability \
                     {power:.3}"
                ));
            }
        }
        if self.refused > 0 {
            lines.push(format!(
                "{} kept results were not what was kept here (no or a wrong code); they were worked anew",
                self.refused
            ));
        }
        lines
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
    fn what_was_drawn_is_told_with_its_power() {
        let block = |work, count, own, rerun| KeptBlock {
            work,
            seeds: SeedRange::of(0..count),
            own,
            digest: Digest::of_parts("test", &[]),
            rerun: SeedRange::of(0..rerun),
        };
        let used = KeptUse {
            place: KeptPlace::Folder,
            blocks: vec![
                block(KeptWork::Episodes, 320, 20, 54),
                block(KeptWork::Drills(DrillKind::Abort), 40, 40, 0),
                block(KeptWork::Drills(DrillKind::Detect), 40, 0, 31),
            ],
            refused: 2,
        };
        let none = KeptDraw::default();
        assert_eq!(
            used.draws(),
            [KeptDraw { foreign: 300, rerun: 54 }, KeptDraw { foreign: 40, rerun: 31 }, none]
        );
        let told = used.lines().join("\n");
        for said in
            ["320 episodes", "0-319", "54 of 300 episodes", "0.953", "31 of 40 drills", "2 kept results"]
        {
            assert!(told.contains(said), "{said:?} is missing in {told}");
        }
        let json = serde_json::to_string(&used).unwrap();
        assert_eq!(serde_json::from_str::<KeptUse>(&json).unwrap(), used);
    }
}
