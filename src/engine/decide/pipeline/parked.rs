//! Stages of paused versions: each waits where it is, and other versions run meanwhile.

use super::{Pipeline, StageWork};

impl Pipeline {
    /// Parks the current stage if its version was paused. An active version and the settling of its concern continue.
    pub(super) fn park(&mut self) {
        let Self { work, record, parked, .. } = self;
        let resting = work.take_if(|work| match work {
            StageWork::Confirmation(_) => false,
            StageWork::ReEvaluation(run) if !run.is_of_shadow() => false,
            StageWork::Sandbox(_) | StageWork::Shadow(_) | StageWork::ReEvaluation(_) => record
                .version_table()
                .version(work.id())
                .is_ok_and(|(_, lifecycle, _)| lifecycle.flags.paused),
        });
        parked.extend(resting);
    }

    /// A stage whose version was resumed goes on as soon as no other is under way.
    pub(super) fn unpark(&mut self) {
        if self.work.is_some() {
            return;
        }
        let record = &self.record;
        let resumed = self.parked.iter().position(|work| {
            record.version_table().version(work.id()).is_ok_and(|(_, lifecycle, _)| !lifecycle.flags.paused)
        });
        self.work = resumed.map(|place| self.parked.remove(place));
    }
}
