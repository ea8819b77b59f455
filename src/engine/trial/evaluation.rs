//! One comparison of a candidate with another version: paired episodes and recovery drills, raced.
//!
//! The two kinds of evidence take turns, so that a candidate that is lost on either is known early: twenty
//! pairs, ten drills, and a look after each. Only a rejection can come early. What advances has worked the
//! whole budget. Source: design rules 3.4, 3.5, 5.3; reference section 4.1.

use crate::fault::Fault;
use crate::trial::drills::DrillResult;
use crate::trial::lab::{DrillSpot, Lab, Outlook, Party};
use crate::trial::reuse::Reuse;
use crate::trial::seeds::{Purpose, episode_seed};
use holdpoint_governance::behavior::{self, BehaviorAssessment};
use holdpoint_governance::composition::recovery_is_reviewable;
use holdpoint_governance::ended::EndReason;
use holdpoint_governance::evidence::{
    Binding, DrillKind, DrillTally, Drills, HardStop, Pair, PairedEvidence, RecoveryEvidence,
};
use holdpoint_governance::phase::WorkPhase;
use holdpoint_governance::profile::Profile;
use holdpoint_governance::recovery::{self, RecoveryAssessment};
use holdpoint_runtime::task::TaskRecord;

/// Pairs in one slice of work.
const PAIRS_A_SLICE: u64 = 20;

/// Drills in one slice of work.
const DRILLS_A_SLICE: u64 = 10;

/// Failed drills of a kind from which it may be suspected.
const SUSPECT_FROM: u32 = 5;

/// Most episodes and drills tried for the budget: some have no valid start.
const ATTEMPTS_FACTOR: u64 = 2;

/// Pieces of the active version's undisturbed work in which its phases are looked for, on the first seeds of the drills.
const PHASE_PROBES: u64 = 5;

/// Pieces of them in which a phase has to show: one that a fifth of all seeds lack still gets its quota, because twice
/// the budget is tried.
const PHASE_SHOWN_IN: usize = 4;

/// What is to be worked, and on which seeds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Plan {
    pub pairs: u32,
    /// Feasible drills of each kind, for both versions.
    pub drills: u32,
    /// Seeds of the pairs.
    pub pair_seeds: Purpose,
    /// Seeds of the drills.
    pub drill_seeds: Purpose,
}

impl Plan {
    /// The sandbox's plan under a profile.
    #[must_use]
    pub const fn sandbox(profile: &Profile) -> Self {
        Self {
            pairs: profile.evaluation.sandbox_pairs,
            drills: profile.evaluation.drills_per_kind,
            pair_seeds: Purpose::Perturbation,
            drill_seeds: Purpose::Drill,
        }
    }

    /// The same budget on seeds that the sandbox did not use.
    #[must_use]
    pub const fn confirmation(profile: &Profile) -> Self {
        Self {
            pair_seeds: Purpose::Confirmation,
            drill_seeds: Purpose::ConfirmationDrill,
            ..Self::sandbox(profile)
        }
    }

    /// Pairs and drills together.
    #[must_use]
    pub fn budget(&self) -> u64 {
        u64::from(self.pairs) + DrillKind::ALL.len() as u64 * u64::from(self.drills)
    }
}

/// What the next slice is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum NextSlice {
    Pairs,
    Drills(DrillKind),
}

/// Slices that are worked ahead of what is asked for.
const SLICES_AHEAD: usize = 2;

/// How far an evaluation has come: whose turn it is follows from this and the plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Reached {
    pairs: u64,
    pairs_tried: u64,
    drills: (Drills, Drills),
    drills_tried: [u64; DrillKind::ALL.len()],
    turns: usize,
}

