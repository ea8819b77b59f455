//! One comparison of a candidate with another version: paired episodes and recovery drills, raced.
//!
//! The two kinds of evidence take turns, so that a candidate that is lost on either is known early: twenty
//! pairs, ten drills, and a look after each. Only a rejection can come early. What advances has worked the
//! whole budget. Source: design rules 3.4, 3.5, 5.3; reference section 4.1.

mod drill_slices;
mod late;
mod pairs;
mod plan;

pub use plan::EvaluationPlan;
use plan::{EvaluationProgress, NextSlice};

use crate::drills::DrillResult;
use crate::fault::TrialFault;
use crate::reuse::Reuse;
use crate::scene_stops::SceneStops;
use crate::sequences::SequenceRecords;
use crate::trial_lab::{DrillSpot, Lookahead, TrialLab, TrialSubject};
use holdpoint_cell::EpisodeSetup;
use holdpoint_governance::behavior::{
    self, BehaviorAssessment, SequenceEvidence, SequencePair, SequenceStep,
};
use holdpoint_governance::comparison_evidence::ComparisonEvidence;
use holdpoint_governance::composition::recovery_is_reviewable;
use holdpoint_governance::early_stop::EarlyStopReason;
use holdpoint_governance::evidence::{
    AnchorEvidence, DrillKind, DrillTallies, EvidenceBinding, FailedDrill, Pair, PairedEvidence,
    RecoveryEvidence, SettlingTallies,
};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::phase::WorkPhase;
use holdpoint_governance::profile::Profile;
use holdpoint_governance::recovery::{self, RecoveryAssessment, SETTLED_KINDS};
use holdpoint_governance::shared_event::SceneKind;
use holdpoint_governance::tries::CountedTry;
use holdpoint_protocol::work_unit::{PartCount, WorkUnit};
use holdpoint_runtime::task::TaskRecord;

/// Pieces of the active version's undisturbed work in which its phases are looked for, on the first seeds of the drills.
const PHASE_PROBES: u64 = 5;

/// Pieces of them in which a phase has to show: one that a fifth of all seeds lack still gets its quota, because twice
/// the budget is tried.
const PHASE_SHOWN_IN: usize = 4;

/// Slices that are run ahead of the requests.
const SLICES_AHEAD: usize = 2;

/// What one slice did.
#[derive(Debug)]
pub struct Slice {
    pub what: WorkUnit,
    /// Pairs or drills worked in this slice.
    pub worked: u64,
    /// Pairs and drills worked so far.
    pub done: u64,
    /// Those of its kind, against the budget of that kind; absent if nothing was left.
    pub part: Option<PartCount>,
    /// Empty but for pairs.
    pub pairs: Vec<PairRun>,
}

/// One pair as it ran.
#[derive(Debug)]
pub struct PairRun {
    /// Everything that was drawn for it.
    pub setup: EpisodeSetup,
    pub candidate: TaskRecord,
    pub active: TaskRecord,
}

/// A comparison under way.
#[derive(Clone, Debug)]
pub struct Evaluation {
    plan: EvaluationPlan,
    binding: EvidenceBinding,
    /// The try that it counts as; absent outside the sandbox.
    pub counted: Option<CountedTry>,
    pairs: Vec<Pair>,
    stops: SceneStops,
    /// The phases that drills are dealt round, once they are known.
    phases: Option<Vec<WorkPhase>>,
    drills: (DrillTallies, DrillTallies),
    /// Drills past the base number.
    settling: SettlingTallies,
    /// The candidate's that did not pass, in the order they were worked; only the first are kept.
    failed: Vec<FailedDrill>,
    pairs_tried: u64,
    drills_tried: [u64; DrillKind::ALL.len()],
    /// Seeds of pairs that were tried before the second look of the try; absent until it begins.
    second_look_from: Option<u64>,
    /// Pairs and drills have rejected nothing: what is left is for such versions only.
    is_late: bool,
    /// The settling of drills is begun.
    is_settling: bool,
    /// Episodes of the anchor; absent if there is no other anchor, or they are not begun.
    anchor: Option<AnchorEvidence>,
    /// Pairs whose seeds the anchor has run.
    anchored: u64,
    /// Absent until they are begun.
    sequences: Option<SequenceEvidence>,
    sequences_tried: u64,
    turns: usize,
    ended: Option<EarlyStopReason>,
    part: PartialSlice,
    reuse: Reuse,
}

