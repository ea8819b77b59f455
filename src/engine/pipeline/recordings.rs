//! What is told and put on record of scene recordings.
//!
//! A recording is for people. Nothing here is read by anything that decides.

use super::manager::{Fault, UpgradeManager};
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::record::RecordKind;
use holdpoint_protocol::event::EventKind;
use holdpoint_registry::AuditBody;

impl UpgradeManager {
    /// Puts a closed recording on record, in the form that whoever keeps recordings gives it, and tells of it.
    ///
    /// # Errors
    /// Where it cannot be written.
    pub fn keep_recording(
        &mut self,
        version: &CapabilityId,
        (kind, body): (RecordKind, String),
        told: EventKind,
    ) -> Result<(), Fault> {
        let record = AuditBody { kind, subject: version.to_string(), body };
        let at_ms = self.clock.now_ms();
        self.ledger.write(Vec::new(), vec![record], at_ms)?;
        self.emit(told);
        Ok(())
    }

    /// Tells something about scenes.
    pub fn tell_scene(&mut self, text: String, failed: bool) {
        self.emit(EventKind::Scene { text, failed });
    }
}
