//! The kinds of records that only the store writes.

use holdpoint_governance::record::{RecordKind, ReplayClass};

/// Whether only the store writes records of a kind; callers may not use it.
pub(crate) const fn is_own(kind: RecordKind) -> bool {
    matches!(kind.replay_class(), ReplayClass::Change)
}
