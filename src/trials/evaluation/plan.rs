//! The jobs of an evaluation, their order and their seeds. Knows counts and no results.

use super::drill_slices::tally;
use crate::drills::DrillResult;
use crate::seeds::SeedPurpose;
use holdpoint_cell::rng::Stream;
use holdpoint_governance::behavior::live_like_pairs;
use holdpoint_governance::evidence::{DrillKind, RecoveryEvidence};
use holdpoint_governance::profile::{Profile, RecoverySettings};
use holdpoint_governance::recovery::{DrillContrast, SETTLED_KINDS, clean_drills};
use holdpoint_protocol::work_unit::PartCount;

/// Pairs in one slice of work.
const PAIRS_A_SLICE: u64 = 20;

/// Drills in one slice of work.
const DRILLS_A_SLICE: u64 = 10;

/// Failed drills of a kind from which it may be suspected.
const SUSPECT_FROM: u32 = 5;

/// Most episodes and drills tried for the budget: some have no valid start.
const ATTEMPTS_FACTOR: u64 = 2;

/// Pairs of sequences in one slice of work.
const SEQUENCES_A_SLICE: u64 = 10;

/// The jobs and their seeds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EvaluationPlan {
    pub pairs: u32,
    /// Of them, those from live starts.
    pub live_like: u32,
    /// Feasible drills of each kind, for both versions.
    pub drills: u32,
    /// Seeds of the pairs.
    pub pair_seeds: SeedPurpose,
    /// Seeds of the drills.
    pub drill_seeds: SeedPurpose,
    /// Pairs of whole sequences, if pairs and drills reject nothing.
    pub sequences: u32,
    /// Seeds of the sequences.
    pub sequence_seeds: SeedPurpose,
    /// The anchor runs the pairs' seeds too, if pairs and drills reject nothing.
    pub has_anchor: bool,
    /// Failed stops and rollbacks are settled by more drills, likewise.
    pub is_settling: bool,
    /// By which numbers they are settled.
    pub recovery: RecoverySettings,
}

impl EvaluationPlan {
    /// The sandbox's plan under a profile.
    #[must_use]
    pub const fn sandbox(profile: &Profile) -> Self {
        Self {
            pairs: profile.evaluation.sandbox_pairs,
            live_like: live_like_pairs(profile.evaluation.sandbox_pairs),
            drills: profile.evaluation.drills_per_kind,
            pair_seeds: SeedPurpose::Perturbation,
            drill_seeds: SeedPurpose::Drill,
            sequences: profile.evaluation.sandbox_sequences,
            sequence_seeds: SeedPurpose::Sequence,
            has_anchor: false,
            is_settling: true,
            recovery: profile.recovery,
        }
    }

    /// The same with an anchor to compare with, or without.
    #[must_use]
    pub const fn with_anchor(self, has_anchor: bool) -> Self {
        Self { has_anchor, ..self }
    }

    /// The same with the pairs of a look of a counted try.
    #[must_use]
    pub const fn with_pairs(self, pairs: u32) -> Self {
        Self { pairs, live_like: live_like_pairs(pairs), ..self }
    }

    /// The same budget on seeds that the sandbox did not use.
    #[must_use]
    pub const fn confirmation(profile: &Profile) -> Self {
        Self {
            pair_seeds: SeedPurpose::Confirmation,
            drill_seeds: SeedPurpose::ConfirmationDrill,
            sequence_seeds: SeedPurpose::ConfirmationSequence,
            is_settling: false,
            ..Self::sandbox(profile)
        }
    }

    /// The pairs and sequences of that budget, on seeds that neither used. Drills know no live conditions. All pairs have
    /// the live distribution then.
    #[must_use]
    pub const fn re_evaluation(profile: &Profile) -> Self {
        Self {
            live_like: 0,
            drills: 0,
            pair_seeds: SeedPurpose::ReEvaluation,
            sequence_seeds: SeedPurpose::ReEvaluationSequence,
            ..Self::confirmation(profile)
        }
    }