/// Results of a slice that is not complete yet.
#[derive(Clone, Debug, Default)]
struct PartialSlice {
    pairs: Vec<(TaskRecord, TaskRecord)>,
    drills: (Vec<DrillResult>, Vec<DrillResult>),
    anchor: Vec<TaskRecord>,
    sequences: Vec<SequenceRecords>,
}

impl Evaluation {
    /// Nothing worked yet. `stops` are those seen before the first pair.
    #[must_use]
    pub fn new(plan: EvaluationPlan, binding: EvidenceBinding, stops: SceneStops) -> Self {
        let ended = (!stops.own.is_empty()).then_some(EarlyStopReason::HardStop);
        Self {
            plan,
            binding,
            counted: None,
            pairs: Vec::new(),
            stops,
            phases: None,
            drills: (DrillTallies::default(), DrillTallies::default()),
            settling: SettlingTallies::default(),
            failed: Vec::new(),
            pairs_tried: 0,
            drills_tried: [0; DrillKind::ALL.len()],
            second_look_from: None,
            is_late: false,
            is_settling: false,
            anchor: None,
            anchored: 0,
            sequences: None,
            sequences_tried: 0,
            turns: 0,
            ended,
            part: PartialSlice::default(),
            reuse: Reuse::default(),
        }
    }

    /// How its work ended; absent while there is some left.
    #[must_use]
    pub const fn ended(&self) -> Option<EarlyStopReason> {
        self.ended
    }

    /// Whether it can be decided by: its work has ended, and what was kept of it has stood its spot check.
    #[must_use]
    pub fn is_over(&self) -> bool {
        self.ended.is_some() && self.reuse.is_checked() && !self.is_refuted()
    }

    /// Whether cached results that it rests on are false: it permits no conclusion then.
    #[must_use]
    pub fn is_refuted(&self) -> bool {
        self.reuse.mismatches().next().is_some()
    }

    /// Takes in a scene that ran beside it: one hard stop of the candidate alone is enough to end it.
    pub fn note_scene(
        &mut self,
        scene: SceneKind,
        candidate: &TaskRecord,
        active: &TaskRecord,
        profile: &Profile,
    ) {
        let before = self.stops.own.len();
        self.stops.note(scene, candidate, active, profile);
        if self.stops.own.len() > before {
            self.ended = Some(EarlyStopReason::HardStop);
        }
    }

    /// The hard stops so far.
    #[must_use]
    pub const fn stops(&self) -> &SceneStops {
        &self.stops
    }

    /// The jobs and their seeds.
    #[must_use]
    pub const fn plan(&self) -> &EvaluationPlan {
        &self.plan
    }

