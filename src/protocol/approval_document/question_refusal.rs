//! Why a person gets no approval request to sign, or why their signed answer or request does not count.
//!
//! Typed values of the engine that never travel: the crate `holdpoint-wording` makes the text of a refusal from them.

use holdpoint_governance::approval::ApprovalDecision;
use holdpoint_governance::ids::CapabilityId;
use holdpoint_governance::profile::ProfileName;
use holdpoint_governance::wall_time::WallTime;

use crate::command::Refusal;
use crate::request_kind::RequestKind;

/// Why the engine refuses an approval request, a signed answer to one, or the signature of a person.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum QuestionRefusal {
    /// No request of this kind is open for the version.
    NothingPending {
        /// The kind of request.
        purpose: RequestKind,
        /// The version.
        version: CapabilityId,
    },
    /// The engine remembers no further request.
    TooManyRequests {
        /// How many it remembers.
        max: usize,
    },
    /// The answer is void.
    AnswerVoid {
        /// The version.
        version: CapabilityId,
        /// Why.
        cause: AnswerVoidCause,
    },
    /// The answer has no reason that can be read.
    NoReason,
    /// No request is open for the version.
    NotWaiting {
        /// The version.
        version: CapabilityId,
    },
    /// The request has ended.
    Ended {
        /// The version.
        version: CapabilityId,
        /// Until when it was open.
        until: WallTime,
    },
    /// The answer is over a candidate, evidence or rules that have changed since.
    SubjectChanged {
        /// The version.
        version: CapabilityId,
    },
    /// The text that people were shown has changed since they answered.
    DisplayChanged {
        /// The version.
        version: CapabilityId,
    },
    /// The person has given this answer already.
    AnsweredAlready {
        /// The person.
        name: String,
        /// Their answer.
        answer: ApprovalDecision,
        /// The version.
        version: CapabilityId,
    },
    /// The text is no name of a person.
    NoName {
        /// The text.
        name: String,
    },
    /// The store has no person of this name.
    NotEnrolled {
        /// The name.
        name: String,
        /// An administrator who can enroll them.
        administrator: String,
    },
    /// The person's key was revoked.
    KeyRevoked {
        /// The person.
        name: String,
        /// The administrator who revoked it.
        by: String,
    },
    /// The person's key file has no passphrase, and the profile requires one.
    KeyUnprotected {
        /// The person.
        name: String,
        /// The profile.
        profile: ProfileName,
    },
    /// The administrator's key file has no passphrase, although the act states or the profile requires one.
    AdministratorUnprotected {
        /// The administrator.
        name: String,
        /// The profile that requires one; absent if the act states that the key was protected.
        profile: Option<ProfileName>,
    },
    /// An unencrypted key enrolled the person, and no administrator has confirmed them.
    NotConfirmed {
        /// The person.
        name: String,
        /// The profile, which requires it.
        profile: ProfileName,
        /// The administrator who enrolled them, if one did.
        enrolled_by: Option<String>,
        /// An administrator who can confirm them, if there is one.
        confirmer: Option<String>,
    },
}

impl QuestionRefusal {
    /// Its class in the reply.
    #[must_use]
    pub const fn class(&self) -> Refusal {
        match self {
            Self::NoReason => Refusal::BadInput,
            Self::NothingPending { .. } | Self::NotWaiting { .. } => Refusal::NotFound,
            Self::TooManyRequests { .. } | Self::Ended { .. } => Refusal::NotNow,
            Self::AnswerVoid { .. } | Self::SubjectChanged { .. } | Self::DisplayChanged { .. } => {
                Refusal::Stale
            }
            Self::AnsweredAlready { .. }
            | Self::NoName { .. }
            | Self::NotEnrolled { .. }
            | Self::KeyRevoked { .. }
            | Self::KeyUnprotected { .. }
            | Self::AdministratorUnprotected { .. }
            | Self::NotConfirmed { .. } => Refusal::NotAllowed,
        }
    }
}

/// Why a signed answer is void.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AnswerVoidCause {
    /// The person signed an approval without the text of the request.
    NotDisplayed,
    /// The answered request is not open.
    RequestClosed,
    /// The answer would be valid for longer than the profile permits.
    ValidTooLong,
    /// Another version of the renderer made the lines.
    OtherRenderer,
    /// The answer is for a store with another key.
    OtherStoreKey,
    /// The signed facts are not the present ones.
    OtherFacts,
    /// The signed lines are not the present ones.
    OtherLines,
}
