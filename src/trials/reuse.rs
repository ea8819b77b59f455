//! The cached results that one comparison used, and the spot check that must precede its decision.
//!
//! Results that this process ran itself are known to it. A sample of those that another process cached is run again at
//! the end and compared bit for bit. Its size detects a block with one false result in twenty in 95 of 100 comparisons
//! (`governance::stats::spot_check`). Samples and compares; the stage decides what follows from a difference.

use std::collections::{BTreeMap, BTreeSet};

use crate::fault::TrialFault;
use crate::trial_lab::{PairSpot, TrialLab, TrialSubject};
use holdpoint_governance::cached_result::{
    CacheLocation, CachedResultBlock, CachedResultMismatch, CachedResultUse, CachedWorkKind, SampleGroup,
    SeedRange,
};
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::phase::WorkPhase;
use holdpoint_governance::stats::spot_check::spot_check;

/// A cached result that a comparison used.
#[derive(Clone, Debug)]
pub struct ReusedResult {
    pub work: CachedWorkKind,
    /// Of a drill: the phase in which it began.
    pub phase: Option<WorkPhase>,
    pub seed: u64,
    /// Of an episode: it is a live-like one.
    pub live_like: bool,
    /// Digest of its bytes.
    pub value: Digest,
    /// This process ran it itself.
    pub own: bool,
}

impl ReusedResult {
    /// An episode of a pair, or of the anchor.
    #[must_use]
    pub const fn of_episode(work: CachedWorkKind, spot: PairSpot, value: Digest, own: bool) -> Self {
        let PairSpot { seed, live_like } = spot;
        Self { work, phase: None, seed, live_like, value, own }
    }

    /// The spot of an episode.
    #[must_use]
    pub const fn pair_spot(&self) -> PairSpot {
        PairSpot { seed: self.seed, live_like: self.live_like }
    }
}

/// The progress of the spot check.
#[derive(Clone, Debug, Default)]
enum SpotCheck {
    #[default]
    NotSampled,
    /// Places among the used results that remain to be run again, the last first.
    Sampled(Vec<usize>),
}

/// See the module's head.
#[derive(Clone, Debug, Default)]
pub struct Reuse {
    used: Vec<ReusedResult>,
    refused: u32,
    check: SpotCheck,
    /// Places of results that equal their re-run.
    equal: Vec<usize>,
    /// Places of results that differ from their re-run.
    differing: Vec<usize>,
}

/// Digest of a result's bytes.
#[must_use]
pub fn value(bytes: &[u8]) -> Digest {
    Digest::of_parts("holdpoint.kept-value.v1", &[bytes])
}

impl Reuse {
    pub fn note_use(&mut self, result: ReusedResult) {
        self.used.push(result);
    }

    /// Notes an invalid entry in the place of a cached result.
    pub const fn note_refusal(&mut self) {
        self.refused = self.refused.saturating_add(1);
    }

    /// Whether no result is left to re-run. Later additions are not checked.
    #[must_use]
    pub fn is_checked(&self) -> bool {
        match &self.check {
            SpotCheck::NotSampled => self.used.iter().all(|result| result.own),
            SpotCheck::Sampled(remaining) => remaining.is_empty(),
        }
    }

    /// The cached results that differ from their re-run.
    pub fn mismatches(&self) -> impl Iterator<Item = &ReusedResult> {
        self.differing.iter().filter_map(|place| self.used.get(*place))
    }

