//! Why the signature under a request does not count, or is missing.
//!
//! Typed values of the engine that never travel: the crate `holdpoint-wording` makes the text of a refusal from them.

use holdpoint_governance::approval::Role;
use holdpoint_governance::profile::ProfileName;

use crate::command::Refusal;

/// Why the engine refuses a request for its signature. A person it does not know is a
/// [`QuestionRefusal`](crate::approval_document::QuestionRefusal).
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum SigningRefusal {
    /// The request gives authority and has no signature.
    Unsigned {
        /// The profile, which requires one.
        profile: ProfileName,
    },
    /// The engine remembers no further signature as used.
    TooManyUsed {
        /// How many it remembers.
        max: usize,
    },
    /// It is for another store.
    OtherStore {
        /// The signer.
        name: String,
    },
    /// It is for an engine that has ended.
    EngineEnded {
        /// The signer.
        name: String,
    },
    /// It is over another request.
    OtherRequest {
        /// The signer.
        name: String,
    },
    /// The request names another person than the signer.
    OtherPerson {
        /// The signer.
        name: String,
    },
    /// It has expired.
    Expired {
        /// The signer.
        name: String,
    },
    /// It would be valid for too long.
    ValidTooLong {
        /// The signer.
        name: String,
        /// The longest validity, s.
        max_s: u64,
    },
    /// It was used already.
    UsedAlready {
        /// The signer.
        name: String,
    },
    /// The signer's role may not give authority.
    RoleGivesNothing {
        /// The signer.
        name: String,
        /// The role.
        role: Role,
    },
}

impl SigningRefusal {
    /// Its class in the reply.
    #[must_use]
    pub const fn class(&self) -> Refusal {
        match self {
            Self::ValidTooLong { .. } => Refusal::BadInput,
            Self::TooManyUsed { .. } => Refusal::NotNow,
            Self::OtherStore { .. }
            | Self::EngineEnded { .. }
            | Self::Expired { .. }
            | Self::UsedAlready { .. } => Refusal::Stale,
            Self::Unsigned { .. }
            | Self::OtherRequest { .. }
            | Self::OtherPerson { .. }
            | Self::RoleGivesNothing { .. } => Refusal::NotAllowed,
        }
    }
}