impl Reached {
    /// Pairs and drills take turns while both are left; the kinds of drills take turns among themselves. A kind
    /// that mostly fails goes first: the order within a kind stays as it was committed to, so that both stopping
    /// rules hold, and a candidate that cannot recover is known sooner.
    fn next(&self, plan: &Plan) -> Option<NextSlice> {
        let left = |kind: &DrillKind| {
            let feasible = self.drills.0.of(*kind).feasible().min(self.drills.1.of(*kind).feasible());
            feasible < plan.drills
                && self.drills_tried[*kind as usize] < ATTEMPTS_FACTOR * u64::from(plan.drills)
        };
        let kinds = DrillKind::ALL;
        let drill =
            (0..kinds.len()).map(|step| kinds[(self.turns / 2 + step) % kinds.len()]).find(|kind| left(kind));
        let suspect = kinds.into_iter().filter(left).find(|kind| {
            let tally = self.drills.0.of(*kind);
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
            (false, None) => None,
        }
    }

    /// The seeds of a slice, as places among its purpose's.
    fn range(&self, plan: &Plan, slice: NextSlice) -> std::ops::Range<u64> {
        match slice {
            NextSlice::Pairs => {
                let missing = u64::from(plan.pairs).saturating_sub(self.pairs);
                self.pairs_tried..self.pairs_tried + PAIRS_A_SLICE.min(missing)
            }
            NextSlice::Drills(kind) => {
                let tried = self.drills_tried[kind as usize];
                tried..tried + DRILLS_A_SLICE
            }
        }
    }

    /// Takes a slice for worked, and everything in it for feasible and passed.
    fn suppose(&mut self, plan: &Plan, slice: NextSlice) {
        let range = self.range(plan, slice);
        self.turns += 1;
        match slice {
            NextSlice::Pairs => {
                self.pairs += range.end - range.start;
                self.pairs_tried = range.end;
            }
            NextSlice::Drills(kind) => {
                self.drills_tried[kind as usize] = range.end;
                for _ in range {
                    tally(&mut self.drills.0, kind, &[], &[DrillResult::Passed]);
                    tally(&mut self.drills.1, kind, &[], &[DrillResult::Passed]);
                }
            }
        }
    }
}

/// What one slice did.
#[derive(Debug)]
pub struct Slice {
    pub what: String,
    /// Pairs or drills worked in this slice.
    pub worked: u64,
    /// Pairs and drills worked so far.
    pub done: u64,
    /// The records of both versions, candidate first; empty for drills.
    pub records: Vec<(TaskRecord, TaskRecord)>,
}

/// A comparison under way.
#[derive(Clone, Debug)]
pub struct Evaluation {
    plan: Plan,
    binding: Binding,
    pairs: Vec<Pair>,
    hard_stops: Vec<HardStop>,
    /// The phases that drills are dealt round, once they are known.
    phases: Option<Vec<WorkPhase>>,
    drills: (Drills, Drills),
    pairs_tried: u64,
    drills_tried: [u64; DrillKind::ALL.len()],
    turns: usize,
    ended: Option<EndReason>,
    part: PartialSlice,
    reuse: Reuse,
}

/// What is worked of a slice that is not whole yet.
#[derive(Clone, Debug, Default)]
struct PartialSlice {
    pairs: Vec<(TaskRecord, TaskRecord)>,
    drills: (Vec<DrillResult>, Vec<DrillResult>),
}

impl Evaluation {
    /// Nothing worked yet. `hard_stops` are those seen before the first pair.
    #[must_use]
    pub fn new(plan: Plan, binding: Binding, hard_stops: Vec<HardStop>) -> Self {
        let ended = (!hard_stops.is_empty()).then_some(EndReason::HardStop);
        Self {
            plan,
            binding,
            pairs: Vec::new(),
            hard_stops,
            phases: None,
            drills: (Drills::default(), Drills::default()),
            pairs_tried: 0,
            drills_tried: [0; DrillKind::ALL.len()],
            turns: 0,
            ended,
            part: PartialSlice::default(),
            reuse: Reuse::default(),
        }
    }

    /// How its work ended; absent while there is some left.
    #[must_use]
    pub const fn ended(&self) -> Option<EndReason> {
        self.ended
    }

    /// Whether it can be decided by: its work has ended, and what was kept of it has stood its spot check.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.ended.is_some() && self.reuse.is_checked() && !self.is_refuted()
    }

    /// Whether kept results that it rests on are false: nothing may be concluded from it.
    #[must_use]
    pub fn is_refuted(&self) -> bool {
        self.reuse.false_ones().next().is_some()
    }

    /// Takes in hard stops that were seen beside it: one is enough to end it.
    pub fn note_hard_stops(&mut self, seen: impl IntoIterator<Item = HardStop>) {
        let before = self.hard_stops.len();
        self.hard_stops.extend(seen);
        if self.hard_stops.len() > before {
            self.ended = Some(EndReason::HardStop);
        }
    }

    /// What of it was kept from before.
    #[must_use]
    pub const fn reuse(&self) -> &Reuse {
        &self.reuse
    }

    /// The pairs so far, as the rules read them.
    #[must_use]
    pub fn paired(&self) -> PairedEvidence {
        PairedEvidence {
            binding: self.binding,
            pairs: self.pairs.clone(),
            hard_stops: self.hard_stops.clone(),
        }
    }

    /// The drills so far, as the rules read them.
    #[must_use]
    pub const fn rehearsed(&self) -> RecoveryEvidence {
        RecoveryEvidence { binding: self.binding, candidate: self.drills.0, active: self.drills.1 }
    }

    /// How much of the budget is worked: what had no valid start and is tried again on another seed counts once.
    #[must_use]
    pub fn done(&self) -> u64 {
        let budget = u64::from(self.plan.drills);
        self.pairs.len() as u64 + self.drills_tried.iter().map(|tried| budget.min(*tried)).sum::<u64>()
    }

