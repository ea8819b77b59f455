//! Stages of versions that are paused or on hold: each waits where it is, and other versions run meanwhile.

use super::{Pipeline, StageWork};
use crate::decide::recorder::EngineRecorder;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_record::evidence_file::EvidenceFiles;

impl Pipeline {
    /// Parks the current stage if its version was paused or put on hold. An active version and the settling of its concern
    /// continue.
    pub(super) fn park(&mut self) {
        let Self { work, record, evidence_files, parked, .. } = self;
        let resting = work.take_if(|work| match work {
            StageWork::Confirmation(_) => false,
            StageWork::ReEvaluation(run) if !run.is_of_shadow() => false,
            StageWork::Sandbox(_) | StageWork::Shadow(_) | StageWork::ReEvaluation(_) => {
                rests(record, evidence_files, work.id())
            }
        });
        parked.extend(resting);
    }

    /// A stage whose version was resumed goes on as soon as no other is under way.
    pub(super) fn unpark(&mut self) {
        if self.work.is_some() {
            return;
        }
        let (record, evidence_files) = (&self.record, &self.evidence_files);
        let resumed = self.parked.iter().position(|work| !rests(record, evidence_files, work.id()));
        self.work = resumed.map(|place| self.parked.remove(place));
    }
}

/// Whether a person has to resume a version before its stage goes on.
fn rests(record: &EngineRecorder, evidence_files: &EvidenceFiles, id: &CapabilityId) -> bool {
    let is_paused = record.version_table().version(id).is_ok_and(|(_, lifecycle, _)| lifecycle.flags.paused);
    is_paused || evidence_files.is_held(id)
}
