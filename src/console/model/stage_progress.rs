//! The speed of a stage: its recent progress, so that the estimated end neither jumps nor grows during one slow job.

use std::collections::VecDeque;

use holdpoint_protocol::snapshot::ProgressView;

/// Moves of the count that are kept, so that the estimate follows a changing pace.
const MARKS_MAX: usize = 9;

/// A stage of one candidate.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct StageProgress {
    /// Virtual time at which the stage began, ms.
    since_ms: u64,
    /// The counts, and the virtual time at which each was first seen, ms; oldest first, never empty.
    marks: VecDeque<(u64, u64)>,
}

impl StageProgress {
    /// Of a stage that is seen for the first time.
    #[must_use]
    pub fn of(progress: &ProgressView, now_ms: u64) -> Self {
        let mut marks = VecDeque::from([(0, progress.since_ms)]);
        if progress.done > 0 {
            marks.push_back((progress.done, now_ms));
        }
        Self { since_ms: progress.since_ms, marks }
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

    /// The total time of the stage at its recent pace; absent before any progress.
    #[must_use]
    pub fn expected_ms(&self, progress: &ProgressView, now_ms: u64) -> Option<u64> {
        let (first, last) = (self.marks.front()?, self.marks.back()?);
        let moved = last.0.checked_sub(first.0).filter(|moved| *moved > 0)?;
        let left = u128::from(progress.budget.checked_sub(progress.done)?);
        let took_ms = u128::from(last.1.saturating_sub(first.1));
        // The time since the last move belongs to the current job, at most one job.
        let all_ms = took_ms * left / u128::from(moved);
        let piece_ms = took_ms / u128::from(moved);
        let passed_ms = u128::from(now_ms.saturating_sub(last.1)).min(piece_ms);
        let elapsed_ms = u128::from(now_ms.saturating_sub(self.since_ms));
        u64::try_from(elapsed_ms + all_ms.saturating_sub(passed_ms)).ok()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_governance::lifecycle::Stage;
    use holdpoint_protocol::work_unit::WorkUnit;

    fn at(done: u64, since_ms: u64) -> ProgressView {
        let (what, early) = (WorkUnit::ShadowSequences.into(), String::new());
        ProgressView { stage: Stage::Shadow, what, done, budget: 20, since_ms, early }
    }

    #[test]
    fn expected_end_is_stable_between_two_steps_and_follows_the_pace() {
        let mut headway = StageProgress::of(&at(0, 1_000), 1_000);
        assert_eq!(headway.expected_ms(&at(0, 1_000), 9_000), None, "nothing is done yet");
        for done in 1..=4 {
            headway.see(&at(done, 1_000), 1_000 + done * 10_000);
        }
        // Four in 40 seconds: the other sixteen take 160 s more, whenever the fifth is under way.
        for passed_ms in [0, 2_000, 9_999] {
            assert_eq!(headway.expected_ms(&at(4, 1_000), 41_000 + passed_ms), Some(200_000));
        }
        // Beyond that it is late by the difference.
        assert_eq!(headway.expected_ms(&at(4, 1_000), 41_000 + 15_000), Some(205_000));
        // Ten times as fast from here on.
        for done in 5..=14 {
            headway.see(&at(done, 1_000), 41_000 + (done - 4) * 1_000);
        }
        assert_eq!(headway.expected_ms(&at(14, 1_000), 51_000), Some(50_000 + 6_000));
        headway.see(&at(1, 80_000), 90_000);
        assert_eq!(headway.expected_ms(&at(1, 80_000), 90_000), Some(200_000), "it began again");
    }
}