    /// What its evidence is bound to.
    #[must_use]
    pub const fn binding(&self) -> &EvidenceBinding {
        &self.binding
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
            hard_stops: self.stops.own.clone(),
        }
    }

    /// The drills so far, as the rules read them.
    #[must_use]
    pub const fn rehearsed(&self) -> RecoveryEvidence {
        let (candidate, active) = self.drills;
        RecoveryEvidence { binding: self.binding, candidate, active, settling: self.settling }
    }

    /// The candidate's drills that did not pass, the first ones.
    #[must_use]
    pub fn failed_drills(&self) -> &[FailedDrill] {
        &self.failed
    }

    /// The anchor's episodes so far, as the rules read them; absent until they are begun.
    #[must_use]
    pub const fn anchor(&self) -> Option<&AnchorEvidence> {
        self.anchor.as_ref()
    }

    /// The sequences so far, as the rules read them; absent until they are begun.
    #[must_use]
    pub const fn sequences(&self) -> Option<&SequenceEvidence> {
        self.sequences.as_ref()
    }

    /// How much of the budget is worked: what had no valid start and is tried again on another seed counts once.
    #[must_use]
    pub fn done(&self) -> u64 {
        let budget = |kind: DrillKind| {
            let settling = if SETTLED_KINDS.contains(&kind) { self.plan.settling_drills() } else { 0 };
            u64::from(self.plan.drills) + settling
        };
        let drills = DrillKind::ALL.iter().map(|kind| budget(*kind).min(self.drills_tried[*kind as usize]));
        self.pairs.len() as u64 + drills.sum::<u64>() + self.anchored + self.sequences_worked()
    }

    fn sequences_worked(&self) -> u64 {
        self.sequences.as_ref().map_or(0, |evidence| evidence.pairs.len() as u64)
    }

    /// Pairs, drills and sequences worked, each try.
    fn tried(&self) -> u64 {
        self.pairs_tried + self.drills_tried.iter().sum::<u64>() + self.anchored + self.sequences_tried
    }

    /// Works one slice and looks whether the rest can still matter. `None`: the lab works in parts, and the slice
    /// is not whole yet; nothing has changed but what is kept of it. How a slice is cut changes no result. Once the
    /// work has ended, a part of what was kept is run again.
    ///
    /// # Errors
    /// If the lab fails; nothing is concluded from the slice then.
    pub fn step(
        &mut self,
        lab: &TrialLab<'_>,
        candidate: &TrialSubject,
        active: &TrialSubject,
        profile: &Profile,
    ) -> Result<Option<Slice>, TrialFault> {
        if self.ended.is_some() {
            self.reuse.check_part(lab, active)?;
            return Ok(None);
        }
        if self.phases.is_none() {
            self.phases = Some(self.phases_of(lab, active)?);
        }
        let mut pairs = Vec::new();
        let before = self.tried();
        let turn = self.next_turn();
        if let Some(slice) = turn {
            lab.expect(candidate, active, &self.outlook(lab, slice))?;
        }
        let (is_whole, what) = match turn {
            Some(NextSlice::Pairs) => {
                let worked = self.pair_slice(lab, candidate, active, profile)?;
                let is_whole = worked.is_some();
                pairs = worked.unwrap_or_default();
                (is_whole, WorkUnit::PairedEpisodes)
            }
            Some(NextSlice::Drills(kind)) => {
                (self.drill_slice(lab, candidate, active, (kind, false))?, kind.into())
            }
            Some(NextSlice::Settling(kind)) => {
                (self.drill_slice(lab, candidate, active, (kind, true))?, kind.into())
            }
            Some(NextSlice::Anchor) => (self.anchor_slice(lab)?, WorkUnit::AnchorEpisodes),
            Some(NextSlice::Sequences) => {
                (self.sequence_slice(lab, candidate, active, profile)?, WorkUnit::WholeSequences)
            }
            None => (true, WorkUnit::NothingLeft),
        };
        if !is_whole {
            return Ok(None);
        }
        self.turns += 1;
        self.update_end_reason(profile);
        if self.ended.is_none() {
            self.begin_late(lab, candidate, active, profile);
        }
        if self.ended.is_some() {
            lab.expect(candidate, active, &[])?;
        }
        let part = turn.map(|slice| self.progress().part(&self.plan, slice));
        // Sequences beside another team are dropped, so fewer may be done than before.
        Ok(Some(Slice { what, worked: self.tried().saturating_sub(before), done: self.done(), part, pairs }))
    }

    /// The phases that the active version's work shows, of which every kind of drill gets its quota.
    fn phases_of(&self, lab: &TrialLab<'_>, active: &TrialSubject) -> Result<Vec<WorkPhase>, TrialFault> {
        let seeds: Vec<u64> =
            (0..PHASE_PROBES).map(|index| lab.seeds.seed(self.plan.drill_seeds, index)).collect();
        let shown = lab.phases(active, &seeds)?;
        let is_shown = |phase: &WorkPhase| {
            shown.iter().filter(|phases| phases.contains(phase)).count() >= PHASE_SHOWN_IN
        };
        Ok(WorkPhase::ALL.into_iter().filter(is_shown).collect())
    }

    /// Returns whether the slice is whole.
    fn sequence_slice(
        &mut self,
        lab: &TrialLab<'_>,
        candidate: &TrialSubject,
        active: &TrialSubject,
        profile: &Profile,
    ) -> Result<bool, TrialFault> {
        let beside: Vec<CapabilityId> = lab.team.members().iter().map(|party| party.version.id()).collect();
        if let Some(evidence) = self.sequences.as_mut().filter(|evidence| evidence.beside != beside) {
            // Another version has become active beside it: the results so far are about others.
            evidence.pairs.clear();
            evidence.beside = beside;
            self.part.sequences.clear();
            self.sequences_tried = 0;
        }
        if lab.team.lineup_with(&lab.cell.spec.tasks, active).is_none() {
            self.plan.sequences = 0;
            return Ok(true);
        }
        let seeds = self.sequence_seeds(lab, &self.progress());
        let open = seeds.get(self.part.sequences.len()..).unwrap_or_default();
        let next = open.get(..open.len().min(lab.part)).unwrap_or_default();
        let worked = lab.sequences(candidate, active, next, &mut self.reuse)?;
        self.part.sequences.extend(worked);
        if self.part.sequences.len() < seeds.len() {
            return Ok(false);
        }
        self.sequences_tried += seeds.len() as u64;
        let own = candidate.version.bundle.task();
        for (seed, (new, old)) in seeds.into_iter().zip(std::mem::take(&mut self.part.sequences)) {
            let of_task = |records: &[TaskRecord]| records.iter().find(|record| record.task == own).cloned();
            if let Some(candidate) = of_task(&new) {
                // A sequence that does not come to the task has no event in it, unless the cell failed before.
                let invalid = old.iter().any(|record| record.invalid);
                let without = || TaskRecord { invalid, ..TaskRecord::invalid(own, seed) };
                let active = of_task(&old).unwrap_or_else(without);
                self.stops.note(SceneKind::Sequence, &candidate, &active, profile);
            }
            if let (Some(evidence), Some(candidate), Some(active)) =
                (&mut self.sequences, steps(&new), steps(&old))
            {
                evidence.pairs.push(SequencePair { seed, active, candidate });
            }
        }
        Ok(true)
    }

    fn progress(&self) -> EvaluationProgress {
        EvaluationProgress {
            pairs: self.pairs.len() as u64,
            pairs_tried: self.pairs_tried,
            drills: self.rehearsed(),
            drills_tried: self.drills_tried,
            anchored: self.anchored,
            sequences: self.sequences_worked(),
            sequences_tried: self.sequences_tried,
            turns: self.turns,
        }
    }

    fn next_turn(&self) -> Option<NextSlice> {
        self.progress().next(&self.plan)
    }

    fn sequence_seeds(&self, lab: &TrialLab<'_>, progress: &EvaluationProgress) -> Vec<u64> {
        let range = progress.range(&self.plan, NextSlice::Sequences);
        range.map(|index| lab.seeds.seed(self.plan.sequence_seeds, index)).collect()
    }

    /// Where the drills of a slice begin: dealt round the phases by their place, and so the same for both versions.
    fn spots(&self, lab: &TrialLab<'_>, progress: &EvaluationProgress, kind: DrillKind) -> Vec<DrillSpot> {
        let phases = self.phases.as_deref().unwrap_or_default();
        let spot = |index: u64| {
            let turn = index.checked_rem(phases.len() as u64).and_then(|turn| usize::try_from(turn).ok());
            let seed = lab.seeds.seed(self.plan.drill_seeds, index);
            DrillSpot { seed, phase: turn.and_then(|turn| phases.get(turn).copied()) }
        };
        progress.range(&self.plan, NextSlice::Drills(kind)).map(spot).collect()
    }

    /// What will be asked for after the slice at hand, the rest of it included, if nothing ends the evaluation and no
    /// drill fails; in the parts in which the lab is asked.
    fn outlook(&self, lab: &TrialLab<'_>, slice: NextSlice) -> Vec<Lookahead> {
        let mut progress = self.progress();
        let part = &self.part;
        let mut worked = part.pairs.len().max(part.drills.0.len()).max(part.sequences.len());
        let (mut next, mut slices) = (Some(slice), Vec::new());
        for _ in 0..=SLICES_AHEAD {
            let Some(slice) = next else { break };
            let part = lab.part.max(1);
            match slice {
                NextSlice::Pairs => {
                    let spots = self.pair_spots(lab, &progress);
                    let open = spots.get(worked..).unwrap_or_default();
                    slices.extend(open.chunks(part).map(|part| Lookahead::Pairs(part.to_vec())));
                }
                NextSlice::Drills(kind) => {
                    let spots = self.spots(lab, &progress, kind);
                    let open = spots.get(worked..).unwrap_or_default();
                    slices.extend(open.chunks(part).map(|part| Lookahead::Drills(kind, part.to_vec())));
                }
                // Slices that may never be requested are not run ahead.
                NextSlice::Anchor | NextSlice::Settling(_) => break,
                NextSlice::Sequences if self.sequences.is_none() => break,
                NextSlice::Sequences => {
                    let seeds = self.sequence_seeds(lab, &progress);
                    let open = seeds.get(worked..).unwrap_or_default();
                    slices.extend(open.chunks(part).map(|part| Lookahead::Sequences(part.to_vec())));
                }
            }
            worked = 0;
            progress.suppose(&self.plan, slice);
            next = progress.next(&self.plan);
        }
        slices
    }

    fn update_end_reason(&mut self, profile: &Profile) {
        // An early end rests on the order of one budget, so the second look of a try ends early by a hard stop alone.
        let has_second_look = self.second_look_from.is_some();
        let early = |ended: &EarlyStopReason| match ended {
            EarlyStopReason::Full => false,
            EarlyStopReason::HardStop => true,
            _ => !has_second_look,
        };
        let budgeted = profile.with_sandbox_pairs(self.plan.pairs);
        self.ended = behavior::end_reason(&self.paired(), &self.binding, &budgeted)
            .filter(early)
            .or_else(|| self.recovery_ended(profile).filter(early))
            .or_else(|| {
                let is_over = self.next_turn().is_none() && !self.begin_second_look(profile);
                is_over.then_some(EarlyStopReason::Full)
            });
    }

    /// A failed recovery ends the evaluation, unless people may still decide on it: they see behavior measured over
    /// its whole budget.
    fn recovery_ended(&self, profile: &Profile) -> Option<EarlyStopReason> {
        let rehearsed = self.rehearsed();
        let ended = recovery::end_reason(&rehearsed, &self.binding, profile)?;
        let result = recovery::assess_early_stop(&rehearsed, &self.binding, profile, ended);
        let reviewable = profile.has_approver() && recovery_is_reviewable(&result.assessment);
        (!reviewable).then_some(ended)
    }

    /// The rules' verdict on the results. An early end counts for the dimension that caused it; the other one then
    /// has less than its budget and reports so.
    #[must_use]
    pub fn assess(&self, profile: &Profile) -> (BehaviorAssessment, RecoveryAssessment) {
        self.assess_with(self.anchor(), self.plan.has_anchor, profile)
    }

    fn assess_with(
        &self,
        anchor: Option<&AnchorEvidence>,
        has_anchor: bool,
        profile: &Profile,
    ) -> (BehaviorAssessment, RecoveryAssessment) {
        let ended = self.ended.unwrap_or(EarlyStopReason::Full);
        let (pairs, drills) = (self.paired(), self.rehearsed());
        let evidence = ComparisonEvidence {
            pairs: &pairs,
            drills: &drills,
            is_settling: self.plan.is_settling,
            has_live_like: self.plan.live_like > 0,
            has_anchor,
            anchor,
            sequences: self.sequences(),
            counted: self.counted.as_ref(),
        };
        evidence.assess(&self.binding, ended, profile)
    }
}

/// A side of a pair of sequences; `None` if the cell failed in it.
fn steps(records: &[TaskRecord]) -> Option<Vec<SequenceStep>> {
    let step = |record: &TaskRecord| Some(SequenceStep { task: record.task, values: record.values()? });
    records.iter().map(step).collect()
}

#[cfg(test)]
mod tests;