    /// Pairs and drills worked, each try.
    fn tried(&self) -> u64 {
        self.pairs_tried + self.drills_tried.iter().sum::<u64>()
    }

    /// Works one slice and looks whether the rest can still matter. `None`: the lab works in parts, and the slice
    /// is not whole yet; nothing has changed but what is kept of it. How a slice is cut changes no result. Once the
    /// work has ended, a part of what was kept is run again.
    ///
    /// # Errors
    /// If the lab fails; nothing is concluded from the slice then.
    pub fn step(
        &mut self,
        lab: &Lab<'_>,
        candidate: &Party,
        active: &Party,
        profile: &Profile,
    ) -> Result<Option<Slice>, Fault> {
        if self.ended.is_some() {
            self.reuse.check_part(lab, active)?;
            return Ok(None);
        }
        if self.phases.is_none() {
            self.phases = Some(self.phases_of(lab, active)?);
        }
        let mut records = Vec::new();
        let before = self.tried();
        let turn = self.next_turn();
        if let Some(slice) = turn {
            lab.expect(candidate, active, &self.outlook(lab, slice))?;
        }
        let what = match turn {
            Some(NextSlice::Pairs) => {
                let Some(worked) = self.pair_slice(lab, candidate, active)? else { return Ok(None) };
                records = worked;
                "paired episodes".to_owned()
            }
            Some(NextSlice::Drills(kind)) => {
                if !self.drill_slice(lab, candidate, active, kind)? {
                    return Ok(None);
                }
                format!("{} drills", kind.name())
            }
            None => "nothing is left".to_owned(),
        };
        self.turns += 1;
        self.look(profile);
        if self.ended.is_some() {
            lab.expect(candidate, active, &[])?;
        }
        Ok(Some(Slice { what, worked: self.tried() - before, done: self.done(), records }))
    }

    /// The phases that the active version's work shows, of which every kind of drill gets its quota.
    fn phases_of(&self, lab: &Lab<'_>, active: &Party) -> Result<Vec<WorkPhase>, Fault> {
        let seeds: Vec<u64> =
            (0..PHASE_PROBES).map(|index| episode_seed(lab.seed, self.plan.drill_seeds, index)).collect();
        let shown = lab.phases(active, &seeds)?;
        let is_shown = |phase: &WorkPhase| {
            shown.iter().filter(|phases| phases.contains(phase)).count() >= PHASE_SHOWN_IN
        };
        Ok(WorkPhase::ALL.into_iter().filter(is_shown).collect())
    }

    fn pair_slice(
        &mut self,
        lab: &Lab<'_>,
        candidate: &Party,
        active: &Party,
    ) -> Result<Option<Vec<(TaskRecord, TaskRecord)>>, Fault> {
        let seeds = self.seeds(lab, &self.standing());
        let open = seeds.get(self.part.pairs.len()..).unwrap_or_default();
        let next = open.get(..open.len().min(lab.part)).unwrap_or_default();
        let worked = lab.pairs(candidate, active, next, &mut self.reuse)?;
        self.part.pairs.extend(worked);
        if self.part.pairs.len() < seeds.len() {
            return Ok(None);
        }
        let records = std::mem::take(&mut self.part.pairs);
        self.pairs_tried += seeds.len() as u64;
        for (new, old) in &records {
            self.hard_stops.extend(new.hard_stop);
            if let (Some(candidate), Some(active)) = (new.values(), old.values()) {
                self.pairs.push(Pair { seed: new.seed, active, candidate });
            }
        }
        Ok(Some(records))
    }

    /// Tells whether the slice is whole.
    fn drill_slice(
        &mut self,
        lab: &Lab<'_>,
        candidate: &Party,
        active: &Party,
        kind: DrillKind,
    ) -> Result<bool, Fault> {
        let spots = self.spots(lab, &self.standing(), kind);
        let open = spots.get(self.part.drills.0.len()..).unwrap_or_default();
        let next = open.get(..open.len().min(lab.part)).unwrap_or_default();
        let worked = lab.drills(candidate, active, kind, next, &mut self.reuse)?;
        self.part.drills.0.extend(worked.0);
        self.part.drills.1.extend(worked.1);
        if self.part.drills.0.len() < spots.len() {
            return Ok(false);
        }
        let (of_candidate, of_active) = std::mem::take(&mut self.part.drills);
        self.drills_tried[kind as usize] += DRILLS_A_SLICE;
        tally(&mut self.drills.0, kind, &spots, &of_candidate);
        tally(&mut self.drills.1, kind, &spots, &of_active);
        Ok(true)
    }

