//! The anchor of a family: the version that no sequence of new versions may be worse than by more than one version may.
//!
//! It is the family's commissioned version, or the last one that a person made its anchor. Read from the records of those
//! acts; no table repeats it.

use std::collections::BTreeMap;

use holdpoint_governance::ids::{CapabilityId, Family};
use holdpoint_governance::lifecycle::State;
use holdpoint_governance::record::RecordKind;
use holdpoint_runtime::capability::Capability;
use holdpoint_store::{AuditFilter, RecordViews, StoreError};

use super::{FamilyEntry, VersionTable};

/// The versions that people made anchors, the last of each family. The anchor of another family is its first version.
///
/// # Errors
/// If the store cannot be read.
pub fn chosen_anchors(views: &dyn RecordViews) -> Result<BTreeMap<Family, CapabilityId>, StoreError> {
    let filter = AuditFilter { kind: Some(RecordKind::AnchorSet), ..AuditFilter::default() };
    let acts = views.whole_audit(&filter)?;
    let chosen = acts.iter().filter_map(|record| record.subject.parse::<CapabilityId>().ok());
    Ok(chosen.map(|id| (id.family.clone(), id)).collect())
}

impl VersionTable {
    /// The versions that people made anchors, as [`chosen_anchors`], from memory.
    pub fn anchors_by_people(&self) -> impl Iterator<Item = &CapabilityId> {
        self.anchors.values()
    }

    /// The anchor of a family; `None` if it has no version.
    #[must_use]
    pub fn anchor(&self, family: &Family) -> Option<&Capability> {
        let entry = self.families.get(family)?;
        let chosen = self.anchors.get(family).and_then(|id| entry.find(id));
        let member = chosen.map(|(_, _, member)| member).or_else(|| entry.members.first())?;
        Some(&member.capability)
    }

    /// The anchor, if it is another version than the one that a candidate is compared with.
    #[must_use]
    pub fn anchor_beside(&self, compared_with: &Capability) -> Option<&Capability> {
        let anchor = self.anchor(&compared_with.id().family)?;
        (anchor.digest() != compared_with.digest()).then_some(anchor)
    }

    /// The anchor, if it is another version than the active one.
    #[must_use]
    pub fn anchor_beside_active(&self, family: &Family) -> Option<&Capability> {
        let active = self.families.get(family).and_then(FamilyEntry::active)?;
        self.anchor_beside(&active.capability)
    }

    /// Whether a version may be made its family's anchor: it is or was in control, and is confirmed.
    #[must_use]
    pub fn may_be_anchor(&self, id: &CapabilityId) -> bool {
        self.version(id).is_ok_and(|(version, state, member)| {
            let was_in_control = matches!(state.state, State::Active | State::Superseded);
            was_in_control && (version.0 == 0 || member.course.confirmed)
        })
    }

    /// Takes in a recorded act.
    pub fn note_anchor(&mut self, id: &CapabilityId) {
        self.anchors.insert(id.family.clone(), id.clone());
    }
}
