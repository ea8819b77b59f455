//! The wall time that the evaluation of each candidate takes, summed over its slices.
//!
//! The time in which a candidate waits, for people or for other candidates, does not count. A script has no wall time. The sum
//! is stored with the evidence of each stage. The profile limits it (`evaluation.wall_minutes_max`); the stages look at it
//! before each slice.

use holdpoint_governance::ids::CapabilityId;
use holdpoint_protocol::clock::Clock;

use super::Pipeline;

/// The wall time since a moment, ms; none by a script's clock, which simulated work advances.
fn wall_ms_since(clock: &Clock, begun_ms: u64) -> u64 {
    if clock.is_scripted() { 0 } else { clock.now_ms().saturating_sub(begun_ms) }
}

impl Pipeline {
    /// Adds the time since a slice began to the evaluation of a version.
    pub(super) fn note_slice_time(&mut self, id: &CapabilityId, begun_ms: u64) {
        let slice_ms = wall_ms_since(self.record.clock(), begun_ms);
        if slice_ms > 0 {
            let evidence_file = self.evidence_files.edit(id);
            evidence_file.worked_ms = evidence_file.worked_ms.saturating_add(slice_ms);
        }
    }

    /// Whether the evaluation of a version has taken the wall time that the profile allows.
    pub(super) fn has_spent_time(&self, id: &CapabilityId) -> bool {
        self.evidence_files.spent_time(id, &self.context.profile).is_some()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::{Duration, Instant};

    #[test]
    fn only_the_machine_s_clock_measures_an_evaluation() {
        let since = Instant::now().checked_sub(Duration::from_secs(7)).unwrap();
        let real = Clock::Real { from_ms: 1_000, since };
        let passed = wall_ms_since(&real, 3_000);
        assert!((5_000..60_000).contains(&passed), "{passed}");
        assert_eq!(wall_ms_since(&real, u64::MAX), 0);
        let mut script = Clock::scripted(1_000);
        script.advance(3_600_000);
        assert_eq!(wall_ms_since(&script, 1_000), 0);
    }
}