    const fn standing(&self) -> Reached {
        Reached {
            pairs: self.pairs.len() as u64,
            pairs_tried: self.pairs_tried,
            drills: self.drills,
            drills_tried: self.drills_tried,
            turns: self.turns,
        }
    }

    fn next_turn(&self) -> Option<NextSlice> {
        self.standing().next(&self.plan)
    }

    fn seeds(&self, lab: &Lab<'_>, standing: &Reached) -> Vec<u64> {
        let range = standing.range(&self.plan, NextSlice::Pairs);
        range.map(|index| episode_seed(lab.seed, self.plan.pair_seeds, index)).collect()
    }

    /// Where the drills of a slice begin: dealt round the phases by their place, and so the same for both versions.
    fn spots(&self, lab: &Lab<'_>, standing: &Reached, kind: DrillKind) -> Vec<DrillSpot> {
        let phases = self.phases.as_deref().unwrap_or_default();
        let spot = |index: u64| {
            let turn = index.checked_rem(phases.len() as u64).and_then(|turn| usize::try_from(turn).ok());
            let seed = episode_seed(lab.seed, self.plan.drill_seeds, index);
            DrillSpot { seed, phase: turn.and_then(|turn| phases.get(turn).copied()) }
        };
        standing.range(&self.plan, NextSlice::Drills(kind)).map(spot).collect()
    }

    /// What will be asked for after the slice at hand, the rest of it included, if nothing ends the evaluation and no
    /// drill fails; in the parts in which the lab is asked.
    fn outlook(&self, lab: &Lab<'_>, slice: NextSlice) -> Vec<Outlook> {
        let mut standing = self.standing();
        let mut worked = self.part.pairs.len().max(self.part.drills.0.len());
        let (mut next, mut slices) = (Some(slice), Vec::new());
        for _ in 0..=SLICES_AHEAD {
            let Some(slice) = next else { break };
            let part = lab.part.max(1);
            match slice {
                NextSlice::Pairs => {
                    let seeds = self.seeds(lab, &standing);
                    let open = seeds.get(worked..).unwrap_or_default();
                    slices.extend(open.chunks(part).map(|part| Outlook::Pairs(part.to_vec())));
                }
                NextSlice::Drills(kind) => {
                    let spots = self.spots(lab, &standing, kind);
                    let open = spots.get(worked..).unwrap_or_default();
                    slices.extend(open.chunks(part).map(|part| Outlook::Drills(kind, part.to_vec())));
                }
            }
            worked = 0;
            standing.suppose(&self.plan, slice);
            next = standing.next(&self.plan);
        }
        slices
    }

    fn look(&mut self, profile: &Profile) {
        let early = |ended: &EndReason| *ended != EndReason::Full;
        self.ended = behavior::ended(&self.paired(), &self.binding, profile)
            .filter(early)
            .or_else(|| self.recovery_ended(profile).filter(early))
            .or_else(|| self.next_turn().is_none().then_some(EndReason::Full));
    }

    /// A lost recovery ends the evaluation, unless people may still be asked about it: they are shown behaviour
    /// measured over its whole budget.
    fn recovery_ended(&self, profile: &Profile) -> Option<EndReason> {
        let rehearsed = self.rehearsed();
        let ended = recovery::ended(&rehearsed, &self.binding, profile)?;
        let result = recovery::assess_ended(&rehearsed, &self.binding, profile, ended);
        let reviewable = profile.has_approver() && recovery_is_reviewable(&result.assessment);
        (!reviewable).then_some(ended)
    }

    /// What the rules make of what was worked. An early end counts for the dimension that bears it out; the other
    /// one has then less than its budget and says so.
    #[must_use]
    pub fn assess(&self, profile: &Profile) -> (BehaviorAssessment, RecoveryAssessment) {
        let ended = self.ended.unwrap_or(EndReason::Full);
        (
            behavior::assess_ended(&self.paired(), &self.binding, profile, ended),
            recovery::assess_ended(&self.rehearsed(), &self.binding, profile, ended),
        )
    }
}

/// Counts drills of one kind, each where it began.
fn tally(drills: &mut Drills, kind: DrillKind, spots: &[DrillSpot], results: &[DrillResult]) {
    for (place, result) in results.iter().enumerate() {
        count(drills.of_mut(kind), *result);
        if let Some(phase) = spots.get(place).and_then(|spot| spot.phase) {
            count(drills.phases.of_mut(kind, phase), *result);
        }
    }
}

const fn count(tally: &mut DrillTally, result: DrillResult) {
    let count = match result {
        DrillResult::Passed => &mut tally.passed,
        DrillResult::Failed => &mut tally.failed,
        DrillResult::Infeasible => &mut tally.infeasible,
    };
    *count = count.saturating_add(1);
}

#[cfg(test)]
mod tests;