    /// Which of the pairs are live-like. The first pair's seed chooses the places, each as likely as any other. So the pairs
    /// come in a random order of their whole budget, on which an early end rests.
    pub(super) fn live_like_places(&self, first_seed: u64) -> Vec<bool> {
        let mut stream = Stream::from_state(first_seed ^ 0x11fe_11ce_0000_0001);
        let mut wanted = self.live_like;
        let mut is_chosen = |left: u32| {
            let is_chosen = stream.unit() * f64::from(left) < f64::from(wanted);
            wanted -= u32::from(is_chosen);
            is_chosen
        };
        (0..self.pairs).map(|place| is_chosen(self.pairs - place)).collect()
    }

    /// Pairs, drills, the anchor's episodes and sequences together, if no failed drill needs more.
    #[must_use]
    pub fn budget(&self) -> u64 {
        let anchor = if self.has_anchor { u64::from(self.pairs) } else { 0 };
        let episodes = u64::from(self.pairs) + anchor + u64::from(self.sequences);
        let settling = SETTLED_KINDS.len() as u64 * self.settling_drills();
        episodes + DrillKind::ALL.len() as u64 * u64::from(self.drills) + settling
    }

    /// Drills of a settled kind past the base number, if none of them fails.
    pub(super) fn settling_drills(&self) -> u64 {
        let is_settled = self.is_settling && self.drills > 0;
        if is_settled { u64::from(clean_drills(&self.recovery).saturating_sub(self.drills)) } else { 0 }
    }
}

/// What the next slice is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum NextSlice {
    Pairs,
    Drills(DrillKind),
    /// Episodes of the anchor on the seeds of the pairs.
    Anchor,
    /// More drills of a kind.
    Settling(DrillKind),
    Sequences,
}

impl NextSlice {
    /// Whether it is for versions only that pairs and drills do not reject.
    pub(super) const fn is_late(self) -> bool {
        matches!(self, Self::Anchor | Self::Settling(_) | Self::Sequences)
    }
}

/// How far an evaluation has come: whose turn it is follows from this and the plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct EvaluationProgress {
    pub(super) pairs: u64,
    pub(super) pairs_tried: u64,
    pub(super) drills: RecoveryEvidence,
    pub(super) drills_tried: [u64; DrillKind::ALL.len()],
    /// Pairs whose seeds the anchor has run.
    pub(super) anchored: u64,
    pub(super) sequences: u64,
    pub(super) sequences_tried: u64,
    pub(super) turns: usize,
}

impl EvaluationProgress {
    /// Pairs and drills take turns while both are left; the kinds of drills take turns among themselves. A kind
    /// that mostly fails goes first: the order within a kind stays as it was committed to, so that both stopping
    /// rules hold, and a candidate that cannot recover is known sooner. The anchor, the settling of drills and sequences come last.
    pub(super) fn next(&self, plan: &EvaluationPlan) -> Option<NextSlice> {
        let left = |kind: &DrillKind| {
            let feasible =
                self.drills.candidate.of(*kind).feasible().min(self.drills.active.of(*kind).feasible());
            feasible < plan.drills
                && self.drills_tried[*kind as usize] < ATTEMPTS_FACTOR * u64::from(plan.drills)
        };
        let kinds = DrillKind::ALL;
        let drill =
            (0..kinds.len()).map(|step| kinds[(self.turns / 2 + step) % kinds.len()]).find(|kind| left(kind));
        let suspect = kinds.into_iter().filter(left).find(|kind| {
            let tally = self.drills.candidate.of(*kind);
            2 * tally.failed >= tally.feasible() && tally.failed >= SUSPECT_FROM
        });
        if let Some(kind) = suspect {
            return Some(NextSlice::Drills(kind));
        }
        let budget = u64::from(plan.pairs);
        let pairs = self.pairs < budget && self.pairs_tried < ATTEMPTS_FACTOR * budget;
        match (pairs, drill) {
            (true, Some(kind)) if self.turns % 2 == 1 => Some(NextSlice::Drills(kind)),
            (true, _) => Some(NextSlice::Pairs),
            (false, Some(kind)) => Some(NextSlice::Drills(kind)),
            (false, None) if plan.has_anchor && self.anchored < self.pairs => Some(NextSlice::Anchor),
            (false, None) => self.settling(plan).or_else(|| {
                let wanted = u64::from(plan.sequences);
                let left = self.sequences < wanted && self.sequences_tried < ATTEMPTS_FACTOR * wanted;
                left.then_some(NextSlice::Sequences)
            }),
        }
    }

