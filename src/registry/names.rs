//! The closed sets of words that only the store has. The schema repeats each set as a CHECK.

use holdpoint_governance::words;

/// Kinds of record that only the store writes; callers may not use them.
pub(crate) const OWN_KINDS: [&str; 15] = [
    "version-registered",
    "state-set",
    "flags-set",
    "scores-set",
    "active-set",
    "family-set",
    "family-voided",
    "standing-set",
    "evidence-put",
    "approval-requested",
    "approval-put",
    "approval-consumed",
    "context-set",
    "telemetry-sealed",
    "alarm-changed",
];

words! {
    /// What a piece of evidence is about.
    EvidenceKind, "kind of evidence", {
        /// Compatibility report (the four checks).
        Compat = "compat",
        /// Sandbox summary.
        Sandbox = "sandbox",
        /// Shadow summary.
        Shadow = "shadow",
        /// Gate decision.
        Gate = "gate",
        /// Activation record.
        Activation = "activation",
        /// Monitor decision or summary.
        Monitor = "monitor",
        /// Rollback event record.
        Rollback = "rollback",
        /// Recovery drills.
        Drill = "drill",
    }
}

words! {
    /// How a request for approval stands.
    RequestState, "state of an approval request", {
        /// Waiting for people.
        Open = "open",
        /// Enough approvals were given.
        Granted = "granted",
        /// Somebody refused.
        Refused = "refused",
        /// Nobody answered in time: hold.
        Expired = "expired",
        /// What it was about has changed.
        Void = "void",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use holdpoint_governance::approval::Answer;
    use holdpoint_governance::lifecycle::{Stage, State};

    #[test]
    fn the_words_are_those_of_the_lifecycle_and_of_the_schema() {
        let schema = include_str!("schema/store-1.sql");
        let all = (State::ALL.map(State::name).into_iter())
            .chain(Stage::ALL.map(Stage::name))
            .chain(EvidenceKind::ALL.map(EvidenceKind::name))
            .chain(Answer::ALL.map(Answer::name))
            .chain(RequestState::ALL.map(RequestState::name));
        for word in all {
            assert!(schema.contains(&format!("'{word}'")), "{word}");
        }
        assert!("Active".parse::<State>().is_err());
    }
}
