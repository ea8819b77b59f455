//! Slices of drills: of the base number, and past it until failures of the candidate alone are settled. Counts results and
//! judges none.

use super::Evaluation;
use crate::drills::DrillResult;
use crate::fault::TrialFault;
use crate::trial_lab::{DrillSpot, TrialLab, TrialSubject};
use holdpoint_governance::evidence::{DrillKind, DrillTallies, DrillTally, FailedDrill};
use holdpoint_governance::recovery::DrillContrast;

/// The most failed drills that are kept one by one; all are counted.
const FAILED_KEPT: usize = 64;

impl Evaluation {
    /// Runs the next part of a slice of drills, and counts the slice once it is whole; returns whether it is. Drills past the
    /// base number (`is_settling`) are of the candidate, and of the active version where the candidate failed, or of both once
    /// it failed alone.
    pub(super) fn drill_slice(
        &mut self,
        lab: &TrialLab<'_>,
        candidate: &TrialSubject,
        active: &TrialSubject,
        (kind, is_settling): (DrillKind, bool),
    ) -> Result<bool, TrialFault> {
        let is_paired = !is_settling || DrillContrast::of(kind, &self.rehearsed()).is_paired_next();
        let spots = self.spots(lab, &self.progress(), kind);
        let open = spots.get(self.part.drills.0.len()..).unwrap_or_default();
        let next = open.get(..open.len().min(lab.part)).unwrap_or_default();
        let (new, old) = lab.drills(candidate, active, (kind, is_paired), next, &mut self.reuse)?;
        self.part.drills.0.extend(new);
        self.part.drills.1.extend(old);
        if self.part.drills.0.len() < spots.len() {
            return Ok(false);
        }
        let (of_candidate, of_active) = std::mem::take(&mut self.part.drills);
        self.drills_tried[kind as usize] += spots.len() as u64;
        for (spot, (new, old)) in spots.iter().zip(of_candidate.iter().zip(&of_active)) {
            if *new == DrillResult::Failed && self.failed.len() < FAILED_KEPT {
                let active = (*old != DrillResult::Infeasible).then_some(*old == DrillResult::Passed);
                self.failed.push(FailedDrill { kind, phase: spot.phase, seed: spot.seed, active });
            }
        }
        let alone = failed_alone(&of_candidate, &of_active);
        let active_alone = failed_alone(&of_active, &of_candidate);
        if !is_settling {
            tally(&mut self.drills.0, kind, &spots, &of_candidate);
            tally(&mut self.drills.1, kind, &spots, &of_active);
            self.drills.0.of_mut(kind).failed_alone += alone;
            self.drills.1.of_mut(kind).failed_alone += active_alone;
            return Ok(true);
        }
        let Some(tally) = self.settling.of_mut(kind) else { return Ok(true) };
        let is_feasible = |result: &&DrillResult| **result != DrillResult::Infeasible;
        if is_paired {
            let both = of_candidate.iter().zip(&of_active);
            let both = both.filter(|(new, old)| is_feasible(new) && is_feasible(old));
            tally.paired += u32::try_from(both.count()).unwrap_or(u32::MAX);
            tally.candidate_failed += alone;
            tally.active_failed += active_alone;
        } else {
            let feasible = of_candidate.iter().filter(is_feasible).count();
            tally.alone += u32::try_from(feasible).unwrap_or(u32::MAX);
            tally.alone_failed += alone;
        }
        Ok(true)
    }
}

/// Counts drills of one kind, each where it began.
pub(super) fn tally(
    drills: &mut DrillTallies,
    kind: DrillKind,
    spots: &[DrillSpot],
    results: &[DrillResult],
) {
    for (place, result) in results.iter().enumerate() {
        count(drills.of_mut(kind), *result);
        if let Some(phase) = spots.get(place).and_then(|spot| spot.phase) {
            count(drills.phases.of_mut(kind, phase), *result);
        }
    }
}

/// Drills that the first failed and the other passed at the same place.
fn failed_alone(results: &[DrillResult], others: &[DrillResult]) -> u32 {
    let alone = results.iter().zip(others);
    let alone = alone.filter(|both| *both == (&DrillResult::Failed, &DrillResult::Passed));
    u32::try_from(alone.count()).unwrap_or(u32::MAX)
}

const fn count(tally: &mut DrillTally, result: DrillResult) {
    let count = match result {
        DrillResult::Passed => &mut tally.passed,
        DrillResult::Failed => &mut tally.failed,
        DrillResult::Infeasible => &mut tally.infeasible,
    };
    *count = count.saturating_add(1);
}
