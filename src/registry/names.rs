//! The closed lists of words the store accepts in its columns. The schema repeats each list as a CHECK.

/// A word that is not on a closed list.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{found:?} is not a {what}; allowed: {allowed}")]
pub struct WordError {
    /// What the word should have been.
    pub what: &'static str,
    /// The word.
    pub found: String,
    /// The list.
    pub allowed: String,
}

macro_rules! words {
    ($(#[$doc:meta])* $name:ident, $what:literal, { $($(#[$vdoc:meta])* $variant:ident = $text:literal),+ $(,)? }) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize)]
        pub enum $name { $($(#[$vdoc])* #[serde(rename = $text)] $variant),+ }

        impl $name {
            /// Every word of the list, in its order.
            pub const ALL: &'static [Self] = &[$(Self::$variant),+];

            /// The word as stored.
            #[must_use]
            pub const fn as_str(self) -> &'static str {
                match self { $(Self::$variant => $text),+ }
            }
        }

        impl std::str::FromStr for $name {
            type Err = WordError;
            fn from_str(text: &str) -> Result<Self, WordError> {
                Self::ALL.iter().copied().find(|word| word.as_str() == text).ok_or_else(|| WordError {
                    what: $what,
                    found: text.to_owned(),
                    allowed: Self::ALL.iter().map(|word| word.as_str()).collect::<Vec<_>>().join(", "),
                })
            }
        }

        impl std::fmt::Display for $name {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str(self.as_str())
            }
        }

        impl rusqlite::ToSql for $name {
            fn to_sql(&self) -> rusqlite::Result<rusqlite::types::ToSqlOutput<'_>> {
                Ok(self.as_str().into())
            }
        }

        impl rusqlite::types::FromSql for $name {
            fn column_result(value: rusqlite::types::ValueRef<'_>) -> rusqlite::types::FromSqlResult<Self> {
                value.as_str()?.parse().map_err(|error| rusqlite::types::FromSqlError::Other(Box::new(error)))
            }
        }
    };
}

words! {
    /// A lifecycle state: the last stage passed (paper appendix A, with `superseded` for a replaced version).
    StateName, "lifecycle state", {
        /// Known, nothing checked.
        Registered = "registered",
        /// Compatibility checked.
        Validated = "validated",
        /// Sandbox passed.
        Sandboxed = "sandboxed",
        /// Shadow passed.
        Shadowed = "shadowed",
        /// In control.
        Active = "active",
        /// Back to evaluation.
        Demoted = "demoted",
        /// Refused for good.
        Rejected = "rejected",
        /// Taken out of control for good.
        RolledBack = "rolled-back",
        /// Replaced by a newer active version; the rollback target.
        Superseded = "superseded",
    }
}

words! {
    /// The stage that is running on a version, if any.
    StageName, "stage", {
        /// Compatibility validation.
        Validation = "validation",
        /// Sandbox evaluation.
        Sandbox = "sandbox",
        /// Shadow evaluation.
        Shadow = "shadow",
        /// The gate, approvals included.
        Activation = "activation",
    }
}

macro_rules! same_as {
    ($ours:ident, $theirs:path, { $($variant:ident),+ }) => {
        impl From<$theirs> for $ours {
            fn from(word: $theirs) -> Self {
                use $theirs as Theirs;
                match word { $(Theirs::$variant => Self::$variant),+ }
            }
        }

        impl From<$ours> for $theirs {
            fn from(word: $ours) -> Self {
                match word { $($ours::$variant => Self::$variant),+ }
            }
        }
    };
}

same_as!(StateName, crate::governance::lifecycle::State, {
    Registered, Validated, Sandboxed, Shadowed, Active, Demoted, Rejected, RolledBack, Superseded
});
same_as!(StageName, crate::governance::lifecycle::Stage, { Validation, Sandbox, Shadow, Activation });

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
    /// What an approver decided.
    ApprovalDecision, "approval decision", {
        /// Yes.
        Approve = "approve",
        /// No; rejects.
        Reject = "reject",
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
    use crate::governance::lifecycle::{Stage, State};

    #[test]
    fn the_words_are_those_of_the_lifecycle_and_of_the_schema() {
        let schema = include_str!("schema/store-1.sql");
        for state in State::ALL {
            let word = StateName::from(state);
            assert_eq!((word.as_str(), State::from(word)), (state.name(), state));
        }
        for stage in Stage::ALL {
            let word = StageName::from(stage);
            assert_eq!((word.as_str(), Stage::from(word)), (stage.name(), stage));
        }
        let all = (StateName::ALL.iter().map(|w| w.as_str()))
            .chain(StageName::ALL.iter().map(|w| w.as_str()))
            .chain(EvidenceKind::ALL.iter().map(|w| w.as_str()))
            .chain(ApprovalDecision::ALL.iter().map(|w| w.as_str()))
            .chain(RequestState::ALL.iter().map(|w| w.as_str()));
        for word in all {
            assert!(schema.contains(&format!("'{word}'")), "{word}");
        }
        assert!("Active".parse::<StateName>().is_err());
    }
}
