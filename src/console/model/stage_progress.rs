//! The speed of a stage: its recent progress, from which the rest of it is forecast, or not.

use std::collections::VecDeque;

use holdpoint_protocol::snapshot::ProgressView;

/// Moves of the count that are kept, so that the estimate follows a changing pace.
const MARKS_MAX: usize = 9;

/// The fewest measured moves that a forecast needs.
const MOVES_MIN: usize = 3;

/// A stage of one candidate.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StageProgress {
    /// Virtual time at which the stage began, ms.
    since_ms: u64,
    /// The counts, and the virtual time at which each was first seen, ms; oldest first, never empty.
    marks: VecDeque<(u64, u64)>,
}

impl StageProgress {
    /// Of a stage that is seen for the first time. A part that is done already has no rate: it may have stood still.
    #[must_use]
    pub fn of(progress: &ProgressView, now_ms: u64) -> Self {
        let began_ms = if progress.done == 0 { progress.since_ms } else { now_ms };
        Self { since_ms: progress.since_ms, marks: VecDeque::from([(progress.done, began_ms)]) }
    }

    /// Forgets the rates: the stage stands still, and is measured from its next move on.
    pub fn rest(&mut self, progress: &ProgressView, now_ms: u64) {
        *self = Self { since_ms: progress.since_ms, marks: VecDeque::from([(progress.done, now_ms)]) };
    }

    /// Takes in the progress; a restarted stage is measured from its restart.
    pub fn see(&mut self, progress: &ProgressView, now_ms: u64) {
        let last = self.marks.back().map_or(0, |(done, _)| *done);
        if progress.since_ms != self.since_ms || progress.done < last {
            *self = Self::of(progress, now_ms);
        } else if progress.done > last {
            self.marks.push_back((progress.done, now_ms));
            if self.marks.len() > MARKS_MAX {
                self.marks.pop_front();
            }
        }
    }

    /// The least and the most time that the rest of the stage takes, at the fastest and the slowest of its recent moves.
    /// Absent before enough moves are measured, and once the current job takes much longer than any of them.
    #[must_use]
    pub fn remaining_ms(&self, progress: &ProgressView, now_ms: u64) -> Option<(u64, u64)> {
        let moves: Vec<(u128, u128)> = self
            .marks
            .iter()
            .zip(self.marks.iter().skip(1))
            .map(|(from, to)| {
                (u128::from(to.0.saturating_sub(from.0)), u128::from(to.1.saturating_sub(from.1)))
            })
            .filter(|(moved, _)| *moved > 0)
            .collect();
        if moves.len() < MOVES_MIN {
            return None;
        }
        let left = u128::from(progress.budget.checked_sub(progress.done)?);
        let passed_ms = u128::from(now_ms.saturating_sub(self.marks.back()?.1));
        let longest_ms = moves.iter().map(|(_, took_ms)| *took_ms).max()?;
        if passed_ms > longest_ms.saturating_mul(2) {
            return None;
        }
        let rest_ms = |(moved, took_ms): &(u128, u128)| took_ms.saturating_mul(left) / (*moved).max(1);
        let least_ms = moves.iter().map(rest_ms).min()?.saturating_sub(passed_ms);
        let most_ms = moves.iter().map(rest_ms).max()?.saturating_sub(passed_ms);
        Some((u64::try_from(least_ms).ok()?, u64::try_from(most_ms).ok()?))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_governance::lifecycle::Stage;
    use holdpoint_protocol::work_unit::WorkUnit;

    fn at(done: u64, since_ms: u64) -> ProgressView {
        let (what, early) = (WorkUnit::ShadowSequences.into(), String::new());
        ProgressView { stage: Stage::Shadow, what, done, budget: 20, part: None, since_ms, early }
    }

    #[test]
    fn the_rest_is_a_range_of_measured_rates_or_unknown() {
        let mut progress = StageProgress::of(&at(0, 1_000), 1_000);
        for (done, seen_ms) in [(1, 11_000), (2, 19_000)] {
            progress.see(&at(done, 1_000), seen_ms);
            assert_eq!(progress.remaining_ms(&at(done, 1_000), seen_ms), None, "{done} moves are too few");
        }
        progress.see(&at(3, 1_000), 31_000);
        // The moves took 10, 8 and 12 s; 17 are left.
        assert_eq!(progress.remaining_ms(&at(3, 1_000), 31_000), Some((136_000, 204_000)));
        assert_eq!(progress.remaining_ms(&at(3, 1_000), 36_000), Some((131_000, 199_000)));
        // A job twice as long as the longest has no measured rate.
        assert!(progress.remaining_ms(&at(3, 1_000), 55_000).is_some());
        assert_eq!(progress.remaining_ms(&at(3, 1_000), 55_001), None);
        // A standstill of 100 s is in no rate: three moves of 10 s each are measured after it.
        let mut resumed = progress.clone();
        resumed.see(&at(4, 1_000), 41_000);
        resumed.rest(&at(4, 1_000), 141_000);
        assert_eq!(resumed.remaining_ms(&at(4, 1_000), 141_000), None);
        for (done, seen_ms) in [(5, 151_000), (6, 161_000), (7, 171_000)] {
            resumed.see(&at(done, 1_000), seen_ms);
        }
        assert_eq!(resumed.remaining_ms(&at(7, 1_000), 171_000), Some((130_000, 130_000)));
        // Nor is the part that was done before the console looked.
        let mut joined = StageProgress::of(&at(4, 1_000), 141_000);
        for (done, seen_ms) in [(5, 151_000), (6, 161_000), (7, 171_000)] {
            joined.see(&at(done, 1_000), seen_ms);
        }
        assert_eq!(joined.remaining_ms(&at(7, 1_000), 171_000), Some((130_000, 130_000)));
        // A stage that began again is measured from there.
        progress.see(&at(1, 80_000), 90_000);
        assert_eq!(progress.remaining_ms(&at(1, 80_000), 90_000), None);
    }
}
