//! The closed sets of terms, and the names, that only a store has. The schema of a database repeats each set as a CHECK.

use holdpoint_governance::closed_set;

/// Name of the first administrator; a number follows if another person has that name.
pub const FIRST_ADMINISTRATOR: &str = "admin";

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
