//! When the key of an evaluation's seeds is revealed: as soon as no stage runs under it, or can continue under it.

use holdpoint_governance::evaluation_key::{KeyCommitment, KeyUse};
use holdpoint_governance::ids::Digest;
use holdpoint_governance::lifecycle::State;

use super::Pipeline;
use crate::decide::evaluation_keys::OpenKey;
use crate::fault::EngineFault;

impl Pipeline {
    /// Reveals the keys of evaluations that are over. One that an earlier engine left stays secret as long as its stage
    /// can run again.
    pub(super) fn reveal_finished_keys(&mut self) -> Result<(), EngineFault> {
        let open = self.record.open_evaluation_keys();
        let finished: Vec<Digest> =
            open.filter(|open| !self.is_in_use(open)).map(|open| open.committed.commitment).collect();
        self.record.reveal_keys(&finished)
    }

    fn is_in_use(&self, open: &OpenKey) -> bool {
        let KeyCommitment { key_use, version: Some(id), .. } = &open.committed else { return false };
        let work = self.work.iter().chain(&self.parked);
        if work.into_iter().any(|work| work.id() == id && work.key_use() == Some(*key_use)) {
            return true;
        }
        let Ok((_, lifecycle, _)) = self.record.version_table().version(id) else { return false };
        open.is_inherited
            && match key_use {
                KeyUse::Sandbox => {
                    matches!(lifecycle.state, State::Registered | State::Validated | State::Demoted)
                }
                KeyUse::Confirmation => self.evidence_files.awaits_confirmation(id),
                KeyUse::ReEvaluation => {
                    lifecycle.state == State::Sandboxed || self.evidence_files.is_suspicious(id)
                }
                KeyUse::Live => false,
            }
    }
}
