//! The changes between two states of a family, as the store writes them.

use super::{FamilyState, LifecycleChange, State, Version, VersionRef};

/// The differences in write order: versions leave a state before others enter it.
pub(super) fn changes(before: &FamilyState, after: &FamilyState) -> Vec<LifecycleChange> {
    let mut out = Vec::new();
    let numbered = |index: usize| VersionRef(u16::try_from(index).unwrap_or(u16::MAX));
    if before.context != after.context {
        out.push(LifecycleChange::Context { context: after.context });
    }
    let mut entering = Vec::new();
    for (index, new) in after.versions.iter().enumerate() {
        let version = numbered(index);
        let Some(old) = before.versions.get(index) else {
            out.push(LifecycleChange::Added { version, state: new.state });
            continue;
        };
        if old.state != new.state {
            let change = LifecycleChange::State { version, from: old.state, to: new.state };
            if new.state == State::Active { entering.push(change) } else { out.push(change) }
        }
        if old.flags != new.flags {
            out.push(LifecycleChange::Flags { version, from: old.flags, to: new.flags });
        }
        let stored_facts = |v: &Version| (v.round, v.predecessor, v.sandbox, v.shadow, v.gate, v.approval);
        if stored_facts(old) != stored_facts(new) || old.closed != new.closed {
            out.push(LifecycleChange::Standing { version });
        }
    }
    out.extend(entering);
    if before.active() != after.active() {
        out.push(LifecycleChange::Active { from: before.active(), to: after.active() });
    }
    if before.safe_stopped != after.safe_stopped {
        out.push(LifecycleChange::SafeStopped { stopped: after.safe_stopped });
    }
    if before.review != after.review {
        out.push(LifecycleChange::Review { open: after.review.map(|review| review.version) });
    }
    out
}
