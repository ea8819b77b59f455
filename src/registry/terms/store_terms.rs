//! The closed sets of terms, and the names, that only the store has. The schema repeats each set as a CHECK.

use holdpoint_governance::closed_set;
use holdpoint_governance::record::{RecordKind, ReplayClass};

/// Name of the first administrator; a number follows if another person has that name.
pub const FIRST_ADMINISTRATOR: &str = "admin";

/// Whether only the store writes records of a kind; callers may not use it.
pub(crate) const fn is_own(kind: RecordKind) -> bool {
    matches!(kind.replay_class(), ReplayClass::Change)
}

closed_set! {
    /// The subject of a piece of evidence.
    EvidenceKind, "kind of evidence", {
        /// Compatibility report (the four checks).
        Compat = "compat",
        Sandbox = "sandbox",
        Shadow = "shadow",
        Gate = "gate",
        Activation = "activation",
        /// Monitor decision or summary.
        Monitor = "monitor",
        Rollback = "rollback",
        Drill = "drill",
    }
}

closed_set! {
    /// The state of a request for approval.
    RequestState, "state of an approval request", {
        Open = "open",
        /// It has enough approvals.
        Granted = "granted",
        Refused = "refused",
        /// No answer in time: the version is on hold.
        Expired = "expired",
        /// Its subject has changed.
        Void = "void",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_governance::approval::ApprovalDecision;
    use holdpoint_governance::lifecycle::{Stage, State};

    #[test]
    fn stored_names_are_those_of_lifecycle_and_schema() {
        let schema = include_str!("../schema/store-1.sql");
        let all = (State::ALL.map(State::name).into_iter())
            .chain(Stage::ALL.map(Stage::name))
            .chain(EvidenceKind::ALL.map(EvidenceKind::name))
            .chain(ApprovalDecision::ALL.map(ApprovalDecision::name))
            .chain(RequestState::ALL.map(RequestState::name));
        for name in all {
            assert!(schema.contains(&format!("'{name}'")), "{name}");
        }
        assert!("Active".parse::<State>().is_err());
    }
}