    /// Runs a part of the sample again; samples first, from all used results.
    ///
    /// # Errors
    /// If the lab fails, or the system gives no random numbers.
    pub fn check_part(&mut self, lab: &TrialLab<'_>, active: &TrialSubject) -> Result<(), TrialFault> {
        if matches!(self.check, SpotCheck::NotSampled) {
            self.check = SpotCheck::Sampled(self.sample_spot_check(lab)?);
        }
        let SpotCheck::Sampled(remaining) = &mut self.check else { return Ok(()) };
        let part = remaining.split_off(remaining.len().saturating_sub(lab.part));
        let checked: Vec<(usize, &ReusedResult)> =
            part.iter().filter_map(|place| Some((*place, self.used.get(*place)?))).collect();
        let reruns = lab.rerun_episodes(active, checked.iter().map(|(_, result)| *result))?;
        for ((place, result), bytes) in checked.into_iter().zip(reruns) {
            if value(&bytes) == result.value {
                if result.work == CachedWorkKind::Episodes {
                    lab.confirm_episode(active, result.pair_spot(), &bytes);
                }
                self.equal.push(place);
            } else {
                self.differing.push(place);
            }
        }
        Ok(())
    }

    /// Samples the places to run again: of episodes, drills and sequences each as many as the check's power needs.
    fn sample_spot_check(&self, lab: &TrialLab<'_>) -> Result<Vec<usize>, TrialFault> {
        let mut sampled = Vec::new();
        for group in SampleGroup::ALL {
            // Seeds may repeat in a large budget: one re-run of each is enough.
            let mut seen = BTreeSet::new();
            let mut is_in_block = |result: &ReusedResult| {
                let is_foreign = !result.own && result.work.sample_group() == group;
                is_foreign && seen.insert((result.work, result.seed))
            };
            let foreign: Vec<usize> = (0_usize..)
                .zip(&self.used)
                .filter_map(|(place, result)| is_in_block(result).then_some(place))
                .collect();
            let wanted = spot_check(u32::try_from(foreign.len()).unwrap_or(u32::MAX));
            let block = digest(foreign.iter().filter_map(|place| self.used.get(*place)));
            let wanted = usize::try_from(wanted).unwrap_or(usize::MAX);
            let places = lab.cache.secret().sample(&block, foreign.len(), wanted)?;
            sampled.extend(places.iter().filter_map(|place| foreign.get(*place)));
        }
        sampled.reverse();
        Ok(sampled)
    }

    /// The results that differ from their re-run, for the record.
    #[must_use]
    pub fn mismatch_record(&self, place: CacheLocation, active: &CapabilityId) -> CachedResultMismatch {
        let mut seeds_of: BTreeMap<CachedWorkKind, Vec<u64>> = BTreeMap::new();
        for result in self.mismatches() {
            seeds_of.entry(result.work).or_default().push(result.seed);
        }
        let differing = seeds_of.into_iter().map(|(work, seeds)| (work, SeedRange::of(seeds))).collect();
        let rerun = (self.equal.len() + self.differing.len()) as u64;
        CachedResultMismatch { place, active: active.clone(), rerun, differing }
    }

    /// The use of cached results, for the record; absent if none was used or refused.
    #[must_use]
    pub fn on_record(&self, place: CacheLocation) -> Option<CachedResultUse> {
        let mut kinds: Vec<CachedWorkKind> = self.used.iter().map(|result| result.work).collect();
        kinds.sort_unstable();
        kinds.dedup();
        let block = |work: CachedWorkKind| {
            let of_kind = || self.used.iter().filter(move |result| result.work == work);
            let rerun = self.equal.iter().filter_map(|place| self.used.get(*place));
            CachedResultBlock {
                work,
                seeds: SeedRange::of(of_kind().map(|result| result.seed)),
                own: u32::try_from(of_kind().filter(|result| result.own).count()).unwrap_or(u32::MAX),
                digest: digest(of_kind()),
                rerun: SeedRange::of(rerun.filter(|result| result.work == work).map(|result| result.seed)),
            }
        };
        let blocks: Vec<CachedResultBlock> = kinds.into_iter().map(block).collect();
        let has_content = !blocks.is_empty() || self.refused > 0;
        has_content.then_some(CachedResultUse { place, blocks, refused: self.refused })
    }
}

fn digest<'a>(results: impl Iterator<Item = &'a ReusedResult>) -> Digest {
    let values: Vec<&[u8]> = results.map(|result| result.value.bytes().as_slice()).collect();
    Digest::of_parts("holdpoint.kept-block.v1", &values)
}