    /// The settled kind with the fewest drills that wants more: in turns both use the same undisturbed runs.
    fn settling(&self, plan: &EvaluationPlan) -> Option<NextSlice> {
        let is_wanted = |kind: &DrillKind| {
            let contrast = DrillContrast::of(*kind, &self.drills);
            let wanted = contrast.drills_wanted(&plan.recovery);
            contrast.drills() < wanted
                && self.drills_tried[*kind as usize] < ATTEMPTS_FACTOR * u64::from(wanted)
        };
        let wanted = SETTLED_KINDS.into_iter().filter(is_wanted);
        let next = wanted.min_by_key(|kind| self.drills_tried[*kind as usize]);
        next.filter(|_| plan.is_settling && plan.drills > 0).map(NextSlice::Settling)
    }

    /// The seeds of a slice, as places among its purpose's.
    pub(super) fn range(&self, plan: &EvaluationPlan, slice: NextSlice) -> std::ops::Range<u64> {
        match slice {
            NextSlice::Pairs => {
                let missing = u64::from(plan.pairs).saturating_sub(self.pairs);
                self.pairs_tried..self.pairs_tried + PAIRS_A_SLICE.min(missing)
            }
            NextSlice::Anchor => self.anchored..self.pairs.min(self.anchored + PAIRS_A_SLICE),
            NextSlice::Drills(kind) | NextSlice::Settling(kind) => {
                let tried = self.drills_tried[kind as usize];
                tried..tried + DRILLS_A_SLICE
            }
            NextSlice::Sequences => {
                let missing = u64::from(plan.sequences).saturating_sub(self.sequences);
                self.sequences_tried..self.sequences_tried + SEQUENCES_A_SLICE.min(missing)
            }
        }
    }

    /// How much of the kind of a slice is worked, against the budget of that kind. What had no valid start does not count.
    pub(super) fn part(&self, plan: &EvaluationPlan, slice: NextSlice) -> PartCount {
        let (done, budget) = match slice {
            NextSlice::Pairs => (self.pairs, u64::from(plan.pairs)),
            NextSlice::Anchor => (self.anchored, self.pairs),
            NextSlice::Drills(kind) => {
                let (own, other) = (self.drills.candidate.of(kind), self.drills.active.of(kind));
                (u64::from(own.feasible().min(other.feasible())), u64::from(plan.drills))
            }
            NextSlice::Settling(kind) => {
                let contrast = DrillContrast::of(kind, &self.drills);
                (u64::from(contrast.drills()), u64::from(contrast.drills_wanted(&plan.recovery)))
            }
            NextSlice::Sequences => (self.sequences, u64::from(plan.sequences)),
        };
        PartCount { done: done.min(budget), budget }
    }

    /// Takes a slice for worked, and everything in it for feasible and passed.
    pub(super) fn suppose(&mut self, plan: &EvaluationPlan, slice: NextSlice) {
        let range = self.range(plan, slice);
        self.turns += 1;
        match slice {
            NextSlice::Pairs => {
                self.pairs += range.end - range.start;
                self.pairs_tried = range.end;
            }
            NextSlice::Anchor => self.anchored = range.end,
            NextSlice::Settling(kind) => self.drills_tried[kind as usize] = range.end,
            NextSlice::Drills(kind) => {
                self.drills_tried[kind as usize] = range.end;
                for _ in range {
                    tally(&mut self.drills.candidate, kind, &[], &[DrillResult::Passed]);
                    tally(&mut self.drills.active, kind, &[], &[DrillResult::Passed]);
                }
            }
            NextSlice::Sequences => {
                self.sequences += range.end - range.start;
                self.sequences_tried = range.end;
            }
        }
    }
}
