//! One comparison of a candidate with another version: paired episodes and recovery drills, raced.
//!
//! The two kinds of evidence take turns, so that a candidate that is lost on either is known early: twenty
//! pairs, ten drills, and a look after each. Only a rejection can come early. What advances has worked the
//! whole budget. Source: design rules 3.4, 3.5, 5.3; reference section 4.1.

use crate::fault::Fault;
use crate::trial::drills::DrillResult;
use crate::trial::lab::{Lab, Outlook, Party};
use crate::trial::reuse::Reuse;
use crate::trial::seeds::{Purpose, episode_seed};
use holdpoint_governance::behavior::{self, BehaviorAssessment};
use holdpoint_governance::composition::recovery_is_reviewable;
use holdpoint_governance::ended::EndReason;
use holdpoint_governance::evidence::{
    Binding, DrillKind, DrillTally, Drills, HardStop, Pair, PairedEvidence, RecoveryEvidence,
};
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
                    tally(self.drills.0.of_mut(kind), &[DrillResult::Passed]);
                    tally(self.drills.1.of_mut(kind), &[DrillResult::Passed]);
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

    fn pair_slice(
        &mut self,
        lab: &Lab<'_>,
        candidate: &Party,
        active: &Party,
    ) -> Result<Option<Vec<(TaskRecord, TaskRecord)>>, Fault> {
        let seeds = self.seeds(lab, &self.standing(), NextSlice::Pairs);
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
        let seeds = self.seeds(lab, &self.standing(), NextSlice::Drills(kind));
        let open = seeds.get(self.part.drills.0.len()..).unwrap_or_default();
        let next = open.get(..open.len().min(lab.part)).unwrap_or_default();
        let worked = lab.drills(candidate, active, kind, next, &mut self.reuse)?;
        self.part.drills.0.extend(worked.0);
        self.part.drills.1.extend(worked.1);
        if self.part.drills.0.len() < seeds.len() {
            return Ok(false);
        }
        let (of_candidate, of_active) = std::mem::take(&mut self.part.drills);
        self.drills_tried[kind as usize] += DRILLS_A_SLICE;
        tally(self.drills.0.of_mut(kind), &of_candidate);
        tally(self.drills.1.of_mut(kind), &of_active);
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

    fn seeds(&self, lab: &Lab<'_>, standing: &Reached, slice: NextSlice) -> Vec<u64> {
        let purpose = match slice {
            NextSlice::Pairs => self.plan.pair_seeds,
            NextSlice::Drills(_) => self.plan.drill_seeds,
        };
        let range = standing.range(&self.plan, slice);
        range.map(|index| episode_seed(lab.seed, purpose, index)).collect()
    }

    /// What will be asked for after the slice at hand, the rest of it included, if nothing ends the evaluation and no
    /// drill fails; in the parts in which the lab is asked.
    fn outlook(&self, lab: &Lab<'_>, slice: NextSlice) -> Vec<Outlook> {
        let mut standing = self.standing();
        let mut worked = self.part.pairs.len().max(self.part.drills.0.len());
        let (mut next, mut slices) = (Some(slice), Vec::new());
        for _ in 0..=SLICES_AHEAD {
            let Some(slice) = next else { break };
            let seeds = self.seeds(lab, &standing, slice);
            let open = seeds.get(worked..).unwrap_or_default();
            slices.extend(open.chunks(lab.part.max(1)).map(|part| match slice {
                NextSlice::Pairs => Outlook::Pairs(part.to_vec()),
                NextSlice::Drills(kind) => Outlook::Drills(kind, part.to_vec()),
            }));
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

fn tally(tally: &mut DrillTally, results: &[DrillResult]) {
    for result in results {
        let count = match result {
            DrillResult::Passed => &mut tally.passed,
            DrillResult::Failed => &mut tally.failed,
            DrillResult::Infeasible => &mut tally.infeasible,
        };
        *count = count.saturating_add(1);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cell::Cell;
    use crate::trial::crew::Crew;
    use crate::trial::seeds::CALIBRATION_FROM_RUN;
    use crate::trial::undisturbed::Shelf;
    use holdpoint_governance::ids::Digest;
    use holdpoint_governance::policy::PolicyTable;
    use holdpoint_governance::profile::ProfileName;
    use holdpoint_registry::Store;
    use holdpoint_runtime::capability::{self, Capability};
    use holdpoint_runtime::terms::SkillTerms;
    use std::path::Path;
    use std::sync::Arc;
    use std::sync::atomic::AtomicBool;

    fn small() -> Profile {
        let mut profile = Profile::builtin(ProfileName::Sim).unwrap();
        profile.evaluation.sandbox_pairs = 50;
        profile.evaluation.drills_per_kind = 20;
        profile
    }

    fn binding() -> Binding {
        let digest = Digest::of_parts("test", &[]);
        Binding { candidate: digest, active: None, profile: digest, policy: digest, environment: digest }
    }

    /// Both versions on calibration seeds, from their folders under `manifests/`.
    fn evaluate(candidate: &str, active: &str, profile: &Profile) -> (Evaluation, Vec<String>) {
        evaluate_in_parts(candidate, active, profile, usize::MAX)
    }

    fn evaluate_in_parts(
        candidate: &str,
        active: &str,
        profile: &Profile,
        part: usize,
    ) -> (Evaluation, Vec<String>) {
        let cell = Cell::builtin().unwrap();
        let table = Arc::new(PolicyTable::builtin(profile).unwrap());
        let terms = SkillTerms::new(profile, table, cell.geometry.clone(), cell.zones.clone());
        let party = |folder: &str| {
            let manifests = Path::new(crate::MANIFESTS);
            let path = manifests.join(folder);
            let version = Capability::load(folder, capability::read(&path).unwrap()).unwrap();
            let park = Capability::load("park", capability::read(&manifests.join("park/1.0.0")).unwrap());
            Party { version, terms: terms.clone(), fallback: park.ok() }
        };
        let folder = tempfile::tempdir().unwrap();
        let store = Store::open(folder.path()).unwrap();
        let cancel = AtomicBool::new(false);
        let lab = Lab {
            seed: CALIBRATION_FROM_RUN + 1,
            crew: &Crew::new(2),
            undisturbed: &Arc::new(Shelf::new()),
            part,
            cancel: &cancel,
            cell: &cell,
            cells: store.cells(),
        };
        let (candidate, active) = (party(candidate), party(active));
        let mut evaluation = Evaluation::new(Plan::sandbox(profile), binding(), Vec::new());
        let mut order = Vec::new();
        while evaluation.ended().is_none() {
            let step = evaluation.step(&lab, &candidate, &active, profile).unwrap();
            order.extend(step.map(|slice| slice.what));
        }
        (evaluation, order)
    }

    #[test]
    fn pairs_and_drills_take_turns_until_the_budget_is_worked() {
        let profile = small();
        let (evaluation, order) = evaluate("align/1.0.0", "align/1.0.0", &profile);
        assert_eq!(evaluation.ended(), Some(EndReason::Full));
        let pairs = evaluation.paired().pairs;
        assert_eq!(pairs.len(), 50);
        assert!(pairs.iter().all(|pair| pair.active == pair.candidate), "one version against itself");
        let rehearsed = evaluation.rehearsed();
        assert_eq!(evaluation.done(), evaluation.plan.budget());
        for kind in DrillKind::ALL {
            assert!(rehearsed.candidate.of(kind).feasible() >= 20, "{kind:?}");
        }
        let first = ["paired episodes", "rollback drills", "paired episodes", "fallback drills"];
        assert_eq!(order[..4], first);
        assert_eq!(order.iter().filter(|what| *what == "paired episodes").count(), 3);
    }

    #[test]
    fn a_candidate_that_cannot_stop_is_lost_early() {
        let profile = small();
        let (evaluation, _) = evaluate("candidates/align-no-stop", "align/1.0.0", &profile);
        assert!(matches!(
            evaluation.ended(),
            Some(EndReason::HardStop | EndReason::Curtailed | EndReason::FinitePopulation { .. })
        ));
        assert!(evaluation.done() < evaluation.plan.budget(), "{} done", evaluation.done());
        let (_, recovery) = evaluation.assess(&profile);
        assert_eq!(recovery.assessment.outcome, holdpoint_governance::outcome::RecoveryOutcome::Incompatible);
    }

    #[test]
    fn parts_of_a_slice_change_no_result() {
        let mut profile = small();
        profile.evaluation.sandbox_pairs = 20;
        profile.evaluation.drills_per_kind = 10;
        let (whole, order) = evaluate("align/1.0.0", "align/1.0.0", &profile);
        let (parts, same) = evaluate_in_parts("align/1.0.0", "align/1.0.0", &profile, 3);
        assert_eq!(order, same);
        assert_eq!(whole.paired(), parts.paired());
        assert_eq!(whole.rehearsed(), parts.rehearsed());
    }

    #[test]
    fn what_is_tried_again_does_not_exceed_the_budget() {
        let mut evaluation = Evaluation::new(Plan::sandbox(&small()), binding(), Vec::new());
        evaluation.drills_tried = [10, 20, 30, 40];
        assert_eq!((evaluation.tried(), evaluation.done()), (100, 10 + 3 * 20));
    }

    #[test]
    fn a_hard_stop_before_the_first_pair_ends_it() {
        let evaluation = Evaluation::new(Plan::sandbox(&small()), binding(), vec![HardStop::MotionAfterStop]);
        assert_eq!(evaluation.ended(), Some(EndReason::HardStop));
    }
}
