//! The cached results that one comparison used, and the spot check that must precede its decision.
//!
//! Results that this process worked itself are known to it. Of those that another process kept, so many are drawn at the
//! end, run again and compared bit for bit, that a block of which one in twenty is false shows it in 95 of 100
//! comparisons (`governance::stats::spot_check`). Draws and compares; what follows from a difference is for the stage.

use std::collections::{BTreeMap, BTreeSet};

use crate::fault::EngineFault;
use crate::trial::trial_lab::{DrillSpot, TrialLab, TrialSubject};
use holdpoint_governance::cached_result::{
    CacheLocation, CachedResultBlock, CachedResultMismatch, CachedResultUse, CachedWorkKind, SampleGroup,
    SeedRange,
};
use holdpoint_governance::ids::{CapabilityId, Digest};
use holdpoint_governance::phase::WorkPhase;
use holdpoint_governance::stats::spot_check::spot_check;

/// A result that was kept from before.
#[derive(Clone, Debug)]
pub struct ReusedResult {
    pub work: CachedWorkKind,
    /// Of a drill: the phase in which it began.
    pub phase: Option<WorkPhase>,
    pub seed: u64,
    /// Digest of its bytes.
    pub value: Digest,
    /// This process worked it itself.
    pub own: bool,
}

/// How far the spot check is.
#[derive(Clone, Debug, Default)]
enum SpotCheck {
    #[default]
    NotDrawn,
    /// Places among what was taken that are still to be run again, the last first.
    Drawn(Vec<usize>),
}

/// See the module's head.
#[derive(Clone, Debug, Default)]
pub struct Reuse {
    taken: Vec<ReusedResult>,
    refused: u32,
    check: SpotCheck,
    /// Places that came to the same.
    same: Vec<usize>,
    /// Places that came to something else.
    other: Vec<usize>,
}

/// Digest of a result's bytes.
#[must_use]
pub fn value(bytes: &[u8]) -> Digest {
    Digest::of_parts("holdpoint.kept-value.v1", &[bytes])
}

impl Reuse {
    pub fn take(&mut self, taken: ReusedResult) {
        self.taken.push(taken);
    }

    /// Notes an invalid entry in the place of a cached result.
    pub const fn refuse(&mut self) {
        self.refused = self.refused.saturating_add(1);
    }

    /// Whether no result is left to re-run. Later additions are not checked.
    #[must_use]
    pub fn is_checked(&self) -> bool {
        match &self.check {
            SpotCheck::NotDrawn => self.taken.iter().all(|taken| taken.own),
            SpotCheck::Drawn(left) => left.is_empty(),
        }
    }

    /// What came to something else than was kept, when it was run again.
    pub fn mismatches(&self) -> impl Iterator<Item = &ReusedResult> {
        self.other.iter().filter_map(|place| self.taken.get(*place))
    }

    /// Runs a part of what was drawn again; draws first, from everything that was taken.
    ///
    /// # Errors
    /// If the lab fails, or the system gives no random numbers.
    pub fn check_part(&mut self, lab: &TrialLab<'_>, active: &TrialSubject) -> Result<(), EngineFault> {
        if matches!(self.check, SpotCheck::NotDrawn) {
            self.check = SpotCheck::Drawn(self.sample_spot_check(lab)?);
        }
        let SpotCheck::Drawn(left) = &mut self.check else { return Ok(()) };
        let part = left.split_off(left.len().saturating_sub(lab.part));
        let taken: Vec<(usize, &ReusedResult)> =
            part.iter().filter_map(|place| Some((*place, self.taken.get(*place)?))).collect();
        let again = taken.iter().map(|(_, taken)| {
            let ReusedResult { work, phase, seed, .. } = **taken;
            (work, DrillSpot { seed, phase })
        });
        let again = lab.rerun_episodes(active, again)?;
        for ((place, taken), bytes) in taken.into_iter().zip(again) {
            if value(&bytes) == taken.value {
                if taken.work == CachedWorkKind::Episodes {
                    lab.confirm_episode(active, taken.seed, &bytes);
                }
                self.same.push(place);
            } else {
                self.other.push(place);
            }
        }
        Ok(())
    }

    /// Places to be run again: of episodes, drills and sequences so many that the check of each has its power.
    fn sample_spot_check(&self, lab: &TrialLab<'_>) -> Result<Vec<usize>, EngineFault> {
        let mut drawn = Vec::new();
        for of in SampleGroup::ALL {
            // Seeds may come round again in a large budget: one answer is enough.
            let mut seen = BTreeSet::new();
            let mut is_in = |taken: &ReusedResult| {
                let is_of = !taken.own && taken.work.sample_group() == of;
                is_of && seen.insert((taken.work, taken.seed))
            };
            let foreign: Vec<usize> =
                (0_usize..).zip(&self.taken).filter_map(|(place, one)| is_in(one).then_some(place)).collect();
            let wanted = spot_check(u32::try_from(foreign.len()).unwrap_or(u32::MAX));
            let block = digest(foreign.iter().filter_map(|place| self.taken.get(*place)));
            let wanted = usize::try_from(wanted).unwrap_or(usize::MAX);
            let places = lab.cells.secret().sample(&block, foreign.len(), wanted)?;
            drawn.extend(places.iter().filter_map(|place| foreign.get(*place)));
        }
        drawn.reverse();
        Ok(drawn)
    }

    /// The results that differ from their re-run, for the record.
    #[must_use]
    pub fn voided(&self, place: CacheLocation, active: &CapabilityId) -> CachedResultMismatch {
        let mut works: BTreeMap<CachedWorkKind, Vec<u64>> = BTreeMap::new();
        for taken in self.mismatches() {
            works.entry(taken.work).or_default().push(taken.seed);
        }
        let differing = works.into_iter().map(|(work, seeds)| (work, SeedRange::of(seeds))).collect();
        let rerun = (self.same.len() + self.other.len()) as u64;
        CachedResultMismatch { place, active: active.clone(), rerun, differing }
    }

    /// For the record; absent if nothing was kept.
    #[must_use]
    pub fn on_record(&self, place: CacheLocation) -> Option<CachedResultUse> {
        let mut works: Vec<CachedWorkKind> = self.taken.iter().map(|taken| taken.work).collect();
        works.sort_unstable();
        works.dedup();
        let block = |work: CachedWorkKind| {
            let of = || self.taken.iter().filter(move |taken| taken.work == work);
            let rerun = self.same.iter().filter_map(|place| self.taken.get(*place));
            CachedResultBlock {
                work,
                seeds: SeedRange::of(of().map(|taken| taken.seed)),
                own: u32::try_from(of().filter(|taken| taken.own).count()).unwrap_or(u32::MAX),
                digest: digest(of()),
                rerun: SeedRange::of(rerun.filter(|taken| taken.work == work).map(|taken| taken.seed)),
            }
        };
        let blocks: Vec<CachedResultBlock> = works.into_iter().map(block).collect();
        let used = !blocks.is_empty() || self.refused > 0;
        used.then_some(CachedResultUse { place, blocks, refused: self.refused })
    }
}

fn digest<'a>(taken: impl Iterator<Item = &'a ReusedResult>) -> Digest {
    let values: Vec<&[u8]> = taken.map(|taken| taken.value.bytes().as_slice()).collect();
    Digest::of_parts("holdpoint.kept-block.v1", &values)
}
