//! How events become changes of the store. Those of one transaction are written together; then the memory follows.

use holdpoint_governance::ids::{Family, canonical_json};
use holdpoint_governance::lifecycle::{
    self, FamilyState, LifecycleChange, LifecycleEvent, State, VersionRef,
};
use holdpoint_store::{ActiveCause, AuditBody, Change};

use super::{FamilyEntry, StateMove, TransitionNote, VersionTable, VersionTableError};

/// A family after an event that is not written yet.
struct UnwrittenFamily {
    family: Family,
    entry: FamilyEntry,
    state: FamilyState,
    moved: Vec<StateMove>,
}

impl VersionTable {
    /// Voids what was shown of every family under another context, which comes into force in the same transaction.
    ///
    /// # Errors
    /// If the lifecycle refuses, or the store does. Nothing has changed then.
    pub fn change_context(
        &mut self,
        needs_approval: bool,
        at_ms: u64,
        note: TransitionNote,
    ) -> Result<(), VersionTableError> {
        let TransitionNote { reason, cause: _, before: mut changes, after, audit } = note;
        let mut families = Vec::new();
        for (family, entry) in &self.families {
            let (state, life) =
                lifecycle::apply(&entry.state, LifecycleEvent::ContextChanged { needs_approval })?;
            let note = TransitionNote::because(reason.clone());
            families.push(self.add_changes(
                &mut changes,
                (family.clone(), entry.clone()),
                state,
                &life,
                note,
            )?);
        }
        changes.extend(after);
        self.write_families(families, changes, audit, at_ms).map(|_| ())
    }

    pub(super) fn commit(
        &mut self,
        family: &Family,
        entry: FamilyEntry,
        state: FamilyState,
        life: &[LifecycleChange],
        at_ms: u64,
        mut note: TransitionNote,
    ) -> Result<Vec<StateMove>, VersionTableError> {
        let audit = std::mem::take(&mut note.audit);
        let mut changes = Vec::new();
        let unwritten = self.add_changes(&mut changes, (family.clone(), entry), state, life, note)?;
        self.write_families(vec![unwritten], changes, audit, at_ms)
    }

    /// Adds the changes of an event of one family.
    fn add_changes(
        &self,
        changes: &mut Vec<Change>,
        (family, entry): (Family, FamilyEntry),
        state: FamilyState,
        life: &[LifecycleChange],
        note: TransitionNote,
    ) -> Result<UnwrittenFamily, VersionTableError> {
        let id_of =
            |version: VersionRef| entry.members.get(usize::from(version.0)).map(|m| m.capability.id());
        let mut moved = Vec::new();
        changes.extend(note.before);
        let mut last = Vec::new();
        for change in life {
            match *change {
                LifecycleChange::Added { .. }
                | LifecycleChange::Standing { .. }
                | LifecycleChange::Review { .. } => {}
                LifecycleChange::State { version, from, to } => {
                    let Some(id) = id_of(version) else { continue };
                    let expected = entry.members.get(usize::from(version.0)).map_or(0, |m| m.row_version);
                    changes.push(Change::SetState {
                        version: id.clone(),
                        expected_row_version: expected,
                        from,
                        to,
                        reason: note.reason.clone(),
                    });
                    moved.push(StateMove { id, from, to });
                }
                LifecycleChange::Flags { version, to, .. } => {
                    if let Some(version) = id_of(version) {
                        last.push(Change::SetFlags { version, flags: to });
                    }
                }
                LifecycleChange::SafeStopped { stopped } => last.insert(
                    0,
                    Change::SetFamily {
                        family: family.clone(),
                        safe_stopped: stopped,
                        reason: note.reason.clone(),
                    },
                ),
                LifecycleChange::Active { to, .. } => {
                    let active = to.and_then(id_of);
                    let pinned = to
                        .and_then(|version| state.get(version)?.predecessor)
                        .filter(|target| state.state(*target) == Some(State::Superseded))
                        .and_then(id_of);
                    let cause = note.cause.clone().unwrap_or(if active.is_some() {
                        ActiveCause::Restore
                    } else {
                        ActiveCause::Vacate
                    });
                    let robot = self.robot.clone();
                    last.push(Change::SetActive { family: family.clone(), active, pinned, cause, robot });
                }
                LifecycleChange::Context { .. } => {
                    last.push(Change::VoidFamily { family: family.clone(), reason: note.reason.clone() });
                }
            }
        }
        // A family is voided last: approvals used in this transaction were valid when used.
        last.sort_by_key(|change| matches!(change, Change::VoidFamily { .. }));
        changes.append(&mut last);
        changes.extend(note.after);
        let record = |source| VersionTableError::Record { what: "standing", of: family.to_string(), source };
        changes.push(Change::SetStanding {
            family: family.clone(),
            json: canonical_json(&state).map_err(record)?,
        });
        Ok(UnwrittenFamily { family, entry, state, moved })
    }

    /// Writes the changes, and takes over the families that they make.
    fn write_families(
        &mut self,
        families: Vec<UnwrittenFamily>,
        changes: Vec<Change>,
        audit: Vec<AuditBody>,
        at_ms: u64,
    ) -> Result<Vec<StateMove>, VersionTableError> {
        let receipt = self.write(changes, audit, at_ms)?;
        let mut all_moved = Vec::new();
        for UnwrittenFamily { family, mut entry, state, moved } in families {
            for (id, row_version) in &receipt.row_versions {
                if let Some(member) = entry.members.iter_mut().find(|member| member.capability.id() == *id) {
                    member.row_version = *row_version;
                }
            }
            for StateMove { id, from, .. } in &moved {
                let found = entry.members.iter_mut().zip(&entry.state.versions);
                if let Some((member, before)) =
                    found.into_iter().find(|(member, _)| member.capability.id() == *id)
                {
                    member.course.left = Some(*from);
                    member.course.ran = before.flags.running;
                }
            }
            entry.state = state;
            self.families.insert(family, entry);
            all_moved.extend(moved);
        }
        Ok(all_moved)
    }
}
